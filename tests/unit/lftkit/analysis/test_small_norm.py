"""Norm of systems of few states: the way by one Hamiltonian matrix beside the intervals and beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.accurate_response import extended_response
from support.resonant_systems import mixed, oscillator, structure, sum_of

from lftkit.analysis.eigenvectors import balanced
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.level_iteration import NormBracket, Peak, UndecidedError, bracketed_norm
from lftkit.analysis.hinf.peak_search import climb, squared_gain
from lftkit.analysis.hinf.small_norm import MAX_STATES, SmallModel
from lftkit.analysis.norms import hinf_norm

SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (4, 3), (2, 5)]


def random_system(seed: int, shape: tuple[int, int], feedthrough: float = 0.5) -> tuple[np.ndarray, ...]:
    """Up to twelve states, slowest decay 0.05 rad/s, spectral radius about one."""
    rng = np.random.default_rng(seed)
    n, (p, m) = int(rng.integers(1, 13)), shape
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), feedthrough * rng.normal(size=(p, m))


def small(system: tuple[np.ndarray, ...], rtol: float) -> NormBracket:
    A, B, C, D = system
    return bracketed_norm(SmallModel.of((*balanced(A, B, C), D), rtol))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("feedthrough", [0.0, 0.5, 20.0])
def test_both_ways_give_one_norm(shape: tuple[int, int], feedthrough: float) -> None:
    for seed in range(6):
        system = random_system(seed, shape, feedthrough)
        for rtol in (1e-3, 1e-6, 1e-8):
            one, other = hinf_norm(*system, rtol=rtol), hinf_norm(*system, rtol=rtol, certificate="interval")
            assert (one.certificate, other.certificate) == ("hamiltonian", "interval")
            assert one.value <= other.upper and other.value <= one.upper
            assert one.upper == pytest.approx(one.value * (1.0 + rtol), rel=1e-12)
            exact = extended_response(*system, [one.omega])[0] if np.isfinite(one.omega) else system[3]
            assert one.value == pytest.approx(np.linalg.norm(exact, 2), rel=0.02 * rtol)


@pytest.mark.parametrize("rtol", [0.1, 1e-3, 1e-6, 1e-9])
def test_peak_of_an_oscillator_is_bracketed(rtol: float) -> None:
    exact = 1.0 / (2 * 0.05 * np.sqrt(1 - 0.05**2))
    norm = small(mixed(sum_of(oscillator(3.0, 0.05), oscillator(40.0, 0.06))), rtol)
    assert norm.value <= exact * (1.0 + 0.01 * rtol) and exact <= norm.upper <= exact * (1.0 + 1.01 * rtol)
    assert norm.omega == pytest.approx(3.0 * np.sqrt(1 - 2 * 0.05**2), rel=0.1 * np.sqrt(rtol))


def test_other_peak_is_found_by_the_crossings(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search starts at the lower of two peaks that differ by 1e-5, and at a frequency where there is none."""
    system = mixed(sum_of(oscillator(1.0, 0.01), oscillator(70.0, 0.01 * (1 + 1e-5))))
    for start in (70.0, 8.0):

        def first_peak(model: SmallModel, omega: float = start) -> Peak:
            return Peak(omega, float(np.linalg.norm(model.with_derivatives(omega)[0], 2)))

        monkeypatch.setattr(SmallModel, "first_peak", first_peak)
        norm = small(system, 1e-8)
        assert norm.value == pytest.approx(50.0 / np.sqrt(1 - 1e-4), rel=2e-8) and norm.omega == pytest.approx(1, 1e-3)


@pytest.mark.parametrize("zeta", [1e-9, 1e-12])
def test_damping_near_rounding_is_refused(zeta: float) -> None:
    """And the other way has the right value."""
    system = mixed(sum_of(oscillator(1.0, 0.1), oscillator(30.0, zeta)))
    with pytest.raises(UndecidedError, match="the damping is near rounding"):
        small(system, 1e-7)
    assert hinf_norm(*sum_of(oscillator(1.0, 0.1), oscillator(30.0, zeta))).value == pytest.approx(0.5 / zeta, rel=1e-7)


def test_systems_of_other_kinds_are_refused() -> None:
    one = np.eye(3)
    chain = -one + np.diag([1.0, 1.0], 1)
    driven, observed = np.eye(4)[:, :1], np.eye(4)[2:3]
    for system, reason in (
        ((chain, one[:, 2:], one[:1], np.zeros((1, 1))), "no basis of eigenvectors"),
        ((np.diag([-1.0, -2.0, 0.0]), one, one, 0 * one), "a pole is not left of the imaginary axis"),
        ((np.diag([-1.0, -2.0, -3.0, -4.0]), driven, observed, np.zeros((1, 1))), "the modal terms cancel"),
    ):
        with pytest.raises(UndecidedError, match=reason):
            small(system, 1e-7)


def test_number_of_states_decides() -> None:
    for states, certificate in ((MAX_STATES, "hamiltonian"), (MAX_STATES + 2, "interval")):
        system = sum_of(*(oscillator(w, 0.1) for w in np.geomspace(1.0, 100.0, states // 2)))
        norm = hinf_norm(*system)
        assert norm.certificate == certificate
        assert norm.value == pytest.approx(1.0 / (0.2 * np.sqrt(0.99)), rel=1e-7)


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


@pytest.mark.parametrize("start", [0.2, 0.9, 1.0, 1.1, 5.0])
def test_climbing_ends_on_a_peak_from_both_sides(start: float) -> None:
    form = FrequencyResponse.of(*structure(0.0))
    gain = float(np.linalg.norm(form.at(start)[0], 2))
    omega, found = climb(form.with_derivatives, start, gain, float(np.abs(1j * start - form.poles).min()), 1e-6)
    assert found >= gain and found == pytest.approx(np.linalg.norm(form.at(omega)[0], 2), rel=1e-9)
    near = np.linalg.norm(form.at(omega * (1.0 + np.linspace(-1e-3, 1e-3, 41))), 2, axis=(1, 2))
    assert near.max() <= found * (1.0 + 1e-6)


@pytest.mark.parametrize("size", [1e-160, 1e-60, 1e60])
def test_gains_whose_powers_are_no_numbers_are_not_lost(size: float) -> None:
    """Of one input, where the gain is a root of a sum of squares, and of two; at both ends of the range."""
    for B in (np.array([[1.0], [-2.0]]), np.array([[1.0, 0.5], [-2.0, 0.3]])):
        A, C, D = np.array([[-0.1, 1.0], [-1.0, -0.1]]), np.array([[1.0, 0.2], [0.4, -0.7]]), np.zeros((2, B.shape[1]))
        expected = hinf_norm(A, B, C, D)
        found = hinf_norm(A, B * size, C, D)
        assert found.value == pytest.approx(expected.value * size, rel=1e-7)
        assert found.value <= found.upper <= found.value * (1.0 + 2e-7)
