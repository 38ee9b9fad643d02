"""Frequency response against control's and against closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest

from lti import Port, state_space
from lti.frequency_response import frequency_grid, frequency_response, singular_values


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
    data = system.data_at({})
    omega = frequency_grid(np.linalg.eigvals(data.A), 1e-2, 1e4, points=60)
    ours = frequency_response(data, omega)
    theirs = control.frequency_response(system.nominal(), omega).complex.transpose(2, 0, 1)
    size = np.abs(theirs).max(axis=(1, 2), keepdims=True)
    assert np.max(np.abs(ours - theirs) / size) < 1e-9


def test_a_jordan_block_falls_back_to_direct_solution() -> None:
    """Three equal real poles in a chain have no basis of eigenvectors."""
    A = -np.eye(3) + np.diag([1.0, 1.0], 1)
    chain = state_space(A, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]], [[0.0]], [Port("u", 1)], [Port("y", 1)])
    omega = np.geomspace(0.01, 100.0, 30)
    expected = 1.0 / (1j * omega + 1.0) ** 3
    np.testing.assert_allclose(frequency_response(chain.data_at({}), omega)[:, 0, 0], expected, rtol=1e-9)


def test_a_torque_held_back_by_a_spring_keeps_its_digits() -> None:
    """Between two masses on a spring an inner torque gives almost no slow motion: the modes cancel."""
    J1, J2, k, d = 1e3, 1.0, 1e6, 1.0
    inertia, stiffness = np.diag([J1, J2]), k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    ground = np.diag([1.0, 0.0])
    damping = d * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1e-1 * ground
    M = np.linalg.inv(inertia)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-M @ (stiffness + ground), -M @ damping]])
    B = np.concatenate([[0.0, 0.0], M @ [-1.0, 1.0]])[:, None]
    system = state_space(A, B, [[1.0, 0, 0, 0]], [[0.0]], [Port("t", 1)], [Port("a", 1)])
    omega = np.geomspace(1e-3, 1e-1, 20)
    exact = [np.linalg.solve(-(w**2) * inertia + 1j * w * damping + stiffness + ground, [-1.0, 1.0])[0] for w in omega]
    ours = frequency_response(system.data_at({}), omega)[:, 0, 0]
    assert np.max(np.abs(ours - exact)) < 1e-6 * np.max(np.abs(exact))


def test_singular_values_of_two_rows_equal_the_general_ones() -> None:
    rng = np.random.default_rng(2)
    H = rng.standard_normal((50, 2, 7)) + 1j * rng.standard_normal((50, 2, 7))
    np.testing.assert_allclose(singular_values(H), np.linalg.svd(H, compute_uv=False), rtol=1e-10)
    np.testing.assert_allclose(singular_values(H.swapaxes(1, 2)), np.linalg.svd(H, compute_uv=False), rtol=1e-10)


def test_grid_lies_on_the_resonances() -> None:
    pole = -0.01 + 3.0j
    grid = frequency_grid([pole, pole.conjugate()], 0.1, 10.0, points=20)
    assert np.min(np.abs(grid - 3.0)) < 1e-12
    assert grid[0] == 0.1 and grid[-1] == 10.0 and np.all(np.diff(grid) > 0)
    with pytest.raises(ValueError, match="expected 0 < low < high"):
        frequency_grid([pole], 1.0, 0.1)
