"""Frequency response against control's and against closed forms."""

from __future__ import annotations

import control
import mpmath
import numpy as np
import pytest
import scipy.linalg
from oracles.accurate_response import extended_response

from lftkit import Port, System, state_space
from lftkit.analysis.batched_linalg import largest_gains, singular_values
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import FrequencyResponse, direct_response, frequency_response, refined_response
from lftkit.analysis.norms import h2_norm, hinf_norm
from lftkit.analysis.real_schur import RealSchur


def test_a_jordan_block_falls_back_to_direct_solution() -> None:
    """Three equal real poles in a chain have no basis of eigenvectors."""
    A = -np.eye(3) + np.diag([1.0, 1.0], 1)
    chain = state_space(A, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]], [[0.0]], [Port("u", 1)], [Port("y", 1)])
    omega = np.geomspace(0.01, 100.0, 30)
    expected = 1.0 / (1j * omega + 1.0) ** 3
    np.testing.assert_allclose(frequency_response(chain.at({}), omega)[:, 0, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("modal", [True, False])
def test_between_is_the_response_times_a_row_and_columns(modal: bool) -> None:
    rng = np.random.default_rng(3)
    A = np.diag(np.full(5, -0.2)) + np.eye(5, k=1) if not modal else rng.standard_normal((5, 5)) - 3.0 * np.eye(5)
    B, C, D = rng.standard_normal((5, 3)), rng.standard_normal((2, 5)), rng.standard_normal((2, 3))
    form = FrequencyResponse.of(A, B, C, D)
    assert form.modal is modal
    omega = np.array([0.1, 0.9, 4.0])
    row = rng.standard_normal(2) + 1j * rng.standard_normal(2)
    columns = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))
    expected = [row @ (C @ np.linalg.solve(1j * w * np.eye(5) - A, B) + D) @ x for w, x in zip(omega, columns.T)]
    np.testing.assert_allclose(form.between(omega, row, columns), expected, rtol=1e-9)


@pytest.mark.parametrize("shape", [(1, 4), (4, 1), (2, 7), (7, 2), (3, 5), (5, 3)])
def test_largest_gain_is_the_first_singular_value(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    H = rng.standard_normal((50, *shape)) + 1j * rng.standard_normal((50, *shape))
    expected = np.array([scipy.linalg.svdvals(h) for h in H])
    np.testing.assert_allclose(singular_values(H), expected, rtol=1e-12)
    np.testing.assert_allclose(largest_gains(H), expected[:, 0], rtol=1e-12)


def test_cancelling_modes_keep_their_digits() -> None:
    """A free chain of masses, forces between neighbours: the slow modes cancel. Against extended precision."""
    n = 5
    k = np.geomspace(1e2, 1e5, n)
    K = np.diag(np.append(k[1:], 0.0) + k) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -1e-5 * K - 1e-2 * np.eye(n)]])
    inner = np.zeros((2 * n, 2))
    inner[2 * n - 3 : 2 * n - 1, 0], inner[2 * n - 2 :, 1] = (1.0, -1.0), (1.0, -1.0)
    C = np.eye(2 * n)[:1]
    system = System(A, inner, C, np.zeros((1, 2)), (Port("f", 1), Port("g", 1)), (Port("y", 1),))
    omega = np.geomspace(1e-3, 1e3, 25)
    truth = extended_response(*system.matrices, omega)
    assert FrequencyResponse.of(*system.matrices).modal
    found = frequency_response(system, omega)
    assert np.max(np.abs(found - truth) / np.abs(truth)) < 1e-9


def test_refined_solution_has_the_digits_that_the_matrices_determine() -> None:
    """A chain of springs from 1 to 1e9 N/m: the direct solution loses what residuals in twice the precision restore."""
    n = 8
    k = np.geomspace(1.0, 1e9, n)
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -1e-3 * np.eye(n)]])
    B, C, D = np.eye(2 * n)[:, -1:], np.eye(2 * n)[n - 1 : n], np.zeros((1, 1))
    exact = response_of_50_digits(A, B, C, 0.0)
    assert exact == pytest.approx(np.sum(1.0 / k), rel=1e-5), "springs in series, the far end free"
    assert refined_response(A, B, C, D, 0.0).item() == pytest.approx(exact, rel=1e-15)


SEEDS = [0, 16, 27, 28, 31, 51]


def lightly_damped(seed: int) -> tuple[np.ndarray, ...]:
    """Pairs over six decades, damping ratios down to 1e-10, in coordinates that mix them: (A, B, C, D).

    Rounded once from 50 digits: the last bits decide which decay is left, and on every machine they are the same.
    """
    rng = np.random.default_rng(seed)
    pairs = [(10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-10, -2)) for _ in range(4)]
    A = scipy.linalg.block_diag(*([[0.0, 1.0], [-w * w, -2.0 * zeta * w]] for w, zeta in pairs))
    with mpmath.workdps(50):
        T = mpmath.qr(mpmath.matrix(rng.standard_normal(A.shape).tolist()))[0] * mpmath.diag(range(1, len(A) + 1))
        mixed = mpmath.inverse(T) * mpmath.matrix(A.tolist()) * T
    n = len(A)
    B, C = rng.standard_normal((n, 1)), rng.standard_normal((1, n))
    return np.array(mixed.tolist(), dtype=float), B, C, np.zeros((1, 1))


def response_of_50_digits(A: np.ndarray, B: np.ndarray, C: np.ndarray, omega: float) -> complex:
    with mpmath.workdps(50):
        shifted = mpmath.mpc(0, omega) * mpmath.eye(len(A)) - mpmath.matrix(A.tolist())
        return complex((mpmath.matrix(C.tolist()) * mpmath.lu_solve(shifted, mpmath.matrix(B.tolist())))[0])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_peak_whose_decay_is_below_the_rounding_of_the_matrix_has_its_digits(seed: int) -> None:
    """LU factors have no digit of the solution there: the norm had been wrong by a factor of up to a hundred."""
    A, B, C, D = lightly_damped(seed)
    norm = hinf_norm(A, B, C, D)
    exact = response_of_50_digits(A, B, C, norm.omega)
    assert norm.value == pytest.approx(abs(exact), rel=1e-9) and norm.upper == pytest.approx(norm.value, rel=1.1e-7)
    omega = np.sort([0.1 * norm.omega, norm.omega, 10.0 * norm.omega])
    found = frequency_response(System(A, B, C, D, [Port("u", 1)], [Port("y", 1)]), omega)[1, 0, 0]
    assert abs(found - exact) <= 1e-8 * abs(exact)


@pytest.mark.parametrize("seed", SEEDS)
def test_h2_norm_of_decays_below_the_rounding_of_the_matrix(seed: int) -> None:
    """By residues of 50 digits; the Lyapunov equation had made 0, infinity or half of it."""
    A, B, C, D = lightly_damped(seed)
    with mpmath.workdps(50):
        poles, V = mpmath.eig(mpmath.matrix(A.tolist()))
        driven, seen = mpmath.lu_solve(V, mpmath.matrix(B.tolist())), mpmath.matrix(C.tolist()) * V
        terms = [(seen[k] * driven[k], pole) for k, pole in enumerate(poles)]
        square = -sum(r * mpmath.conj(q) / (p + mpmath.conj(o)) for r, p in terms for q, o in terms)
        exact = float(mpmath.sqrt(mpmath.re(square)))
    assert h2_norm(A, B, C, D) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    ("A", "pole"), [([[0.0]], 0.0), ([[0.0, 1.0], [0.0, 0.0]], 0.0), ([[0.0, 1.0], [-4.0, 0.0]], 2.0)]
)
def test_a_pole_on_the_axis_is_named(A: np.ndarray, pole: float) -> None:
    """A double integrator has no modal form."""
    A, n = np.array(A), len(A)
    B, C, D = np.ones((n, 1)), np.ones((1, n)), np.zeros((1, 1))
    system = System(A, B, C, D, (Port("u", 1),), (Port("y", 1),))
    message = rf"omega must not be the frequency of a pole on the imaginary axis, got {pole} rad/s"
    for call in (
        lambda: direct_response(A, B, C, D, pole),
        lambda: refined_response(A, B, C, D, pole),
        lambda: FrequencyResponse.of(A, B, C, D).at([1.0, pole]),
        lambda: frequency_response(system, [1.0, pole]),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    beside = FrequencyResponse.of(A, B, C, D).at([pole + 1e-3])
    assert np.abs(beside - direct_response(A, B, C, D, pole + 1e-3)).max() < 1e-12 * np.abs(beside).max()


def test_grid_lies_on_the_resonances() -> None:
    pole = -0.01 + 3.0j
    grid = frequency_grid([pole, pole.conjugate()], 0.1, 10.0, points=20)
    for offset in (-3, -2, -1, 0, 1, 2, 3):
        assert np.min(np.abs(grid - (3.0 + 0.01 * offset))) < 1e-12
    assert len(grid) == 27
    assert grid[0] == 0.1 and grid[-1] == 10.0 and np.all(np.diff(grid) > 0)
    assert len(frequency_grid([-3.0 + 3.0j, 3.0, -0.001 - 1j], 0.1, 10.0, points=20)) == 20
    assert len(frequency_grid([], 0.1, 10.0, per_decade=30)) == 60
    with pytest.raises(ValueError, match=r"low and high must be 0 < low < high, got 1\.0 and 0\.1"):
        frequency_grid([pole], 1.0, 0.1)


def test_grid_goes_around_an_undamped_pole() -> None:
    grid = frequency_grid([2.0j, -2.0j], 0.2, 20.0, points=3)  # the middle of three points is the pole
    nearest = np.sort(np.abs(grid - 2.0))
    assert nearest[0] >= 2e-6 and nearest[1] < 1e-5 and grid[0] < 2.0 < grid[-1]


@pytest.mark.parametrize("order", [1, 2, 7, 40])
def test_solutions_are_those_of_the_linear_equations(order: int) -> None:
    rng = np.random.default_rng(order)
    units = 10.0 ** rng.uniform(-6, 6, order)
    A = rng.standard_normal((order, order)) * units[:, None] / units
    points = np.exp(1j * rng.uniform(0.1, 3.0, 5)) * 4.0 * np.sqrt(order)
    forcing = (rng.standard_normal((order, 5)) + 1j * rng.standard_normal((order, 5))) * units[:, None]
    found = RealSchur.of(A).solve(points, forcing)
    for k, z in enumerate(points):
        left = (z * found[:, k] - A @ found[:, k] - forcing[:, k]) / units
        assert np.abs(left).max() < 1e-13 * order * np.abs(z) * np.abs(found[:, k] / units).max()
    eigenvalues = np.sort_complex(RealSchur.of(A).eigenvalues)
    assert eigenvalues == pytest.approx(np.sort_complex(np.linalg.eigvals(A)), rel=1e-6)


def oscillators(n: int, zeta: float, rng: np.random.Generator):
    w = np.geomspace(0.5, 500.0, n)
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:], A[n:, :n], A[n:, n:] = np.eye(n), -np.diag(w**2), -np.diag(2 * zeta * w)
    B = np.vstack([np.zeros((n, 3)), rng.standard_normal((n, 3))])
    C = np.hstack([rng.standard_normal((2, n)), np.zeros((2, n))])
    return state_space(A, B, C, np.zeros((2, 3)), [Port("f", 3)], [Port("y", 2)])


@pytest.mark.parametrize("zeta", [1e-4, 1e-2, 0.5])
def test_agrees_with_control_at_and_between_resonances(zeta: float) -> None:
    system = oscillators(20, zeta, np.random.default_rng(0))
    data = system.at({})
    omega = frequency_grid(np.linalg.eigvals(data.A), 1e-2, 1e4, points=60)
    ours = frequency_response(data, omega)
    theirs = control.frequency_response(system.nominal().to_control(), omega).complex.transpose(2, 0, 1)
    size = np.abs(theirs).max(axis=(1, 2), keepdims=True)
    assert np.max(np.abs(ours - theirs) / size) < 1e-9
