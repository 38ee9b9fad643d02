"""Contradictions of proven lower bounds computed again, in rational numbers and in 40 digits."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from support.full_order_plants import mixed_sensitivity, random_plant

from lftkit import System, s
from lftkit.proofs.lower_bound import LowerBoundProof
from lftkit.synthesis import lower_bound_proof

Exact = np.ndarray[Any, Any]


def exact(matrix: Any) -> Exact:
    """Rational numbers."""
    return np.array([[Fraction(float(x)) for x in row] for row in matrix], dtype=object).reshape(np.shape(matrix))


def reduced(a: Exact, b: Exact) -> tuple[list[Fraction], Exact]:
    """Pivots of Gaussian elimination without exchanges, and the solution of ``a x = b``."""
    rows, n, pivots = np.hstack([a, b]), len(a), []
    for k in range(n):
        pivots.append(rows[k, k])
        rows[k] = rows[k] / rows[k, k]
        for i in range(k + 1, n):
            rows[i] = rows[i] - rows[i, k] * rows[k]
    for k in reversed(range(n)):
        for i in range(k):
            rows[i] = rows[i] - rows[i, k] * rows[k]
    return pivots, rows[:, n:]


def projected(V: Exact, seen: Exact) -> Exact:
    """Parts of vectors in the kernel of a matrix."""
    V = V - seen.T @ reduced(seen @ seen.T, seen @ V)[1]
    assert not (seen @ V).any()
    return V


def half(A: Exact, B: Exact, C: Exact, D: Exact, V: Exact) -> tuple[Exact, Fraction, Fraction]:
    """S and the sums of squares of outputs and inputs, of vectors of states and inputs."""
    x, w = V[: len(A)], V[len(A) :]
    rate, z = A @ x + B @ w, C @ x + D @ w
    return rate @ x.T + x @ rate.T, (z * z).sum(), (w * w).sum()


def check_contradiction(found: LowerBoundProof, noiseless: int) -> None:
    """Sums are zero along measured directions e without noise, and positive beside them."""
    A, B1, B2 = (exact(M) for M in (found.A, found.B[:, :3], found.B[:, 3:]))
    C1, C2, D11 = exact(found.C[:3]), exact(found.C[3:]), exact(found.D[:3, :3])
    D12, D21, e = exact(found.D[:3, 3:]), exact(found.D[3:, :3]), exact(found.C[3 : 3 + noiseless])
    seen, moved = np.vstack([np.hstack([C2, D21]), e @ np.hstack([A, B1])]), np.hstack([B2.T, D12.T])
    S, gained, spent = half(A, B1, C1, D11, projected(exact(found.unseen), seen))
    R, gained_too, spent_too = half(A.T, C1.T, B1.T, D11.T, projected(exact(found.unmoved), moved))
    assert not (e @ S).any()
    left = projected(exact(found.left), e) if noiseless else exact(found.left)
    T = left @ exact(found.right).T
    beside = np.array([[-e[0, 1], e[0, 0]]]) if noiseless else exact(np.eye(len(A)))
    W = np.block([[beside @ S @ beside.T, beside @ T], [(beside @ T).T, R]])
    assert min(reduced(W, 0 * W[:, :1])[0]) > 0
    g = Fraction(found.level)
    assert gained + gained_too - g * g * (spent + spent_too) - 2 * g * np.trace(T) > 0


@pytest.mark.parametrize("n", [1, 2])
def test_the_contradiction_holds_in_exact_arithmetic(n: int) -> None:
    """Rational numbers throughout: vectors projected on the kernel, pivots of the matrix, the sum of inequalities."""
    found = lower_bound_proof(random_plant(3, n), "y", "u").proof
    assert found is not None
    check_contradiction(found, 0)


def test_a_state_without_noise_has_no_sum_of_rates_in_exact_arithmetic() -> None:
    plant = random_plant(3, 2)
    D = plant.D.copy()
    D[3, :3] = 0.0
    found = lower_bound_proof(System(*plant.matrices[:3], D, plant.inputs, plant.outputs), "y", "u").proof
    assert found is not None and found.noiseless.tolist() == [[1.0, 0.0, 0.0]] and not len(found.weightless)
    check_contradiction(found, 1)


def test_decaying_modes_have_no_sum_of_rates_in_40_digits() -> None:
    """A plant and its weight where the measurement ``C2 x + w`` is zero: one mode grows, the other two decay."""
    plant = mixed_sensitivity(1 / ((s - 1) * (s + 2)), (0.6 * s + 1) / (s + 0.01), 0.1)
    found = lower_bound_proof(plant, "y", "u").proof
    assert found is not None and len(found.decaying) == 2 and not len(found.decaying_adjoint)
    with mpmath.workdps(40):
        A, B, C, D, V, U, left, right = (
            mpmath.matrix(array.tolist())
            for array in (found.A, found.B, found.C, found.D, found.unseen, found.unmoved, found.left, found.right)
        )
        F = A - B[:, 0] * C[2, :] / D[2, 0]
        values, rows = mpmath.eig(F, left=True, right=False)
        E = mpmath.matrix([[mpmath.re(rows[k, j]) for j in range(3)] for k in range(3) if mpmath.re(values[k]) < 0])
        x, left = (part - E.T * (E * E.T) ** -1 * (E * part) for part in (V[:3, :], left))
        w, moved = -C[2, :] * x / D[2, 0], mpmath.matrix([[*B[:, 1], *D[:2, 1]]])
        U -= moved.T * (moved * U) / (moved * moved.T)[0, 0]
        p, q = U[:3, :], U[3:, :]
        rate, back = F * x, A.T * p + C[:2, :].T * q
        S, R, T = rate * x.T + x * rate.T, back * p.T + p * back.T, left * right.T
        assert E.rows == 2 and mpmath.mnorm(E * S) < 1e-30 * mpmath.mnorm(S)
        grown, both = mpmath.ones(1, 3), mpmath.zeros(4)
        both[0, 0], both[0, 1:], both[1:, 0] = (grown * S * grown.T)[0, 0], grown * T, (grown * T).T
        both[1:, 1:] = R
        mpmath.cholesky(both)  # raises where it is not positive definite
        z, v = C[:2, :] * x + D[:2, 0] * w, B[:, 0].T * p + D[:2, 0].T * q
        squares = [mpmath.fsum(entry**2 for entry in part) for part in (z, v, w, q)]
        g, trace = mpmath.mpf(found.level), T[0, 0] + T[1, 1] + T[2, 2]
        assert squares[0] + squares[1] - g**2 * (squares[2] + squares[3]) - 2 * g * trace > 0
