"""Level tests behind the H-infinity norm: intervals with Taylor bounds, and crossings by the Hamiltonian matrix."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from support.resonant_systems import EVERY, oscillator, structure, sum_of

import lftkit.analysis.hinf.interval_cover
import lftkit.analysis.hinf.interval_norm
import lftkit.analysis.hinf.level_iteration
import lftkit.analysis.norms
from lftkit.analysis.frequency_response import FrequencyResponse, refined_response
from lftkit.analysis.hinf.hamiltonian_norm import level_crossings
from lftkit.analysis.hinf.interval_cover import above_level
from lftkit.analysis.hinf.interval_norm import interval_test
from lftkit.analysis.hinf.level_iteration import UndecidedError
from lftkit.analysis.norms import hinf_norm

EPS = np.finfo(float).eps


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


def test_crossings_with_feedthrough() -> None:
    """|2 + 1 / (jw + 1)|^2 = (9 + 4 w^2) / (1 + w^2); the second input does nothing."""
    A, B, C, D = -np.eye(1), np.array([[1.0, 0.0]]), np.eye(1), np.array([[2.0, 0.0]])
    for system in ((A, B, C, D), (A, C, B.T, D.T)):
        assert level_crossings(system, 2.5) == pytest.approx([np.sqrt(2.75 / 2.25)], rel=1e-7)


def test_level_below_the_feedthrough() -> None:
    """|2 - 1 / (jw + 1)|^2 = (1 + 4 w^2) / (1 + w^2) is the square of 1.9 at one frequency and exceeds it above."""
    response = FrequencyResponse.of([[-1.0]], [[1.0]], [[-1.0]], [[2.0]])
    found = interval_test(response, 1.9, np.array([1.0]))
    assert found is not None and np.abs(response.at(found)).max() > 1.9
    one = np.eye(1)
    assert level_crossings((-one, one, -one, 2.0 * one), 1.9) == pytest.approx([np.sqrt(2.61 / 0.39)], rel=1e-7)


def test_peak_between_the_seeds_is_found_without_any() -> None:
    """The cuts alone, with no seed at the resonance."""
    system = sum_of(oscillator(3.0, 1e-4), oscillator(500.0, 1e-3))
    response = FrequencyResponse.of(*system)
    assert interval_test(response, 4999.0, np.zeros(0)) is not None
    assert interval_test(response, 5001.0, np.zeros(0)) is None


def test_an_interval_test_that_gives_up_hands_over_to_the_hamiltonian(monkeypatch: pytest.MonkeyPatch) -> None:
    system, exact = structure(), hinf_norm(*structure()).value
    monkeypatch.setattr(lftkit.analysis.hinf.interval_cover, "MAX_INTERVALS", 3)
    response = FrequencyResponse.of(*system)
    with pytest.raises(UndecidedError, match="more than 3 intervals"):
        interval_test(response, 2 * exact, np.abs(response.poles))
    norm = hinf_norm(*system)
    assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(exact, rel=1e-7)


def test_intervals_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = hinf_norm(*structure())
    monkeypatch.setattr(lftkit.analysis.hinf.interval_norm, "CHUNK", 7)
    assert hinf_norm(*structure()) == exact


def test_rounding_of_the_modal_form_hands_over_to_the_hamiltonian(monkeypatch: pytest.MonkeyPatch) -> None:
    """A modal form that is wrong by a millionth is not believed."""
    exact = hinf_norm(*structure()).value
    honest = FrequencyResponse.of

    def wrong(A, B, C, D, **options) -> FrequencyResponse:
        return honest(A, B * (1 + 1e-6), C, D, **options)

    monkeypatch.setattr(lftkit.analysis.norms.FrequencyResponse, "of", wrong)
    norm = hinf_norm(*structure())
    assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(exact, rel=2e-7)


def test_no_certificate_within_the_rounds_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lftkit.analysis.hinf.level_iteration, "MAX_LEVELS", 0)
    with pytest.raises(ArithmeticError, match="the H-infinity norm did not settle in 0 levels"):
        hinf_norm(*structure(), certificate="interval")


def test_schur_form_is_refused_by_the_interval_test() -> None:
    response = FrequencyResponse.of(-np.eye(3) + np.diag([1.0, 1.0], 1), np.eye(3)[:, 2:], np.eye(3)[:1], [[0.0]])
    with pytest.raises(ValueError, match="response must be in modal form, got a Schur form"):
        interval_test(response, 2.0, np.zeros(0))


def test_reported_gain_is_that_of_a_refined_solution() -> None:
    norm = hinf_norm(*structure(), certificate="interval")
    gain = scipy.linalg.svdvals(refined_response(*structure(), norm.omega))[0]
    assert norm.value == pytest.approx(gain, rel=1e-13)


def law_of_cuts(light: list[complex], seeds: list[float], top: float) -> np.ndarray:
    """Cuts at 1, 4, 16 ... pole distances from each resonance, up to 0.7 of the way to the next; 40 over three decades.

    Zero, the seeds, the resonances and the top are cuts too.
    """
    cuts = [0.0, top, *np.geomspace(1e-3 * top, top, 40), *seeds, *(p.imag for p in light)]
    w = [0.0, *(p.imag for p in light), top]
    for i, pole in enumerate(light, start=1):
        distances = abs(pole.real) * 4.0 ** np.arange(60)
        cuts += [w[i] - d for d in distances if d < 0.7 * (w[i] - w[i - 1])]
        cuts += [w[i] + d for d in distances if d < 0.7 * (w[i + 1] - w[i])]
    return np.unique(cuts)


@pytest.mark.parametrize(
    ("light", "damped"),
    [
        ([-0.01 + 3.0j], []),
        ([-0.01 + 3.0j], [-0.9 + 1.1j, -1.0, -0.01, -0.4 + 1.0j]),
        ([-0.2 + 0.7j, -1e-4 + 5.0j, -0.3 + 9.0j], [-7.0]),
        ([-1e-5 + 0.3j, -0.05 + 0.301j], []),
        ([], [-2.0, -3.0 + 3.0j]),
    ],
)
def test_first_cuts_grow_fourfold_with_the_distance_from_lightly_damped_poles(light: list, damped: list) -> None:
    poles = np.array([q for p in [*light[::-1], *damped] for q in ([p, p.conjugate()] if np.imag(p) else [p])], complex)
    cuts = lftkit.analysis.hinf.interval_norm._cuts(poles, np.array([0.5, 30.0]), 20.0)
    assert np.array_equal(cuts, np.unique(cuts))
    np.testing.assert_allclose(cuts, law_of_cuts(light, [0.5], 20.0), rtol=1e-9)


def test_cuts_around_a_peak_halve_the_pole_distance_thirteen_times() -> None:
    poles = np.array([-0.2 + 3.0j, -0.2 - 3.0j, -1.0])
    distance = np.hypot(0.2, 0.1)
    steps = distance / 2.0 ** np.arange(14)
    found = np.sort(lftkit.analysis.hinf.interval_norm._around(2.9, poles))
    np.testing.assert_allclose(found, np.sort([2.9, *(2.9 - steps), *(2.9 + steps)]), rtol=1e-9)
    assert lftkit.analysis.hinf.interval_norm._around(np.inf, poles).size == 0


def two_by_two(poles: list[complex]) -> FrequencyResponse:
    """Modal form with residues of size 1 to 3, pairs side by side, and feedthrough."""
    rng = np.random.default_rng(4)
    left = rng.normal(size=(2, len(poles))) + 1j * rng.normal(size=(2, len(poles)))
    right = rng.normal(size=(len(poles), 2)) + 1j * rng.normal(size=(len(poles), 2))
    left[:, 1], right[1] = left[:, 0].conj(), right[0].conj()
    left[:, 2:], right[2:] = left[:, 2:].real, right[2:].real
    return FrequencyResponse(np.array(poles), left, right, rng.normal(size=(2, 2)), None)


@pytest.mark.parametrize("inverse", [False, True])
def test_bound_of_an_interval_is_the_taylor_polynomial_and_its_rest(inverse: bool) -> None:
    """The derivatives of 1 / (jw - lambda), or of x / (j - lambda x) in x = 1 / w, written out for each pole."""
    form = two_by_two([-0.3 + 2.0j, -0.3 - 2.0j, -0.7])
    centre = np.array([0.03, 0.05, 0.12]) if inverse else np.array([0.5, 1.9, 4.0])
    half = np.array([0.01, 0.05, 0.1]) if inverse else np.array([0.3, 0.05, 1.5])
    gain, bound = lftkit.analysis.hinf.interval_norm._taylor_bound(form, form.residue_norms, centre, half, inverse)
    for i, (c, h) in enumerate(zip(centre, half)):
        G, slope, curve, rest = form.D.astype(complex), 0.0, 0.0, 0.0
        for k, pole in enumerate(form.poles):
            R = np.outer(form.left[:, k], form.right[k])
            if inverse:
                q = 1j - pole * c
                G, slope, curve = G + R * c / q, slope + R * 1j / q**2, curve + R * 1j * pole / q**3
                ratio, first = abs(pole / q), 1.0 / abs(q) ** 2
            else:
                q = 1j * c - pole
                G, slope, curve = G + R / q, slope - 1j * R / q**2, curve - R / q**3
                ratio, first = 1.0 / abs(q), 1.0 / abs(q) ** 2
            rest += np.linalg.norm(R, 2) * first * ratio**2 * h**3 / (1.0 - ratio * h)
        expected = max(np.linalg.norm(G - h * slope, 2), np.linalg.norm(G + h * slope, 2))
        assert gain[i] == pytest.approx(np.linalg.norm(G, 2), rel=1e-9)
        assert bound[i] == pytest.approx(expected + h**2 * np.linalg.norm(curve, 2) + rest, rel=1e-9)


@pytest.mark.parametrize("inverse", [False, True])
def test_interval_longer_than_three_quarters_of_a_pole_distance_has_no_bound(inverse: bool) -> None:
    """Twice the half width reaches the pole: the series does not converge there."""
    form = two_by_two([-0.5 + 2.0j, -0.5 - 2.0j, -9.0])
    centre = np.full(4, 0.25 if inverse else 2.0)
    distance = abs(1j / form.poles[0] - 0.25) if inverse else 0.5
    half = distance * np.array([0.7, 0.8, 1.0, 3.0])
    _, bound = lftkit.analysis.hinf.interval_norm._taylor_bound(form, form.residue_norms, centre, half, inverse)
    assert np.isfinite(bound).tolist() == [True, False, False, False]


def test_interval_is_clearly_below_where_feedthrough_and_terms_add_up_to_less() -> None:
    form = two_by_two([-0.5 + 2.0j, -0.5 - 2.0j, -3.0])
    for c, h in ((0.3, 0.2), (2.0, 0.4), (7.0, 3.0), (5.0, 0.0)):
        terms = [
            np.linalg.norm(np.outer(form.left[:, k], form.right[k]), 2) / (abs(1j * c - form.poles[k]) - h)
            for k in range(3)
        ]
        total = sum(terms) + np.linalg.norm(form.D, 2)
        for level, below in ((total * (1 + 1e-9), True), (total * (1 - 1e-9), False)):
            answer = lftkit.analysis.hinf.interval_norm._clearly_below(
                form, form.residue_norms, level, np.array([c]), np.array([h])
            )
            assert answer.tolist() == [below]
    for h in (0.5, 0.6):  # the interval reaches the circle through the pole
        answer = lftkit.analysis.hinf.interval_norm._clearly_below(
            form, form.residue_norms, 1e9, np.array([2.0]), np.array([h])
        )
        assert answer.tolist() == [False]


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


def covered(
    response: FrequencyResponse, level: float, peak: float | None, monkeypatch: pytest.MonkeyPatch
) -> tuple[bool, int, int]:
    """Answer of the interval test, intervals looked at, and Taylor polynomials computed."""
    looked, computed = [0], [0]
    easy, taylor = lftkit.analysis.hinf.interval_norm._clearly_below, lftkit.analysis.hinf.interval_norm._taylor_bound

    def count_easy(form: FrequencyResponse, *rest) -> np.ndarray:
        looked[0] += len(rest[2])
        return easy(form, *rest)

    def count_taylor(form: FrequencyResponse, *rest) -> tuple[np.ndarray, np.ndarray]:
        computed[0] += len(rest[2])
        return taylor(form, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(lftkit.analysis.hinf.interval_norm, "_clearly_below", count_easy)
        patch.setattr(lftkit.analysis.hinf.interval_norm, "_taylor_bound", count_taylor)
        below = interval_test(response, level, np.zeros(0), peak) is None
    return below, looked[0], computed[0]


@pytest.mark.parametrize("zeta", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("margin", [1e-2, 1e-7])
def test_number_of_intervals_does_not_grow_with_the_sharpness_of_the_peak(
    zeta: float, margin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """97 to 144 intervals and 9 to 65 polynomials, with the peak known or not; a grid would need 1 / zeta of them."""
    response = FrequencyResponse.of(*sum_of(oscillator(1.0, 0.1), oscillator(30.0, zeta), oscillator(1e3, 0.02)))
    level = 0.5 / zeta / np.sqrt(1.0 - zeta**2) * (1.0 + margin)
    for peak in (30.0 * np.sqrt(1.0 - 2.0 * zeta**2), None):
        below, looked, computed = covered(response, level, peak, monkeypatch)
        assert below and 60 < looked < 200 and 5 < computed < 100


@pytest.mark.parametrize("factor", [1e-15, 1.0, 1e15])
def test_hamiltonian_answers_alike_in_every_unit_of_time(factor: float) -> None:
    A, B, C, D = oscillator(factor, 0.1)
    peak = 5.0 / np.sqrt(0.99)
    assert not level_crossings((A, B, C, D), peak * (1 + 1e-6)).size
    found = level_crossings((A, B, C, D), 2.0)
    assert found / factor == pytest.approx(crossings_of_an_oscillator(), rel=1e-6)


@pytest.mark.parametrize("at_once", [1, 2, 1000])
def test_intervals_are_covered_from_end_to_end(at_once: int) -> None:
    """The gain 1 - |x - c| with its slope as the bound: found wherever c is, and below every higher level."""
    ends = np.array([[0.0, 0.4], [0.4, 0.5], [0.5, 1.0]])
    for c, highest in ((0.0, 1.0), (0.3, 1.0), (0.4, 1.0), (0.77, 1.0), (1.0, 1.0), (1.2, 0.8)):

        def bounds(centre: np.ndarray, half: np.ndarray, c: float = c) -> tuple[np.ndarray, np.ndarray]:
            gain = 1.0 - np.abs(centre - c)
            return gain, gain + half

        above = above_level(bounds, highest - 1e-6, ends, at_once)
        assert above is not None and np.all(above[1] > highest - 1e-6)
        assert above[0] == pytest.approx(min(c, 1.0), abs=1e-6)
        assert above_level(bounds, highest + 1e-6, ends, at_once) is None


def test_interval_that_cannot_be_halved_is_left_undecided() -> None:
    """Two neighbouring numbers, and a bound that is not finite."""
    ends = np.array([[1.0, np.nextafter(1.0, 2.0)]])
    with pytest.raises(UndecidedError, match="an interval cannot be halved"):
        above_level(lambda x, h: (0.0 * x, np.inf + h), 1.0, ends)


def test_every_crossing_of_two_peaks_is_found() -> None:
    found = level_crossings(sum_of(oscillator(1.0, 0.1), oscillator(10.0, 0.1)), 2.0)
    one = crossings_of_an_oscillator()
    assert found == pytest.approx(np.concatenate([one, 10.0 * one]), rel=1e-6)
