"""Linear matrix inequalities by a primal-dual interior-point method, of which the dual matrices are of interest.

Minimise ``c' v`` where each ``C_k + sum v_i F_ki >= 0``; the dual matrices Z_k >= 0 have ``sum_k <F_ki, Z_k> = c_i``.
Directions of Helmberg, Rendl, Vanderbei and Wolkowicz (1996) with the predictor and corrector of Mehrotra, from a start
that need not be feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.support.settings import AlgorithmSettings

Point = tuple[FloatArray, list[FloatArray], list[FloatArray]]
"""Variables, slack and dual matrices."""


@dataclass(frozen=True)
class ProgramSettings(AlgorithmSettings):
    """Numbers of the interior-point method.

    Attributes
    ----------
    boundary : part of the way to the boundary that a step takes
    start : size of the matrices of the start over those of the inequalities
    feasible : error of the equations above which steps do not lower the products by more than the part `centred`
    largest : size of the variables at which there is no optimum
    enough : mean product of slack and dual matrices, relative to the objective, at which it is reached
    most : iterates, at most
    """

    boundary: float = 0.9
    start: float = 1e3
    feasible: float = 1e-6
    largest: float = 1e12
    enough: float = 1e-9
    most: int = 60


SETTINGS = ProgramSettings()


@dataclass(frozen=True)
class MatrixInequality:
    """``constant + sum v_i F_i >= 0``, shapes (N, N) and (m, N, N)."""

    constant: FloatArray
    F: FloatArray


def iterates(
    c: FloatArray, inequalities: Sequence[MatrixInequality], centred: float = 0.7, settings: ProgramSettings = SETTINGS
) -> Iterator[tuple[FloatArray, tuple[FloatArray, ...]]]:
    """Variables and dual matrices of the method's iterates, better and better until rounding ends it.

    Parameters
    ----------
    c : ndarray, shape (m,)
    inequalities : sequence of MatrixInequality
    centred : float
        Part of the products that is aimed at while the equations are not met: the nearer to 1, the better they are met
        at the end, and the larger the variables.
    settings : ProgramSettings
        Numbers of the method.

    Examples
    --------
    The largest eigenvalue of a symmetric matrix is the least v with ``v I - M >= 0``:

    >>> M = np.array([[2.0, 1.0], [1.0, 2.0]])
    >>> *_, (v, dual) = iterates(np.ones(1), [MatrixInequality(-M, np.eye(2)[None])])
    >>> round(float(v[0]), 6), dual[0].round(5).tolist()
    (3.0, [[0.5, 0.5], [0.5, 0.5]])
    """
    kept = [one for one in inequalities if len(one.constant)]
    size = sum(len(one.constant) for one in kept)
    v: FloatArray = np.zeros(len(c))
    largest = max(1.0, float(np.abs(c).max()), *(float(np.abs(one.constant).max()) for one in kept))
    slack, dual = ([settings.start * largest * np.eye(len(one.constant)) for one in kept] for _ in range(2))
    for _ in range(settings.most):
        try:
            v, slack, dual = _step(c, kept, (v, slack, dual), centred, settings)
        except (linalg.LinAlgError, ValueError):
            return
        if not np.all(np.isfinite(v)) or float(np.abs(v).max()) > settings.largest:
            return
        whole = iter(dual)
        yield v, tuple(next(whole) if len(one.constant) else one.constant for one in inequalities)
        if _product(dual, slack) / size < settings.enough * float(np.abs(c @ v)):
            return


def _step(
    c: FloatArray,
    inequalities: Sequence[MatrixInequality],
    point: Point,
    centred: float,
    settings: ProgramSettings,
) -> Point:
    """One predictor and corrector."""
    v, slack, dual = point
    inverses = [np.asarray(linalg.cho_solve((lower_factor(S), True), np.eye(len(S)))) for S in slack]
    off = [one.constant + np.tensordot(v, one.F, 1) - S for one, S in zip(inequalities, slack)]
    rows = [one.F.reshape(len(c), -1) for one in inequalities]
    H: Any = sum(f @ (Z @ one.F @ I).reshape(len(c), -1).T for f, Z, one, I in zip(rows, dual, inequalities, inverses))
    factor = _factor(0.5 * (H + H.T))
    size = sum(map(len, slack))
    mean = _product(dual, slack) / size

    def direction(targets: list[FloatArray]) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
        """Step to ``Z S = target``."""
        goals = [T @ I - Z @ one_off @ I for T, Z, one_off, I in zip(targets, dual, off, inverses)]
        right = sum(f @ (0.5 * (G + G.T)).ravel() for f, G in zip(rows, goals)) - c
        dv = factor(right)
        dv = dv + factor(right - H @ dv)
        dS = [np.tensordot(dv, one.F, 1) + one_off for one, one_off in zip(inequalities, off)]
        dZ = [T @ I - Z - Z @ D @ I for T, Z, D, I in zip(targets, dual, dS, inverses)]
        return dv, dS, [0.5 * (D + D.T) for D in dZ]

    _, dS, dZ = direction([np.zeros_like(S) for S in slack])
    p, d = _length(dual, dZ, settings.boundary), _length(slack, dS, settings.boundary)
    ahead = _product([Z + p * D for Z, D in zip(dual, dZ)], [S + d * D for S, D in zip(slack, dS)]) / size
    missing = float(np.abs(sum(f @ Z.ravel() for f, Z in zip(rows, dual)) - c).max())
    feasible = missing < settings.feasible * float(np.abs(c).max())
    feasible = feasible and max(float(np.abs(one).max()) for one in off) < settings.feasible
    centring = min(1.0, max(ahead / mean, 0.0) ** 2) if min(p, d) > 0.1 else 0.5
    centring = centring if feasible else max(centring, centred)
    targets = [centring * mean * np.eye(len(S)) - a @ b for S, a, b in zip(slack, dZ, dS)]
    dv, dS, dZ = direction(targets)
    p, d = _length(dual, dZ, settings.boundary), _length(slack, dS, settings.boundary)
    return v + d * dv, [S + d * D for S, D in zip(slack, dS)], [Z + p * D for Z, D in zip(dual, dZ)]


def lower_factor(matrix: FloatArray) -> FloatArray:
    """Cholesky factor L of ``L L'``; a LinAlgError where the matrix is not positive definite."""
    factor, info = linalg.lapack.dpotrf(matrix, lower=1)
    if info:
        raise linalg.LinAlgError("the matrix must be positive definite, got another")
    return np.asarray(factor)


def _factor(H: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Solver with a positive definite matrix, its rows and columns scaled; a little is added where it is singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    scaled = H * scale[:, None] * scale
    for shift in (0.0, 1e-14, 1e-12, 1e-10):
        lower, info = linalg.lapack.dpotrf(scaled + shift * np.eye(len(H)), lower=1)
        if not info:
            break
    else:
        raise linalg.LinAlgError("the equations must be regular, got singular ones")
    return lambda right: np.asarray(scale * linalg.cho_solve((lower, True), scale * right))


def _product(dual: Sequence[FloatArray], slack: Sequence[FloatArray]) -> float:
    return sum(float(np.sum(Z * S)) for Z, S in zip(dual, slack))


def _length(matrices: Sequence[FloatArray], steps: Sequence[FloatArray], boundary: float) -> float:
    """Part of a step that keeps all matrices positive definite."""
    longest = 1.0
    for M, step in zip(matrices, steps):
        L = lower_factor(M)
        inner = linalg.solve_triangular(L, linalg.solve_triangular(L, step, lower=True).T, lower=True)
        least = float(linalg.eigvalsh(0.5 * (inner + inner.T))[0])
        if least < 0.0:
            longest = min(longest, -boundary / least)
    return longest
