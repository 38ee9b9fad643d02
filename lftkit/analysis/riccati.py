"""Riccati equations, continuous and discrete, the Stein equation, and normalised coprime factors.

Coprime factors are a system, stable or not, as the quotient of two stable ones.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS
from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.regular_solve import regular_solve
from lftkit.support.settings import AlgorithmSettings

UNBOUNDED = "the discrete Riccati equation has no bounded solution"


@dataclass(frozen=True)
class RiccatiSettings(AlgorithmSettings):
    """Numbers of the solution of Riccati and Stein equations.

    Attributes
    ----------
    residual : residual of a solution, relative to the largest term of the equation, at most
    refined : residual, likewise, of a solution that needs no refinement
    newton_steps : steps of refinement, at most
    newton_gain : part of the residual that each step must leave at most: near to a solution whose closed loop has poles
        on the axis, which is none here, a step leaves a quarter
    zero : difference of two matrices, relative to the larger one, that is zero but for rounding
    doublings : steps of the sums by doubling, at most
    """

    residual: float = 1e-6
    refined: float = 1e-12
    newton_steps: int = 4
    newton_gain: float = 1e-2
    zero: float = 1e-13
    doublings: int = 64


SETTINGS = RiccatiSettings()


def riccati(
    A: FloatArray,
    B: FloatArray,
    Q: FloatArray,
    R: FloatArray,
    S: FloatArray | None = None,
    settings: RiccatiSettings = SETTINGS,
) -> FloatArray | None:
    """Stabilising solution of a continuous Riccati equation; None where there is none.

    Where the Hamiltonian matrix has eigenvalues on the imaginary axis, the solver can return a matrix that solves
    nothing, depending on rounding: the residual and the closed loop are checked. Where the solver loses digits, as with
    inputs and outputs in units of very different size, Newton's method restores them (Kleinman, IEEE TAC 13, 1968).
    LAPACK's reordering of eigenvalues can fail on an equation that has a solution; it is then solved without balancing.
    Stable modes that cost nothing, of which the solution is zero, are taken out first: slow ones, as those of weights,
    magnify the rounding of the solver until its solution is indefinite or none.
    """
    if not len(A):
        return np.zeros_like(A)
    with warnings.catch_warnings():
        for kind in (linalg.LinAlgWarning, RuntimeWarning):  # judged by the residual, as is what Newton's method adds
            warnings.simplefilter("ignore", kind)
        try:
            through = np.zeros_like(B.T) if S is None else regular_solve(R, S.T)
            rest, square = A - B @ through, np.zeros_like(Q) if S is None else S @ through
            least = settings.zero * max(float(np.abs(M).max(initial=0.0)) for M in (Q, square))
            free = _free_modes(rest, Q - square, least, settings.zero)
            if not free.size:
                return _confirmed(A, B, Q, R, S, _solution(A, B, Q, R, S), settings)
            W = linalg.qr(free)[0][:, free.shape[1] :]
            if not W.size:
                return np.zeros_like(A)
            cost = W.T @ (Q - square) @ W
            reduced = W.T @ rest @ W, W.T @ B, np.where(np.abs(cost) > least, cost, 0.0), R, None
            X = _confirmed(*reduced, _solution(*reduced), settings)
            return None if X is None else W @ X @ W.T
        except (linalg.LinAlgError, ValueError):
            return None


def _free_modes(A: FloatArray, Q: FloatArray, least: float, zero: float) -> FloatArray:
    """Orthonormal basis (n, k) of the stable modes of A that Q sees by less than `least`."""
    basis = _kernel(Q, least)
    while basis.size:
        image = A @ basis
        kept = _kernel(image - basis @ (basis.T @ image), zero * float(linalg.norm(A)))
        if kept.shape[1] == basis.shape[1]:
            break
        basis = basis @ kept
    if not basis.size:
        return basis
    _, vectors, count = linalg.schur(basis.T @ A @ basis, sort="lhp")
    return np.asarray(basis @ vectors[:, :count])


def _kernel(matrix: FloatArray, least: float) -> FloatArray:
    """Orthonormal basis of what a matrix maps to less than `least` of its own size."""
    _, sizes, V = linalg.svd(matrix)
    return np.asarray(V[np.count_nonzero(sizes > least) :].T)


def _confirmed(
    A: FloatArray,
    B: FloatArray,
    Q: FloatArray,
    R: FloatArray,
    S: FloatArray | None,
    X: FloatArray,
    settings: RiccatiSettings,
) -> FloatArray | None:
    """The solution, refined by Newton's method where it needs it; None if it is none, or not stabilising.

    Just beyond the end of the levels that have one, with poles of the closed loop on the axis but for rounding, the
    residual is small, too; a step of Newton's method leads from there to a loop that is not stable.
    """
    best, least = None, np.inf
    for _ in range(settings.newton_steps + 1):
        F = -regular_solve(R, B.T @ X + (0.0 if S is None else S.T))
        terms = A.T @ X, Q, F.T @ R @ F
        residual = terms[0] + terms[0].T + terms[1] - terms[2]
        largest = max(np.abs(M).max(initial=0.0) for M in terms)
        size = float(np.abs(residual).max(initial=0.0) / largest) if largest else 0.0
        closed = A + B @ F
        poles = np.asarray(linalg.eigvals(closed), dtype=complex)
        stable = float(poles.real.max(initial=-np.inf)) < 0.0
        if least <= settings.residual and not stable:
            return None
        if not (size < least and stable):
            break
        gained, least, best = size <= settings.newton_gain * least, size, X
        if not gained or size <= settings.refined:
            break
        X = X + linalg.solve_continuous_lyapunov(closed.T, -residual)
    return best if least <= settings.residual else None


def _solution(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray | None) -> FloatArray:
    try:
        return np.asarray(linalg.solve_continuous_are(A, B, Q, R, s=S), dtype=float)
    except linalg.LinAlgError:  # a ValueError, too: there is no solution
        raise
    except ValueError:  # the reordering
        return np.asarray(linalg.solve_continuous_are(A, B, Q, R, s=S, balanced=False), dtype=float)


def discrete_riccati(A: FloatArray, G: FloatArray, Q: FloatArray, settings: RiccatiSettings = SETTINGS) -> FloatArray:
    """Stabilising solution X of ``X = A' X (I + G X)^-1 A + Q`` for a stable A, by doubling.

    The doubling keeps positive semidefinite what is, and needs no eigenvectors: modes of very different speed do it no
    harm. Source: Chu, Fan, Lin and Wang, Int. J. Control 77 (2004). Newton's method (Hewer, IEEE TAC 16, 1971) restores
    the digits that it loses.

    Parameters
    ----------
    A, G, Q : ndarray, shape (n, n)
        G and Q positive semidefinite: ``B R^-1 B'`` and ``C' C``.
    settings : RiccatiSettings

    Raises
    ------
    ArithmeticError, LinAlgError
        The iteration does not converge, or what it converges to is no solution.
    """
    eye, spread, power, X = np.eye(len(A)), G, A, Q
    with np.errstate(over="ignore", invalid="ignore"):  # judged by what is finite
        for _ in range(settings.doublings):
            if not all(np.isfinite(M).all() for M in (spread, power, X)):
                raise ArithmeticError(UNBOUNDED)
            factors = linalg.lu_factor(eye + spread @ X)
            advanced, further = linalg.lu_solve(factors, power), linalg.lu_solve(factors, spread)
            step = power.T @ X @ advanced
            spread, X = _symmetric(spread + power @ further @ power.T), X + _symmetric(step)
            power = power @ advanced
            if np.abs(step).max(initial=0.0) <= EPS * np.abs(X).max(initial=0.0):
                break
    if not np.isfinite(X).all():
        raise ArithmeticError(UNBOUNDED)
    best, least = X, np.inf
    for _ in range(settings.newton_steps + 1):
        closed = regular_solve(eye + G @ X, A)
        residual = X - A.T @ X @ closed - Q
        part = float(np.abs(residual).max(initial=0.0) / max(np.abs(X).max(initial=0.0), np.finfo(float).tiny))
        if not part < least:
            break
        best, least = X, part
        if least <= settings.refined or not np.abs(linalg.eigvals(closed)).max(initial=0.0) < 1.0:
            break
        X = X - _symmetric(stein(closed.T, residual, settings))
    if not least <= settings.residual:
        raise ArithmeticError("the discrete Riccati equation has no solution to the precision of its terms")
    return best


def stein(A: FloatArray, W: FloatArray, settings: RiccatiSettings = SETTINGS) -> FloatArray:
    """Solution of ``P = A P A' + W`` for a stable A: ``sum_k A^k W (A^k)'`` (Smith's method, squared).

    Raises
    ------
    ArithmeticError
        A sum that is not finite.
    """
    P, power = W, A
    with np.errstate(over="ignore", invalid="ignore"):  # judged by what is finite
        for _ in range(settings.doublings):
            step = power @ P @ power.T
            P = P + step
            if not np.abs(step).max(initial=0.0) > EPS * np.abs(P).max(initial=0.0):
                break
            power = power @ power
    if not np.isfinite(P).all():
        raise ArithmeticError("the Stein equation has no bounded solution")
    return P


def _symmetric(M: FloatArray) -> FloatArray:
    return 0.5 * (M + M.T)


def right_coprime_factors(plant: Matrices, name: str = "system") -> Matrices:
    """``[N; M]`` of ``G = N M^-1`` with ``N~N + M~M = 1``, in continuous time.

    The transposes of those of ``G'`` are the left ones. Source: Vidyasagar, IEEE TAC 33 (1988).

    Parameters
    ----------
    plant : tuple of ndarray
        A (n, n), B (n, m), C (p, n), D (p, m) of G.
    name : str
        For messages.

    Returns
    -------
    tuple of ndarray
        Matrices of ``[N; M]``, n states, m inputs, p + m outputs.

    Raises
    ------
    ValueError
        A mode that is not stable and not reached or not seen.

    Examples
    --------
    Of ``1 / s`` they are ``1 / (s + 1)`` and ``s / (s + 1)``:

    >>> one = np.eye(1)
    >>> A, B, C, D = right_coprime_factors((0.0 * one, one, one, 0.0 * one))
    >>> A.round(9).tolist(), C.round(9).tolist(), D.tolist()
    ([[-1.0]], [[1.0], [-1.0]], [[0.0], [1.0]])
    """
    A, B, C, D = plant
    S = np.eye(B.shape[1]) + D.T @ D
    X = riccati(A, B, C.T @ C, S, C.T @ D) if len(A) else A
    Y = riccati(A.T, C.T, B @ B.T, np.eye(len(C)) + D @ D.T, B @ D.T) if len(A) else A
    if X is None or Y is None:  # without Y the factors have a common zero that is not stable
        raise InputError(f"{name}: the system must be stabilisable and detectable to rounding, got one that is not")
    F = -linalg.solve(S, D.T @ C + B.T @ X)
    # Symmetric square root of a positive definite matrix
    values, vectors = linalg.eigh(S)
    into = linalg.inv(np.asarray(vectors * np.sqrt(values) @ vectors.T))
    return A + B @ F, B @ into, np.vstack([C + D @ F, F]), np.vstack([D @ into, into])
