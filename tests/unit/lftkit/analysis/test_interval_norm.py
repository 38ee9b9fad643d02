"""Level tests behind the H-infinity norm: the intervals and the Hamiltonian matrix decide alike."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from support.resonant_systems import EVERY, oscillator, structure, sum_of

import lftkit.analysis.hinf.interval_norm
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.hamiltonian_norm import level_crossings
from lftkit.analysis.hinf.interval_norm import interval_test
from lftkit.analysis.norms import hinf_norm


@pytest.mark.parametrize("level", [0.2, 0.9, 1.0 - 1e-6, 1.0 + 1e-6, 1.1, 5.0])
@pytest.mark.parametrize("feedthrough", [0.0, 0.3])
def test_both_level_tests_decide_alike(level: float, feedthrough: float) -> None:
    system = structure(feedthrough)
    response = FrequencyResponse.of(*system)
    top = level * hinf_norm(*system, rtol=1e-10).value
    found, crossings = interval_test(response, top, np.abs(response.poles)), level_crossings(system, top)
    if level > 1.0:
        assert found is None and not crossings.size
        return
    for frequencies in (found, np.append(crossings, 0.5 * (crossings[:-1] + crossings[1:]))):
        assert max(scipy.linalg.svdvals(g)[0] for g in response.at(frequencies)) > top


def test_crossings_of_the_level_are_answered() -> None:
    """|1 / (jw + 1)| = 0.6 at w = 4 / 3; 1 / (s^2 + 0.2 s + 1) crosses twice."""
    one = np.ones((1, 1))
    assert level_crossings((-one, one, one, 0 * one), 0.6) == pytest.approx([4 / 3], rel=1e-7)
    found = level_crossings(oscillator(1.0, 0.1), 2.0)
    assert found == pytest.approx(crossings_of_an_oscillator(), rel=1e-6)


def crossings_of_an_oscillator() -> np.ndarray:
    """Of 1 / (s^2 + 0.2 s + 1) and the level 2."""
    return np.sort(np.sqrt(np.roots([1.0, 0.04 - 2.0, 1.0 - 1.0 / 2.0**2]).real))


def test_peak_between_the_seeds_is_found_without_any() -> None:
    """The cuts alone, with no seed at the resonance."""
    system = sum_of(oscillator(3.0, 1e-4), oscillator(500.0, 1e-3))
    response = FrequencyResponse.of(*system)
    assert interval_test(response, 4999.0, np.zeros(0)) is not None
    assert interval_test(response, 5001.0, np.zeros(0)) is None


def beyond_the_poles(factor: float) -> tuple[tuple[np.ndarray, ...], float, float]:
    """(s^2 + sqrt(1.27) s) / (s^2 + 1.5 s + 0.5) in s / factor: the peak is 5 times the largest pole.

    With u = w^2 the squared gain is 1 + (0.02 u - 0.25) / (u^2 + 1.25 u + 0.25), largest where a quadratic vanishes.
    """
    A, b = np.array([[0.0, 1.0], [-0.5, -1.5]]), np.sqrt(1.27)
    C = np.array([[-0.5, b - 1.5]])
    u = max(np.roots([-0.02, 0.5, 0.02 * 0.25 + 0.25 * 1.25]).real)
    peak = np.sqrt(1.0 + (0.02 * u - 0.25) / (u**2 + 1.25 * u + 0.25))
    return (factor * A, np.array([[0.0], [factor]]), C, np.ones((1, 1))), float(peak), factor * float(np.sqrt(u))


@pytest.mark.parametrize("factor", [0.01, 1.0, 300.0])
def test_peak_far_above_all_poles(factor: float) -> None:
    system, peak, omega = beyond_the_poles(factor)
    assert omega > 4.0 * factor and peak == pytest.approx(1.0 + 1.85e-4, rel=1e-5)
    response = FrequencyResponse.of(*system)
    for level, below in ((peak * (1 + 1e-7), True), (peak * (1 - 1e-7), False), (1.0 + 1e-5, False)):
        found, crossings = interval_test(response, level, np.zeros(0)), level_crossings(system, level)
        assert (found is None) == (not crossings.size) == below
        for frequencies in () if below else (found, crossings):
            assert abs(response.at(frequencies)).max() >= level * (1 - 1e-9)
            assert frequencies.max() > 2.0 * factor
    for certificate in EVERY:
        norm = hinf_norm(*system, rtol=1e-9, certificate=certificate)
        assert norm.value == pytest.approx(peak, rel=2e-9) and norm.omega == pytest.approx(omega, rel=1e-3)


@pytest.mark.parametrize("factor", [1e-15, 1.0, 1e15])
def test_hamiltonian_answers_alike_in_every_unit_of_time(factor: float) -> None:
    A, B, C, D = oscillator(factor, 0.1)
    peak = 5.0 / np.sqrt(0.99)
    assert not level_crossings((A, B, C, D), peak * (1 + 1e-6)).size
    found = level_crossings((A, B, C, D), 2.0)
    assert found / factor == pytest.approx(crossings_of_an_oscillator(), rel=1e-6)


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("size", [0.05, 1.0, 20.0])
def test_no_gain_of_an_interval_exceeds_its_bound(size: float, inverse: bool) -> None:
    """On a fine grid, up to 0.7 of the distance of a pole, in w and in 1 / w: an enclosure that fails is no proof."""
    rng = np.random.default_rng(4)
    for _ in range(40):
        poles = size * np.array([-0.3 + 2.0j, -0.3 - 2.0j, -rng.uniform(0.2, 3.0)])
        left, right = rng.normal(size=(1, 3)) + 1j * rng.normal(size=(1, 3)), np.ones((3, 1), complex)
        left[:, 1], left[:, 2] = left[:, 0].conj(), left[:, 2].real
        form = FrequencyResponse(poles, left, right, np.zeros((1, 1)), None)
        centre = rng.uniform(0.05, 0.3 if inverse else 6.0) * (1.0 / size if inverse else size)
        distance = np.abs(1j / poles - centre if inverse else 1j * centre - poles).min()
        half = rng.uniform(0.3, 0.7) * distance
        one, other = np.array([centre]), np.array([half])
        _, bound = lftkit.analysis.hinf.interval_norm._taylor_bound(form, form.residue_norms, one, other, inverse)
        points = np.linspace(centre - half, centre + half, 400)
        inside = points[points > 0.0]
        assert np.abs(form.at(1.0 / inside if inverse else inside)).max() <= bound[0] * (1.0 + 1e-12)
