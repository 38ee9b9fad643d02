"""H-infinity norms of systems whose norm is known in closed form, and the two level tests alone."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import lti.hinf_level_test
import lti.norms
from lti.frequency_response import FrequencyResponse, refined_response
from lti.hinf_level_test import hamiltonian_test, interval_test
from lti.norms import h2_norm, hinf_norm, schur_lyapunov, spectral_abscissa

CERTIFICATES = ["interval", "hamiltonian"]


def oscillator(w: float, zeta: float) -> tuple[np.ndarray, ...]:
    """w^2 / (s^2 + 2 zeta w s + w^2): peak 1 / (2 zeta sqrt(1 - zeta^2)) at w sqrt(1 - 2 zeta^2)."""
    A = np.array([[0.0, w], [-w, -2.0 * zeta * w]])
    return A, np.array([[0.0], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def resonator(radius: float, angle: float) -> tuple[np.ndarray, ...]:
    """1 / (z^2 - 2 r cos(a) z + r^2): peak 1 / ((1 - r^2) sin a) where cos(theta) = cos(a) (1 + r^2) / (2 r)."""
    A = np.array([[0.0, 1.0], [-(radius**2), 2.0 * radius * np.cos(angle)]])
    return A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def sum_of(*systems: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Block-diagonal system: each has inputs and outputs of its own, so the largest norm is the norm."""
    return tuple(scipy.linalg.block_diag(*parts) for parts in zip(*systems))


def mixed(system: tuple[np.ndarray, ...], seed: int = 0) -> tuple[np.ndarray, ...]:
    """The same system in other coordinates."""
    A, B, C, D = system
    T = np.eye(len(A)) + 0.2 * np.random.default_rng(seed).normal(size=A.shape)
    return T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), D


@pytest.mark.parametrize("certificate", CERTIFICATES)
@pytest.mark.parametrize("rtol", [0.1, 1e-3, 1e-6, 1e-9])
def test_norm_lies_between_both_sides(rtol: float, certificate: str) -> None:
    exact = 1.0 / (2 * 0.05 * np.sqrt(1 - 0.05**2))
    norm = hinf_norm(*mixed(sum_of(oscillator(3.0, 0.05), oscillator(40.0, 0.06))), rtol=rtol, certificate=certificate)
    assert norm.certificate == certificate
    assert norm.value <= exact * (1 + 1e-12) and exact <= norm.upper
    assert norm.upper == pytest.approx(norm.value * (1 + rtol), rel=1e-12)
    assert norm.omega == pytest.approx(3.0 * np.sqrt(1 - 2 * 0.05**2), rel=0.1 * np.sqrt(rtol))


@pytest.mark.parametrize("certificate", CERTIFICATES)
def test_two_peaks_that_differ_by_little(certificate: str) -> None:
    """The search starts at the second; the test finds the first."""
    low, high = oscillator(1.0, 0.01), oscillator(70.0, 0.01 * (1 + 1e-5))
    norm = hinf_norm(*mixed(sum_of(low, high)), rtol=1e-8, certificate=certificate)
    assert norm.value == pytest.approx(50.0 / np.sqrt(1 - 1e-4), rel=2e-8)
    assert norm.omega == pytest.approx(np.sqrt(1 - 2e-4), rel=1e-4)


@pytest.mark.parametrize("zeta", [1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("certificate", ["auto", "interval"])
def test_damping_near_zero(zeta: float, certificate: str) -> None:
    """Beside modes of three decades above and below."""
    system = sum_of(oscillator(1.0, 0.1), oscillator(30.0, zeta), oscillator(1e3, 0.02))
    norm = hinf_norm(*system, rtol=1e-7, certificate=certificate)
    assert norm.value == pytest.approx(0.5 / zeta, rel=1e-7)
    assert norm.omega == pytest.approx(30.0, rel=1e-12)
    assert norm.upper == pytest.approx(norm.value, rel=1.01e-7) and norm.certificate == "interval"


@pytest.mark.parametrize("certificate", CERTIFICATES)
def test_peak_of_a_matrix_with_feedthrough(certificate: str) -> None:
    """D + 1 / (s + 1) at zero frequency and D at infinity, for two signs of D."""
    A, B, C = -np.eye(2), np.eye(2), np.eye(2)
    same = hinf_norm(A, B, C, np.diag([3.0, 1.0]), certificate=certificate)
    assert (same.value, same.omega) == (4.0, 0.0) and same.upper == pytest.approx(4.0, rel=1e-6)
    against = hinf_norm(A, B, C, np.diag([-3.0, 1.0]), certificate=certificate)
    assert against.value == pytest.approx(3.0, rel=1e-12) and against.omega == np.inf


@pytest.mark.parametrize("dt", [1.0, 0.01])
@pytest.mark.parametrize(
    ("a", "omega"),
    [(0.9, 0.0), (-0.9, np.pi)],
)
def test_discrete_lag(dt: float, a: float, omega: float) -> None:
    """1 / (z - a) is largest at z = 1 or z = -1."""
    norm = hinf_norm([[a]], [[1.0]], [[2.0]], [[0.0]], dt=dt)
    assert norm.value == pytest.approx(20.0, rel=1e-12) and norm.omega == pytest.approx(omega / dt)
    assert norm.value <= norm.upper <= norm.value * (1 + 1.01e-7)


@pytest.mark.parametrize("dt", [1.0, 0.01])
@pytest.mark.parametrize(("radius", "angle"), [(0.99, 0.3), (0.999, 2.5)])
def test_discrete_resonance(dt: float, radius: float, angle: float) -> None:
    norm = hinf_norm(*resonator(radius, angle), dt=dt)
    assert norm.value == pytest.approx(1.0 / ((1 - radius**2) * np.sin(angle)), rel=1e-7)
    assert norm.omega * dt == pytest.approx(np.arccos(np.cos(angle) * (1 + radius**2) / (2 * radius)), rel=1e-6)
    assert norm.certificate == "interval"


def test_discrete_pole_on_or_outside_the_circle_is_unstable() -> None:
    for radius, angle in ((1.0, 0.7), (1.2, 0.7)):
        norm = hinf_norm(*resonator(radius, angle), dt=0.1)
        assert (norm.value, norm.upper, norm.certificate) == (np.inf, np.inf, "unstable")
        assert norm.omega == pytest.approx(7.0)
        assert h2_norm(*resonator(radius, angle), dt=0.1) == np.inf
    both = sum_of(([[0.5]], [[1.0]], [[1.0]], [[0.0]]), ([[-1.5]], [[1.0]], [[1.0]], [[0.0]]))
    assert hinf_norm(*both, dt=0.5).omega == pytest.approx(2 * np.pi)


def test_systems_without_states() -> None:
    empty = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[3.0, 4.0]])
    for dt in (None, 0.1):
        norm = hinf_norm(*empty, dt=dt)
        assert (norm.value, norm.upper, norm.omega, norm.certificate) == (5.0, 5.0, 0.0, "static")
    assert h2_norm(*empty, dt=0.1) == 5.0
    assert h2_norm(*empty) == np.inf
    assert h2_norm(*empty[:3], 0.0 * empty[3]) == 0.0
    assert spectral_abscissa(np.zeros((0, 0))) == -np.inf


def test_states_that_are_not_driven_or_not_observed() -> None:
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    for B, C in ((none, one), (one, none)):
        norm = hinf_norm(-one, B, C, 2 * one)
        assert (norm.value, norm.upper, norm.certificate) == (2.0, 2.0, "static")
        assert hinf_norm(0 * one, B, C, 2 * one).certificate == "unstable"
        assert hinf_norm(one, B, C, none).value == np.inf
    assert hinf_norm(
        np.array([[0.5, 2.0], [-2.0, 0.5]]), np.zeros((2, 1)), np.ones((1, 2)), none
    ).omega == pytest.approx(2.0)


def test_terms_that_cancel_leave_a_bound_of_rounding() -> None:
    """One mode is driven, the other observed: the response is zero."""
    A, B, C, D = mixed(sum_of(oscillator(1.0, 0.1), oscillator(5.0, 0.1)))
    norm = hinf_norm(A, B[:, :1], C[1:], D[1:, :1])
    assert 0.0 <= norm.value <= norm.upper < 1e-10
    exact = hinf_norm(*sum_of(oscillator(1.0, 0.1), oscillator(5.0, 0.1))[:1], np.eye(4)[:, 1:2], np.eye(4)[2:3], [[0]])
    assert exact.value == 0.0 and exact.upper < 1e-10


@pytest.mark.parametrize("w", [0.0, 2.0, 1e4])
def test_undamped_modes_are_unstable(w: float) -> None:
    """Alone, beside damped ones, in mixed coordinates; a double integrator."""
    free = ([[0.0, w], [-w, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    for system in (free, sum_of(free, oscillator(3.0, 0.01))):
        norm = hinf_norm(*system)
        assert (norm.value, norm.upper, norm.omega, norm.certificate) == (np.inf, np.inf, w, "unstable")
        assert h2_norm(*system) == np.inf
    assert hinf_norm([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]).certificate == "unstable"


def test_least_stable_pole_is_named() -> None:
    fast = ([[0.3, 7.0], [-7.0, 0.3]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    slow = ([[0.1, 2.0], [-2.0, 0.1]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    assert hinf_norm(*sum_of(slow, fast, oscillator(50.0, 0.1))).omega == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"certificate": "grid"}, "certificate must be auto, interval or hamiltonian, got 'grid'"),
        ({"rtol": 0.0}, r"rtol must be positive, got 0\.0"),
        ({"rtol": -1e-3}, r"rtol must be positive, got -0\.001"),
        ({"rtol": np.nan}, "rtol must be positive, got nan"),
        ({"dt": 0.0}, r"dt must be positive, got 0\.0"),
        ({"dt": -1.0}, r"dt must be positive, got -1\.0"),
        ({"dt": np.nan}, "dt must be positive, got nan"),
    ],
)
def test_options_are_checked(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hinf_norm([[-1.0]], [[1.0]], [[1.0]], [[0.0]], **options)


def test_h2_of_known_systems() -> None:
    """The oscillator has the squared norm w / (4 zeta); the discrete lag c^2 / (1 - a^2) + d^2."""
    assert h2_norm(*mixed(oscillator(3.0, 0.02))) ** 2 == pytest.approx(3.0 / 0.08, rel=1e-10)
    two = sum_of(oscillator(3.0, 0.02), oscillator(7.0, 0.5))
    assert h2_norm(*two) ** 2 == pytest.approx(3.0 / 0.08 + 7.0 / 2.0, rel=1e-10)
    assert h2_norm([[-0.5]], [[1.0]], [[3.0]], [[4.0]], dt=0.1) ** 2 == pytest.approx(9 / 0.75 + 16)
    assert h2_norm([[-8.0]], [[1.0]], [[1.0]], [[0.0]]) == pytest.approx(0.25)
    assert h2_norm([[0.0]], [[0.5]], [[0.5]], [[0.0]], dt=1.0) == pytest.approx(0.25)
    assert h2_norm([[-1.0]], [[1.0]], [[1.0]], [[1e-9]]) == np.inf
    assert h2_norm([[-1e-9]], [[1.0]], [[1.0]], [[0.0]]) ** 2 == pytest.approx(0.5e9)
    assert h2_norm([[0.0]], [[1.0]], [[1.0]], [[0.0]]) == np.inf
    assert h2_norm(*mixed(sum_of(oscillator(3.0, 0.0), oscillator(7.0, 0.5)))) == np.inf
    assert h2_norm([[1.0]], [[1.0]], [[1.0]], [[0.0]], dt=1.0) == np.inf
    assert h2_norm([[0.999]], [[1.0]], [[1.0]], [[0.0]], dt=1.0) < np.inf


@pytest.mark.parametrize("transposed", [False, True])
def test_lyapunov_equation_of_a_quasi_triangular_matrix(transposed: bool) -> None:
    rng = np.random.default_rng(0)
    T = scipy.linalg.schur(rng.normal(size=(6, 6)) - 3 * np.eye(6))[0]
    W = rng.normal(size=(6, 6))
    W = W + W.T
    P = schur_lyapunov(T, W, transposed=transposed)
    left = T.T if transposed else T
    assert np.array_equal(P, P.T)
    np.testing.assert_allclose(left @ P + P @ left.T, -W, atol=1e-12)


def structure(feedthrough: float = 0.3) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(8)
    A, B, C, _ = mixed(sum_of(*(oscillator(w, 0.02) for w in (0.5, 0.55, 4.0, 30.0))))
    return A, B @ rng.normal(size=(4, 3)), rng.normal(size=(2, 4)) @ C, feedthrough * rng.normal(size=(2, 3))


@pytest.mark.parametrize("level", [0.2, 0.9, 1.0 - 1e-6, 1.0 + 1e-6, 1.1, 5.0])
@pytest.mark.parametrize("feedthrough", [0.0, 0.3])
def test_both_level_tests_decide_alike(level: float, feedthrough: float) -> None:
    system = structure(feedthrough)
    response = FrequencyResponse.of(*system)
    top = level * hinf_norm(*system, rtol=1e-10).value
    one, two = interval_test(response, top, np.abs(response.poles)), hamiltonian_test(*system, top)
    for outcome in (one, two):
        assert outcome.decided and outcome.below == (level > 1.0)
        gains = [scipy.linalg.svdvals(g)[0] for g in response.at(outcome.frequencies)]
        assert (len(gains) == 0) if level > 1.0 else (max(gains) > top)


def test_crossings_of_the_level_are_answered() -> None:
    """|1 / (jw + 1)| = 0.6 at w = 4 / 3; with 1 / (s^2 + 0.2 s + 1) two crossings and the middle between them."""
    one = np.ones((1, 1))
    found = hamiltonian_test(-one, one, one, 0 * one, 0.6)
    assert not found.below and found.frequencies == pytest.approx([4 / 3], rel=1e-7)
    level = 2.0
    found = hamiltonian_test(*oscillator(1.0, 0.1), level)
    square = np.roots([1.0, 0.04 - 2.0, 1.0 - 1.0 / level**2])
    low, high = np.sort(np.sqrt(square.real))
    assert found.frequencies == pytest.approx([low, 0.5 * (low + high), high], rel=1e-6)


def test_crossings_with_feedthrough() -> None:
    """|2 + 1 / (jw + 1)|^2 = (9 + 4 w^2) / (1 + w^2); the second input does nothing."""
    A, B, C, D = -np.eye(1), np.array([[1.0, 0.0]]), np.eye(1), np.array([[2.0, 0.0]])
    for system in ((A, B, C, D), (A, C, B.T, D.T)):
        found = hamiltonian_test(*system, 2.5)
        assert found.frequencies == pytest.approx([np.sqrt(2.75 / 2.25)], rel=1e-7)


def test_level_below_the_feedthrough_points_to_infinity() -> None:
    for D in (np.array([[2.0, 0.0]]), np.array([[2.0], [0.0]])):
        p, m = D.shape
        outcome = hamiltonian_test(-np.eye(1), np.ones((1, m)), np.ones((p, 1)), D, 1.9)
        assert not outcome.below and outcome.decided and outcome.frequencies.tolist() == [np.inf]
    response = FrequencyResponse.of([[-1.0]], [[1.0]], [[-1.0]], [[2.0]])
    outcome = interval_test(response, 1.9, np.array([1.0]))
    assert not outcome.below and response.at(outcome.frequencies).__abs__().max() > 1.9


def test_peak_between_the_seeds_is_found_without_any() -> None:
    """The cuts alone, with no seed at the resonance."""
    system = sum_of(oscillator(3.0, 1e-4), oscillator(500.0, 1e-3))
    response = FrequencyResponse.of(*system)
    assert not interval_test(response, 4999.0, np.zeros(0)).below
    assert interval_test(response, 5001.0, np.zeros(0)).below


def test_an_interval_test_that_gives_up_hands_over_to_the_hamiltonian(monkeypatch: pytest.MonkeyPatch) -> None:
    system, exact = structure(), hinf_norm(*structure()).value
    monkeypatch.setattr(lti.hinf_level_test, "MAX_INTERVALS", 3)
    response = FrequencyResponse.of(*system)
    outcome = interval_test(response, 2 * exact, np.abs(response.poles))
    assert not outcome.below and not outcome.decided and len(outcome.frequencies) == 0
    norm = hinf_norm(*system)
    assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(exact, rel=1e-7)


def test_intervals_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = hinf_norm(*structure())
    monkeypatch.setattr(lti.hinf_level_test, "CHUNK", 7)
    assert hinf_norm(*structure()) == exact


def test_rounding_of_the_modal_form_hands_over_to_the_hamiltonian(monkeypatch: pytest.MonkeyPatch) -> None:
    """A modal form that is wrong by a millionth is not believed."""
    exact = hinf_norm(*structure()).value
    honest = FrequencyResponse.of

    def wrong(A, B, C, D, **options) -> FrequencyResponse:
        return honest(A, B * (1 + 1e-6), C, D, **options)

    monkeypatch.setattr(lti.norms.FrequencyResponse, "of", wrong)
    norm = hinf_norm(*structure())
    assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(exact, rel=2e-7)


def test_no_certificate_within_the_rounds_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lti.norms, "MAX_ROUNDS", 0)
    with pytest.raises(ArithmeticError, match=r"did not settle in 0 rounds \(order 8\)"):
        hinf_norm(*structure())


def test_schur_form_is_refused_by_the_interval_test() -> None:
    response = FrequencyResponse.of(-np.eye(3) + np.diag([1.0, 1.0], 1), np.eye(3)[:, 2:], np.eye(3)[:1], [[0.0]])
    with pytest.raises(ValueError, match="response must be in modal form, got a Schur form"):
        interval_test(response, 2.0, np.zeros(0))


def test_reported_gain_is_that_of_a_refined_solution() -> None:
    norm = hinf_norm(*structure())
    gain = scipy.linalg.svdvals(refined_response(*structure(), norm.omega))[0]
    assert norm.value == pytest.approx(gain, rel=1e-13)


EVERY = ["auto", *CERTIFICATES]
EPS = np.finfo(float).eps


@pytest.mark.parametrize("certificate", EVERY)
@pytest.mark.parametrize("pole", [-4.0, -0.25, -0.5 + 2.0j])
def test_equal_parts_of_opposite_sign_leave_a_bound_of_the_rounding_of_their_terms(
    pole: complex, certificate: str
) -> None:
    """100 roundings of the sum of the modal terms, each a residue over the distance of the pole."""
    size, a, w = abs(pole), abs(np.real(pole)), np.imag(pole)
    part = np.array([[-a, w], [-w, -a]]) if w else np.array([[-a]])
    terms = 2.0 * (0.5 / a + 0.5 / (size + w) if w else 1.0 / a)
    first = np.eye(len(part))[:1]
    norm = hinf_norm(
        scipy.linalg.block_diag(part, part),
        np.hstack([first, first]).T,
        np.hstack([first, -first]),
        [[0.0]],
        certificate=certificate,
    )
    assert norm.value == 0.0 and norm.upper == pytest.approx(100.0 * EPS * terms, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("certificate", EVERY)
@pytest.mark.parametrize("modal", [True, False])
def test_part_that_is_driven_beside_one_that_is_observed_has_norm_zero(modal: bool, certificate: str) -> None:
    """Shown with intervals; a Hamiltonian, which a triple pole asks for, needs 100 roundings of |B| |C| / |Re pole|."""
    chain = 0.25 * (-np.eye(3) + np.diag([1.0, 1.0], 1))
    one, two = (np.diag([-0.25, -0.5, -0.75]), np.diag([-1.0, -1.25, -1.5])) if modal else (chain, chain)
    A, B, C = scipy.linalg.block_diag(one, two), 3.0 * np.eye(6)[:, 2:3], 5.0 * np.eye(6)[3:4]
    assert FrequencyResponse.of(A, B, C, [[0.0]]).modal == modal
    norm = hinf_norm(A, B, C, [[0.0]], certificate=certificate)
    intervals = modal and certificate != "hamiltonian"
    assert norm.value == 0.0 and norm.certificate == ("interval" if intervals else "hamiltonian")
    assert norm.upper == (0.0 if intervals else pytest.approx(100.0 * EPS * 15.0 / 0.25, rel=1e-9, abs=0.0))


def test_smallest_gains_of_a_schur_form_are_as_exact_as_large_ones() -> None:
    """k / (s + 1)^3 has the norm k."""
    A, B, C = -np.eye(3) + np.diag([1.0, 1.0], 1), np.eye(3)[:, 2:], np.eye(3)[:1]
    for gain in (1e-20, 1e-15, 1.0, 1e20):
        norm = hinf_norm(A, gain * B, C, [[0.0]])
        assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(gain, rel=1e-9, abs=0.0)
        assert norm.upper == pytest.approx(gain * (1 + 1e-7), rel=1e-9, abs=0.0)


def test_gain_that_the_level_test_sees_by_rounding_is_part_of_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The modal form claims 2 where a direct solution has 0.1: the bound is 2 (1 + rtol), the value stays."""
    lag = [[-1.0]], [[1.0]], [[1.0]], [[0.0]]
    search = lti.norms._best_peak

    def best_peak(response: FrequencyResponse, seeds: np.ndarray, rtol: float) -> tuple[float, float]:
        return (2.0, 10.0) if list(seeds) == [10.0] else search(response, seeds, rtol)

    claimed = lti.hinf_level_test.LevelTest(False, True, np.array([10.0]))
    monkeypatch.setattr(lti.norms, "_level_test", lambda *_: claimed)
    monkeypatch.setattr(lti.norms, "_best_peak", best_peak)
    norm = hinf_norm(*lag, rtol=1e-2)
    assert norm.value == pytest.approx(1.0, rel=1e-9) and norm.omega == 0.0
    assert norm.upper == pytest.approx(2.0 * 1.01, rel=1e-9)


@pytest.mark.parametrize(("error", "certificate"), [(5e-5, "interval"), (1.5e-4, "hamiltonian")])
def test_modal_form_is_believed_up_to_a_tenth_of_the_tolerance(
    error: float, certificate: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = FrequencyResponse.of
    monkeypatch.setattr(
        lti.norms.FrequencyResponse, "of", lambda A, B, C, D, **options: honest(A, B * (1 + error), C, D, **options)
    )
    norm = hinf_norm(*structure(0.0), rtol=1e-3)
    assert norm.certificate == certificate
    monkeypatch.undo()
    exact = hinf_norm(*structure(0.0)).value
    assert norm.value <= exact * (1 + 1e-6) and exact <= norm.upper


def test_pole_counts_as_on_the_circle_within_four_roundings_per_state() -> None:
    for states, roundings, outside in ((1, 2, True), (1, 8, False), (2, 6, True), (2, 12, False), (1, 0, True)):
        A = np.diag([1.0 - roundings * EPS, 0.5][:states])
        norm = hinf_norm(A, np.eye(states), np.eye(states), np.zeros((states, states)), dt=1.0)
        assert (norm.certificate == "unstable") == outside


def test_lyapunov_solution_near_the_largest_number_is_scaled() -> None:
    """-1e-150 p + 1e145 = 0: LAPACK answers with a scale factor below one."""
    assert schur_lyapunov(np.array([[-0.5e-150]]), np.array([[1e145]])) == pytest.approx(1e295, rel=1e-9)


@pytest.mark.parametrize("w", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("rtol", [1e-3, 1e-7])
@pytest.mark.parametrize("offset", [-1.0, 1.0])
def test_search_reaches_a_peak_one_pole_distance_away(w: float, rtol: float, offset: float) -> None:
    zeta = 1e-3
    response = FrequencyResponse.of(*oscillator(w, zeta))
    value, omega = lti.norms._best_peak(response, np.array([0.0, w * (1.0 + offset * zeta), np.inf]), rtol)
    exact = 0.5 / zeta / np.sqrt(1.0 - zeta**2)
    assert exact * (1.0 - 0.1 * rtol) <= value <= exact * (1.0 + 1e-9)
    assert omega == pytest.approx(w * np.sqrt(1.0 - 2.0 * zeta**2), rel=zeta * np.sqrt(rtol))


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_value_is_reached_and_a_dense_grid_stays_below_the_upper_side(seed: int, dt: float | None) -> None:
    """Random systems of three states, two inputs and two outputs with feedthrough; both certificates."""
    rng = np.random.default_rng(seed)
    A, B, C, D = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    A = A - (0.2 + spectral_abscissa(A)) * np.eye(3) if dt is None else 0.9 * A / abs(np.linalg.eigvals(A)).max()
    grid = np.tan(np.linspace(0.0, 0.5 * np.pi, 4001)[:-1]) if dt is None else np.linspace(0.0, np.pi / dt, 4001)

    def gains(w: np.ndarray) -> np.ndarray:
        points = 1j * w if dt is None else np.exp(1j * w * dt)
        return np.linalg.svd(C @ np.linalg.solve(points[:, None, None] * np.eye(3) - A, B) + D, compute_uv=False)[:, 0]

    largest = max(gains(grid).max(), np.linalg.norm(D, 2) if dt is None else 0.0)
    norms = [hinf_norm(A, B, C, D, dt=dt, rtol=1e-6, certificate=name) for name in CERTIFICATES]
    for norm, name in zip(norms, CERTIFICATES):
        assert norm.certificate == name
        assert largest * (1 - 1e-9) <= norm.upper <= norm.value * (1 + 1.01e-6)
        assert largest == pytest.approx(norm.value, rel=1e-4)
        if np.isfinite(norm.omega):
            assert gains(np.array([norm.omega]))[0] == pytest.approx(norm.value, rel=1e-9)
    assert norms[0].value == pytest.approx(norms[1].value, rel=1e-6)


def test_h2_with_several_inputs_and_outputs() -> None:
    """diag(1 / (s + a_i)) between mixing matrices: the squared norm is the sum of m_ij n_ij / (a_i + a_j)."""
    rng = np.random.default_rng(2)
    a, B, C = np.array([0.1, 3.0, 40.0]), rng.normal(size=(3, 4)), rng.normal(size=(2, 3))
    expected = np.sum((B @ B.T) * (C.T @ C) / (a[:, None] + a))
    assert h2_norm(*mixed((-np.diag(a), B, C, np.zeros((2, 4))))) ** 2 == pytest.approx(expected, rel=1e-9)
    z, D = np.array([0.9, -0.5, 0.1]), rng.normal(size=(2, 4))
    expected = np.sum((B @ B.T) * (C.T @ C) / (1.0 - z[:, None] * z)) + np.sum(D**2)
    assert h2_norm(*mixed((np.diag(z), B, C, D)), dt=0.1) ** 2 == pytest.approx(expected, rel=1e-9)


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
    cuts = lti.hinf_level_test._cuts(poles, np.array([0.5, 30.0]), 20.0)
    assert np.array_equal(cuts, np.unique(cuts))
    np.testing.assert_allclose(cuts, law_of_cuts(light, [0.5], 20.0), rtol=1e-9)


def test_cuts_around_a_peak_halve_the_pole_distance_thirteen_times() -> None:
    poles = np.array([-0.2 + 3.0j, -0.2 - 3.0j, -1.0])
    distance = np.hypot(0.2, 0.1)
    steps = distance / 2.0 ** np.arange(14)
    found = np.sort(lti.hinf_level_test._around(2.9, poles))
    np.testing.assert_allclose(found, np.sort([2.9, *(2.9 - steps), *(2.9 + steps)]), rtol=1e-9)
    assert lti.hinf_level_test._around(np.inf, poles).size == 0


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
    gain, bound = lti.hinf_level_test._taylor_bound(
        form, lti.hinf_level_test._residue_products(form), form.residue_norms, centre, half, inverse
    )
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
    _, bound = lti.hinf_level_test._taylor_bound(
        form, lti.hinf_level_test._residue_products(form), form.residue_norms, centre, half, inverse
    )
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
            answer = lti.hinf_level_test._clearly_below(form, form.residue_norms, level, np.array([c]), np.array([h]))
            assert answer.tolist() == [below]
    for h in (0.5, 0.6):  # the interval reaches the circle through the pole
        answer = lti.hinf_level_test._clearly_below(form, form.residue_norms, 1e9, np.array([2.0]), np.array([h]))
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
        for outcome in (interval_test(response, level, np.zeros(0)), hamiltonian_test(*system, level)):
            assert outcome.decided and outcome.below == below
            if not below:
                assert abs(response.at(outcome.frequencies)).max() >= level * (1 - 1e-9)
                assert outcome.frequencies.max() > 2.0 * factor
    for certificate in EVERY:
        norm = hinf_norm(*system, rtol=1e-9, certificate=certificate)
        assert norm.value == pytest.approx(peak, rel=2e-9) and norm.omega == pytest.approx(omega, rel=1e-3)


def covered(
    response: FrequencyResponse, level: float, peak: float | None, monkeypatch: pytest.MonkeyPatch
) -> tuple[bool, int, int]:
    """Answer of the interval test, intervals looked at, and Taylor polynomials computed."""
    looked, computed = [0], [0]
    easy, taylor = lti.hinf_level_test._clearly_below, lti.hinf_level_test._taylor_bound

    def count_easy(form: FrequencyResponse, *rest) -> np.ndarray:
        looked[0] += len(rest[2])
        return easy(form, *rest)

    def count_taylor(form: FrequencyResponse, *rest) -> tuple[np.ndarray, np.ndarray]:
        computed[0] += len(rest[2])
        return taylor(form, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(lti.hinf_level_test, "_clearly_below", count_easy)
        patch.setattr(lti.hinf_level_test, "_taylor_bound", count_taylor)
        below = interval_test(response, level, np.zeros(0), peak).below
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
    assert hamiltonian_test(A, B, C, D, peak * (1 + 1e-6)).below
    found = hamiltonian_test(A, B, C, D, 2.0)
    low, high = np.sort(np.sqrt(np.roots([1.0, 0.04 - 2.0, 1.0 - 1.0 / 2.0**2]).real))
    assert found.frequencies / factor == pytest.approx([low, 0.5 * (low + high), high], rel=1e-6)


@pytest.mark.parametrize(("first", "last"), [(2.96, 3.16), (2.78, 2.98), (2.87, 3.07)])
@pytest.mark.parametrize("inverse", [False, True])
def test_interval_is_covered_from_end_to_end(first: float, last: float, inverse: bool) -> None:
    """The peak at 2.97 rad/s is near its left end, its right end or in its middle; beside it the gain is lower."""
    form = FrequencyResponse.of(*oscillator(3.0, 0.1))
    peak, residue, products = 5.0 / np.sqrt(0.99), form.residue_norms, lti.hinf_level_test._residue_products(form)

    def below(level: float, low: float, high: float) -> bool:
        ends = np.array([[1.0 / high, 1.0 / low]] if inverse else [[low, high]])
        outcome = lti.hinf_level_test._cover(form, products, residue, level, ends, inverse)
        assert outcome.decided
        return outcome.below

    assert below(peak * (1 + 1e-6), first, last) and not below(peak * (1 - 1e-3), first, last)
    assert below(peak * (1 - 1e-3), 3.1, 3.4) and below(peak * (1 - 1e-3), 2.5, 2.8)


def test_interval_that_cannot_be_halved_is_left_undecided() -> None:
    """Two neighbouring numbers beside a pole that is closer to the axis than they are to each other."""
    poles = np.array([-1e-20 + 1j, -1e-20 - 1j])
    form = FrequencyResponse(poles, np.ones((1, 2)), np.ones((2, 1)), np.zeros((1, 1)), None)
    products = lti.hinf_level_test._residue_products(form)
    ends = np.array([[1.0, np.nextafter(1.0, 2.0)]])
    outcome = lti.hinf_level_test._cover(form, products, form.residue_norms, 1.0, ends, False)
    assert (outcome.below, outcome.decided, len(outcome.frequencies)) == (False, False, 0)


def test_middles_stand_between_neighbouring_crossings() -> None:
    """Two peaks: four crossings and the three middles; at the level of the feedthrough infinity is the answer."""
    found = hamiltonian_test(*sum_of(oscillator(1.0, 0.1), oscillator(10.0, 0.1)), 2.0).frequencies
    low, high = np.sort(np.sqrt(np.roots([1.0, 0.04 - 2.0, 1.0 - 1.0 / 2.0**2]).real))
    crossings = np.array([low, high, 10.0 * low, 10.0 * high])
    assert found[::2] == pytest.approx(crossings, rel=1e-6)
    assert found[1::2] == pytest.approx(0.5 * (crossings[:-1] + crossings[1:]), rel=1e-6)
    one = np.eye(1)
    assert hamiltonian_test(-one, one, one, one, 1.0).frequencies.tolist() == [np.inf]
