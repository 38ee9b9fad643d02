"""Algebra of linear fractional transformations as matrices: the first `q` inputs and outputs are the Delta channels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, IntArray, Matrices
from lftkit.errors import InputError


def solve_loop(matrix: FloatArray, right: FloatArray, requirement: str) -> FloatArray:
    """Solve; a singular matrix is a ValueError that begins with `requirement`.

    A matrix that looks singular is judged once more after scaling of its rows and columns.
    """
    if matrix.size == 0:
        return np.zeros_like(right)
    solution = _solution(matrix, right)
    if solution is None:
        rows = _powers(np.abs(matrix).max(axis=1))
        by_rows = matrix * rows[:, None]
        columns = _powers(np.abs(by_rows).max(axis=0))
        solution = _solution(by_rows * columns, right * rows[:, None])
        if solution is None:
            raise InputError(f"{requirement}, got a singular algebraic loop")
        solution = solution * columns[:, None]
    return solution


def _solution(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Solution; None where a pivot is small beside the largest entry."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", linalg.LinAlgWarning)  # the pivots are checked below
        lu, pivots = linalg.lu_factor(matrix, check_finite=False)
        smallest = np.min(np.abs(np.diag(lu)))
    if not smallest > 1e-14 * np.max(np.abs(matrix)):
        return None
    x = linalg.lu_solve((lu, pivots), right, check_finite=False)
    # One step of iterative refinement makes the solution accurate row by row when the rows differ in scale (Skeel
    # 1980). Slow motion of a free body needs it: the net force is a small difference of large forces.
    return np.asarray(x + linalg.lu_solve((lu, pivots), right - matrix @ x, check_finite=False))


def _powers(sizes: FloatArray) -> FloatArray:
    """Reciprocals of sizes, rounded to powers of two: scaling by them changes no digit."""
    return np.asarray(np.exp2(-np.round(np.log2(np.where(sizes > 0, sizes, 1.0)))))


def at_deviations(M: Matrices, delta: FloatArray, requirement: str) -> Matrices:
    """``F_u(M, diag(delta))`` with real `delta` (q,); entries that are zero change no bit.

    Raises
    ------
    ValueError
        An algebraic loop that is not well posed; the message begins with `requirement`.
    """
    q, n = len(delta), len(M[0])
    active = np.flatnonzero(delta)
    A, B, C, D = M[0], M[1][:, q:], M[2][q:], M[3][q:, q:]
    if active.size:
        loop = np.eye(active.size) - M[3][np.ix_(active, active)] * delta[active]
        right = np.hstack([M[2][active], M[3][active, q:]])
        w = delta[active, None] * solve_loop(loop, right, requirement)
        to_states, to_outputs = M[1][:, active], M[3][q:, active]
        A = A + to_states @ w[:, :n]
        B = B + to_states @ w[:, n:]
        C = C + to_outputs @ w[:, :n]
        D = D + to_outputs @ w[:, n:]
    return A, B, C, D


def at_system(M: Matrices, delta: Matrices, requirement: str) -> Matrices:
    """``F_u(M, Delta)`` with a system Delta (q inputs, q outputs), whose states come last."""
    q, n = delta[3].shape[0], len(M[0])
    whole = side_by_side([M, delta], [0, 0])
    m, p = M[1].shape[1] - q, M[2].shape[0] - q
    S = np.zeros((q + m + q, q + p + q))
    S[:q, q + p :], S[q + m :, :q] = np.eye(q), np.eye(q)
    E = np.zeros((q + m + q, m))
    E[q : q + m] = np.eye(m)
    So = np.hstack([np.zeros((p, q)), np.eye(p), np.zeros((p, q))])
    closed = close_loop(whole, 0, S, E, So, np.zeros((p, m)), requirement)
    return closed if n or len(delta[0]) else (np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), closed[3])


def side_by_side(parts: Sequence[Matrices], q: Sequence[int]) -> Matrices:
    """All systems in one, unconnected; the Delta channels of all come first."""

    def split(key: int, by_rows: bool, by_columns: bool) -> FloatArray:
        matrices = [part[key] for part in parts]
        block = linalg.block_diag(*matrices) if matrices else np.zeros((0, 0))
        rows = _delta_first([m.shape[0] for m in matrices], q) if by_rows else slice(None)
        columns = _delta_first([m.shape[1] for m in matrices], q) if by_columns else slice(None)
        return np.asarray(block)[rows][:, columns]

    return split(0, False, False), split(1, False, True), split(2, True, False), split(3, True, True)


def _delta_first(sizes: Sequence[int], delta: Sequence[int]) -> list[int]:
    starts = [sum(sizes[:i]) for i in range(len(sizes))]
    first = [s + i for s, q in zip(starts, delta) for i in range(q)]
    rest = [s + i for s, q, size in zip(starts, delta, sizes) for i in range(q, size)]
    return first + rest


def series(first: Matrices, second: Matrices) -> Matrices:
    """``second`` after ``first``, whose states come first."""
    (A1, B1, C1, D1), (A2, B2, C2, D2) = first, second
    A = np.block([[A1, np.zeros((len(A1), len(A2)))], [B2 @ C1, A2]])
    return A, np.vstack([B1, B2 @ D1]), np.hstack([D2 @ C1, C2]), D2 @ D1


def close_loop(
    M: Matrices,
    q: int,
    S: FloatArray,
    E: FloatArray,
    So: FloatArray,
    Eo: FloatArray,
    requirement: str = "these connections must be well posed",
) -> Matrices:
    """Close ``u = S y + E u_ext``, read ``So y + Eo u_ext``; the Delta channels stay."""
    n = len(M[0])
    A, B, C, D = M
    Bu, Cy = B[:, q:], C[q:]
    Dyy, Dyd, Ddy = D[q:, q:], D[q:, :q], D[:q, q:]
    # u as a function of [x, w_delta, u_ext]
    right = np.hstack([S @ Cy, S @ Dyd, E])
    U = solve_loop(np.eye(S.shape[0]) - S @ Dyy, right, requirement)
    Ux, Uw, Ue = U[:, :n], U[:, n : n + q], U[:, n + q :]
    Yx, Yw, Ye = Cy + Dyy @ Ux, Dyd + Dyy @ Uw, Dyy @ Ue
    return (
        A + Bu @ Ux,
        np.hstack([B[:, :q] + Bu @ Uw, Bu @ Ue]),
        np.vstack([C[:q] + Ddy @ Ux, So @ Yx]),
        np.block([[D[:q, :q] + Ddy @ Uw, Ddy @ Ue], [So @ Yw, So @ Ye + Eo]]),
    )


def exchanged(M: Matrices, i: IntArray, o: IntArray, requirement: str) -> Matrices:
    """Inputs `i` and outputs `o` exchanged, in their places: what was an output is an input."""
    A, B, C, D = M
    D11 = D[np.ix_(o, i)]
    Dinv = solve_loop(D11, np.eye(i.size), requirement)
    keep_i = np.setdiff1d(np.arange(D.shape[1]), i)
    keep_o = np.setdiff1d(np.arange(D.shape[0]), o)
    Bi, Co = B[:, i], C[o]
    K, X = Dinv @ Co, Dinv @ D[np.ix_(o, keep_i)]
    B, C, out = B.copy(), C.copy(), D.copy()
    D_ki = D[np.ix_(keep_o, i)]
    B[:, i], B[:, keep_i] = Bi @ Dinv, B[:, keep_i] - Bi @ X
    C[o], C[keep_o] = -K, C[keep_o] - D_ki @ K
    out[np.ix_(o, i)], out[np.ix_(o, keep_i)] = Dinv, -X
    out[np.ix_(keep_o, i)] = D_ki @ Dinv
    out[np.ix_(keep_o, keep_i)] = D[np.ix_(keep_o, keep_i)] - D_ki @ X
    return A - Bi @ K, B, C, out


def mapped(M: Matrices, q: int, left: FloatArray, right: FloatArray) -> Matrices:
    """Outputs multiplied by `left` and inputs by `right`, without the Delta channels."""
    L, R = np.asarray(linalg.block_diag(np.eye(q), left)), np.asarray(linalg.block_diag(np.eye(q), right))
    return M[0], M[1] @ R, L @ M[2], L @ M[3] @ R


def response(M: Matrices, point: complex) -> ComplexArray:
    """``D + C (point I - A)^-1 B``.

    Raises
    ------
    ValueError
        A pole at the point.
    """
    n = len(M[0])
    if n == 0:
        return np.asarray(M[3], dtype=complex)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", linalg.LinAlgWarning)  # zero pivots are looked for below
        factors = linalg.lu_factor(point * np.eye(n) - M[0])
    if not np.all(np.diag(factors[0])):
        raise InputError(f"point must not be a pole, got {point}")
    inner = linalg.lu_solve(factors, M[1].astype(complex))
    return np.asarray(M[3] + M[2] @ inner, dtype=complex)
