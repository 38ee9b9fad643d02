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


@given(signals, st.floats(-np.pi, np.pi), st.integers(2, 20))
@settings(max_examples=20, deadline=None)
def test_radial_figures_do_not_depend_on_the_axes(e: np.ndarray, angle: float, n: int) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    a, b = (np.hypot(*metrics.rpe_rms(x, DT, n * DT)) for x in (e, e @ turn.T))
    assert np.isclose(a, b, rtol=1e-9, atol=1e-9)


@given(signals, st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), st.integers(2, 20))
@settings(max_examples=20, deadline=None)
def test_an_offset_changes_no_rpe(e: np.ndarray, offset: tuple[float, float], n: int) -> None:
    a, b = metrics.rpe_rms(e, DT, n * DT), metrics.rpe_rms(e + np.array(offset), DT, n * DT)
    assert np.allclose(a, b, rtol=1e-6, atol=1e-9)


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
