"""Norms of few states beside the intervals; derivatives; gains of any size."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.accurate_response import extended_response

from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.peak_search import squared_gain
from lftkit.analysis.norms import hinf_norm

SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (4, 3), (2, 5)]


def random_system(seed: int, shape: tuple[int, int], feedthrough: float = 0.5) -> tuple[np.ndarray, ...]:
    """Up to twelve states, slowest decay 0.05 rad/s, spectral radius about one."""
    rng = np.random.default_rng(seed)
    n, (p, m) = int(rng.integers(1, 13)), shape
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), feedthrough * rng.normal(size=(p, m))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("feedthrough", [0.0, 0.5, 20.0])
def test_both_ways_give_one_norm(shape: tuple[int, int], feedthrough: float) -> None:
    for seed in range(3):
        system = random_system(seed, shape, feedthrough)
        for rtol in (1e-3, 1e-6, 1e-8):
            one, other = hinf_norm(*system, rtol=rtol), hinf_norm(*system, rtol=rtol, certificate="interval")
            assert (one.certificate, other.certificate) == ("hamiltonian", "interval")
            assert one.value <= other.upper and other.value <= one.upper
            assert one.upper == pytest.approx(one.value * (1.0 + rtol), rel=1e-12)
            exact = extended_response(*system, [one.omega])[0] if np.isfinite(one.omega) else system[3]
            assert one.value == pytest.approx(np.linalg.norm(exact, 2), rel=0.02 * rtol)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("modal", [True, False])
def test_derivatives_of_response_and_gain_agree_with_differences(shape: tuple[int, int], modal: bool) -> None:
    A, B, C, D = random_system(3, shape)
    form = FrequencyResponse.of(A, B, C, D)
    if not modal:
        T, Q = np.diag(form.poles), np.eye(len(A))
        form = FrequencyResponse(form.poles, form.left @ Q, Q @ form.right, D, T)
    assert form.modal == modal
    h, w = 1e-4, 0.7
    low, middle, high = (form.with_derivatives(x) for x in (w - h, w, w + h))
    for k in (0, 1):
        np.testing.assert_allclose(middle[k + 1], (high[k] - low[k]) / (2 * h), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(middle[0], form.at(w)[0], rtol=1e-12)
    below, value, above = (squared_gain(*found) for found in (low, middle, high))
    assert value[0] == pytest.approx(np.linalg.norm(middle[0], 2) ** 2, rel=1e-12)
    for k in (0, 1):
        assert value[k + 1] == pytest.approx((above[k] - below[k]) / (2 * h), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("size", [1e-160, 1e-60, 1e60])
def test_gains_whose_powers_are_no_numbers_are_not_lost(size: float) -> None:
    """Of one input, where the gain is a root of a sum of squares, and of two; at both ends of the range."""
    for B in (np.array([[1.0], [-2.0]]), np.array([[1.0, 0.5], [-2.0, 0.3]])):
        A, C, D = np.array([[-0.1, 1.0], [-1.0, -0.1]]), np.array([[1.0, 0.2], [0.4, -0.7]]), np.zeros((2, B.shape[1]))
        expected = hinf_norm(A, B, C, D)
        found = hinf_norm(A, B * size, C, D)
        assert found.value == pytest.approx(expected.value * size, rel=1e-7)
        assert found.value <= found.upper <= found.value * (1.0 + 2e-7)


@pytest.mark.parametrize("shape", [(1, 1), (2, 4), (3, 3)])
def test_both_ways_give_one_norm_of_sampled_systems(shape: tuple[int, int]) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        n, (p, m) = int(rng.integers(1, 13)), shape
        A = rng.normal(size=(n, n))
        A *= (1.0 - 10.0 ** rng.uniform(-3.0, -0.3)) / np.abs(np.linalg.eigvals(A)).max()
        system = A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), seed % 2 * rng.normal(size=(p, m))
        one, other = hinf_norm(*system, dt=0.1), hinf_norm(*system, dt=0.1, certificate="interval")
        assert one.value <= other.upper and other.value <= one.upper and one.upper <= one.value * (1.0 + 1.1e-7)


@pytest.mark.parametrize("dt", [None, 0.1])
def test_what_is_not_sound_is_left_to_the_other_ways(dt: float | None) -> None:
    """Unstable, poles at the circle to rounding, no basis of eigenvectors, hidden gain."""
    one, gap = np.eye(2), 0.0 if dt is None else 1.0
    for a in (0.1, 0.0, *([] if dt is None else [-1e-15])):
        norm = hinf_norm((a + gap) * one, one, one, 0.0 * one, dt=dt)
        assert (norm.value, norm.certificate) == (np.inf, "unstable")
    chain = np.array([[gap - 0.5, 1.0], [0.0, gap - 0.5]])
    assert hinf_norm(chain, one[:, 1:], one[:1], np.zeros((1, 1)), dt=dt).value == pytest.approx(4.0, rel=1e-7)
    hidden = hinf_norm((gap - 0.5) * one, one[:, :1], one[1:], np.zeros((1, 1)), dt=dt)
    assert hidden.value == 0.0 and hidden.upper < 1e-12
