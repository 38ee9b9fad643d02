"""Contradictions of proven lower bounds computed again, in rational numbers and in 40 digits."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import pytest
from support.full_order_plants import mixed_sensitivity, random_plant

from lftkit import System, s
from lftkit.synthesis import lower_bound_proof

Exact = list[list[Fraction]]


def exact(matrix: Any) -> Exact:
    return [[Fraction(float(x)) for x in row] for row in matrix]


def times(a: Exact, b: Exact) -> Exact:
    columns = list(zip(*b))
    return [[sum((x * y for x, y in zip(row, column)), Fraction(0)) for column in columns] for row in a]


def plus(a: Exact, b: Exact, factor: int = 1) -> Exact:
    return [[x + factor * y for x, y in zip(row, other)] for row, other in zip(a, b)]


def adjoint(a: Exact) -> Exact:
    return [list(row) for row in zip(*a)]


def reduced(a: Exact, b: Exact) -> tuple[list[Fraction], Exact]:
    """Pivots of Gaussian elimination without exchanges, and the solution of ``a x = b``."""
    rows, n, pivots = [list(x) + list(y) for x, y in zip(a, b)], len(a), []
    for k in range(n):
        pivots.append(rows[k][k])
        scaled = [x / rows[k][k] for x in rows[k]]
        rows = [
            scaled if i == k else [x - row[k] * y for x, y in zip(row, scaled)] if i > k else row
            for i, row in enumerate(rows)
        ]
    for k in reversed(range(n)):
        rows = [[x - row[k] * y for x, y in zip(row, rows[k])] if i < k else row for i, row in enumerate(rows)]
    return pivots, [row[n:] for row in rows]


def exact_half(A: Exact, B: Exact, C: Exact, D: Exact, seen: Exact, given: Any) -> tuple[Exact, Fraction, Fraction]:
    """S and the sums of squares of outputs and inputs, of the projections of vectors on the kernel."""
    V = exact(given)
    _, multipliers = reduced(times(seen, adjoint(seen)), times(seen, V))
    V = plus(V, times(adjoint(seen), multipliers), -1)
    assert not any(any(row) for row in times(seen, V))
    x, w = V[: len(A)], V[len(A) :]
    rate, z = plus(times(A, x), times(B, w)), plus(times(C, x), times(D, w))
    product = times(rate, adjoint(x))
    outputs, inputs = (sum((x * x for row in part for x in row), Fraction(0)) for part in (z, w))
    return plus(product, adjoint(product)), outputs, inputs


@pytest.mark.parametrize("n", [1, 2])
def test_the_contradiction_holds_in_exact_arithmetic(n: int) -> None:
    """Rational numbers throughout: vectors projected on the kernel, pivots of the matrix, the sum of inequalities."""
    found = lower_bound_proof(random_plant(3, n), "y", "u").proof
    assert found is not None
    A, B1, B2 = (exact(M) for M in (found.A, found.B[:, :3], found.B[:, 3:]))
    C1, C2, D11 = exact(found.C[:3]), exact(found.C[3:]), exact(found.D[:3, :3])
    D12, D21 = exact(found.D[:3, 3:]), exact(found.D[3:, :3])
    seen = [a + b for a, b in zip(C2, D21)]
    moved = [a + b for a, b in zip(adjoint(B2), adjoint(D12))]
    S, gained, spent = exact_half(A, B1, C1, D11, seen, found.unseen)
    R, gained_too, spent_too = exact_half(*map(adjoint, (A, C1, B1, D11)), moved, found.unmoved)
    T = times(exact(found.left), adjoint(exact(found.right)))
    W = [a + b for a, b in zip(S, T)] + [a + b for a, b in zip(adjoint(T), R)]
    pivots, _ = reduced(W, [[Fraction(0)]] * len(W))
    assert min(pivots) > 0
    g, trace = Fraction(found.level), sum((T[k][k] for k in range(n)), Fraction(0))
    assert gained + gained_too - g * g * (spent + spent_too) - 2 * g * trace > 0


def test_a_state_without_noise_has_no_sum_of_rates_in_exact_arithmetic() -> None:
    """Sums are zero along the measured direction e, and positive beside it: ``S = [0 0; 0 s]`` in its coordinates."""
    plant = random_plant(3, 2)
    D = plant.D.copy()
    D[3, :3] = 0.0
    found = lower_bound_proof(System(*plant.matrices[:3], D, plant.inputs, plant.outputs), "y", "u").proof
    assert found is not None and found.noiseless.tolist() == [[1.0, 0.0, 0.0]] and not len(found.weightless)
    A, B1, B2 = (exact(M) for M in (found.A, found.B[:, :3], found.B[:, 3:]))
    C1, C2, D11 = exact(found.C[:3]), exact(found.C[3:]), exact(found.D[:3, :3])
    D12, D21, e = exact(found.D[:3, 3:]), exact(found.D[3:, :3]), exact(found.C[3:4])
    rate = [times(e, A)[0] + times(e, B1)[0]]
    seen = [a + b for a, b in zip(C2, D21)] + rate
    moved = [a + b for a, b in zip(adjoint(B2), adjoint(D12))]
    S, gained, spent = exact_half(A, B1, C1, D11, seen, found.unseen)
    R, gained_too, spent_too = exact_half(*map(adjoint, (A, C1, B1, D11)), moved, found.unmoved)
    assert times(e, S) == [[0, 0]]
    left = exact(found.left)
    _, multipliers = reduced(times(e, adjoint(e)), times(e, left))
    T = times(plus(left, times(adjoint(e), multipliers), -1), adjoint(exact(found.right)))
    beside = [[-e[0][1], e[0][0]]]
    row = times(beside, T)
    pivots, _ = reduced(
        [times(times(beside, S), adjoint(beside))[0] + row[0]] + [own + rest for own, rest in zip(adjoint(row), R)],
        [[Fraction(0)]] * 3,
    )
    assert min(pivots) > 0
    g, trace = Fraction(found.level), T[0][0] + T[1][1]
    assert gained + gained_too - g * g * (spent + spent_too) - 2 * g * trace > 0


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
