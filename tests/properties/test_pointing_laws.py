"""Laws of the pointing indices that hold for every signal."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pointing_analysis.indices import confidence, metrics

DT = 1e-3
signals = arrays(
    np.float64, st.tuples(st.integers(40, 300), st.just(2)), elements=st.floats(-1e3, 1e3, allow_subnormal=False)
)


@given(signals, st.integers(2, 20))
@settings(max_examples=20, deadline=None)
def test_mean_square_is_mpe_plus_rpe(e: np.ndarray, n: int) -> None:
    w = metrics.windows(e, DT, n * DT)
    used = e[: len(w.mean) * n]
    total = np.square(w.mean).mean(axis=0) + w.variance.mean(axis=0)
    assert np.allclose(total, np.square(used).mean(axis=0), rtol=1e-9, atol=1e-12)


@given(signals, st.integers(2, 20), st.floats(-np.pi, np.pi), arrays(float, 2, elements=st.floats(-1e3, 1e3)))
@settings(max_examples=20, deadline=None)
def test_the_rpe_of_a_turned_and_of_a_moved_error(e: np.ndarray, n: int, angle: float, offset: np.ndarray) -> None:
    """The radial figure does not depend on the axes, and those of the axes do not depend on an offset."""
    rpe = metrics.rpe_rms(e, DT, n * DT)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert np.isclose(np.hypot(*rpe), np.hypot(*metrics.rpe_rms(e @ turn.T, DT, n * DT)), rtol=1e-9, atol=1e-9)
    assert np.allclose(rpe, metrics.rpe_rms(e + offset, DT, n * DT), rtol=1e-6, atol=1e-9)


@given(signals, st.integers(2, 20), st.floats(1e-6, 1e6))
@settings(max_examples=20, deadline=None)
def test_figures_scale_with_the_error(e: np.ndarray, n: int, scale: float) -> None:
    a, b = metrics.rpe_rms(e, DT, n * DT), metrics.rpe_rms(scale * e, DT, n * DT)
    assert np.allclose(scale * a, b, rtol=1e-6, atol=1e-12 * scale)


@given(signals, st.integers(2, 10))
@settings(max_examples=20, deadline=None)
def test_longer_windows_see_more(e: np.ndarray, n: int) -> None:
    """Over the same samples, a window of twice the length has at least the RPE of its halves."""
    e = e[: len(e) // (2 * n) * 2 * n]
    assert np.all(metrics.rpe_rms(e, DT, 2 * n * DT) >= metrics.rpe_rms(e, DT, n * DT) * (1 - 1e-9) - 1e-12)


@given(arrays(np.float64, st.integers(1, 500), elements=st.floats(-1e6, 1e6)))
@settings(max_examples=33, deadline=None)
def test_effective_number_lies_between_one_and_all(x: np.ndarray) -> None:
    assert 1 <= confidence.effective_number(x) <= len(x)
