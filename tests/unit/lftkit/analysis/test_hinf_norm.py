"""H-infinity norms of systems whose norm is known in closed form, and the two level tests alone."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from support.resonant_systems import CERTIFICATES, EVERY, mixed, oscillator, resonator, structure, sum_of

import lftkit.analysis.norms
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.interval_norm import IntervalModel
from lftkit.analysis.hinf.level_iteration import Peak
from lftkit.analysis.hinf.peak_search import highest_peak_of
from lftkit.analysis.norms import h2_norm, hinf_norm, schur_lyapunov, spectral_abscissa


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
    for certificate, found in (("auto", "hamiltonian"), ("interval", "interval")):
        norm = hinf_norm(*resonator(radius, angle), dt=dt, certificate=certificate)
        assert norm.value == pytest.approx(1.0 / ((1 - radius**2) * np.sin(angle)), rel=1e-7)
        assert norm.omega * dt == pytest.approx(np.arccos(np.cos(angle) * (1 + radius**2) / (2 * radius)), rel=1e-6)
        assert norm.certificate == found


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
        ({"dt": -1.0}, r"dt must be a sampling period, .*, got -1\.0"),
        ({"dt": 0.1, "certificate": "hamiltonian"}, "must be auto or interval in discrete time, got 'hamiltonian'"),
        ({"dt": np.nan}, "dt must be a sampling period, .*, got nan"),
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


def test_level_that_only_the_modal_form_exceeds_is_left_to_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """The modal form claims a peak of 2 where a direct solution has 0.1: neither bound follows it."""
    lag = [[-1.0]], [[1.0]], [[1.0]], [[0.0]]
    monkeypatch.setattr(IntervalModel, "higher_peak", lambda *_: Peak(10.0, 2.0))
    norm = hinf_norm(*lag, rtol=1e-2, certificate="interval")
    assert norm.value == pytest.approx(1.0, rel=1e-9) and norm.omega == 0.0
    assert (norm.upper, norm.certificate) == (pytest.approx(1.01, rel=1e-9), "hamiltonian")


@pytest.mark.parametrize(("error", "certificate"), [(5e-5, "interval"), (1.5e-4, "hamiltonian")])
def test_modal_form_is_believed_up_to_a_tenth_of_the_tolerance(
    error: float, certificate: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = FrequencyResponse.of
    monkeypatch.setattr(
        lftkit.analysis.norms.FrequencyResponse,
        "of",
        lambda A, B, C, D, **options: honest(A, B * (1 + error), C, D, **options),
    )
    norm = hinf_norm(*structure(0.0), rtol=1e-3, certificate="interval")
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
    omega, value, _ = highest_peak_of(response, np.array([0.0, w * (1.0 + offset * zeta), np.inf]), rtol)
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
    names = CERTIFICATES if dt is None else ["interval"]
    norms = [hinf_norm(A, B, C, D, dt=dt, rtol=1e-6, certificate=name) for name in names]
    for norm, name in zip(norms, names):
        assert norm.certificate == name
        assert largest * (1 - 1e-9) <= norm.upper <= norm.value * (1 + 1.01e-6)
        assert largest == pytest.approx(norm.value, rel=1e-4)
        if np.isfinite(norm.omega):
            assert gains(np.array([norm.omega]))[0] == pytest.approx(norm.value, rel=1e-9)
    assert norms[0].value == pytest.approx(norms[-1].value, rel=1e-6)


def test_h2_with_several_inputs_and_outputs() -> None:
    """diag(1 / (s + a_i)) between mixing matrices: the squared norm is the sum of m_ij n_ij / (a_i + a_j)."""
    rng = np.random.default_rng(2)
    a, B, C = np.array([0.1, 3.0, 40.0]), rng.normal(size=(3, 4)), rng.normal(size=(2, 3))
    expected = np.sum((B @ B.T) * (C.T @ C) / (a[:, None] + a))
    assert h2_norm(*mixed((-np.diag(a), B, C, np.zeros((2, 4))))) ** 2 == pytest.approx(expected, rel=1e-9)
    z, D = np.array([0.9, -0.5, 0.1]), rng.normal(size=(2, 4))
    expected = np.sum((B @ B.T) * (C.T @ C) / (1.0 - z[:, None] * z)) + np.sum(D**2)
    assert h2_norm(*mixed((np.diag(z), B, C, D)), dt=0.1) ** 2 == pytest.approx(expected, rel=1e-9)
