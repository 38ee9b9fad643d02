"""The quadratic program behind every step: a convex quadratic on the unit simplex."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, IntArray, Matrix

MAX_ITERATIONS = 60
PROGRAMS, ADDED, KEPT = 12, 60, 120  # programs of a step, planes added to each, idle ones that are kept


def simplex_minimum(H: FloatArray, a: FloatArray, tolerance: float = 1e-14) -> tuple[FloatArray, float]:
    """Maximise ``a' lam - lam' H lam / 2`` over ``lam >= 0, sum(lam) = 1``; answers lam and minus the maximum.

    This is the dual of ``min_d max_i (a_i + g_i' d) + d' Q d / 2`` with ``H = G Q^-1 G'``; the value answered is the
    decrease that the model predicts (with its quadratic term). Primal-dual interior point, predictor and corrector
    (Mehrotra 1992).

    Parameters
    ----------
    H : ndarray, shape (m, m)
        Positive semidefinite.
    a : ndarray, shape (m,)

    Examples
    --------
    Two opposite slopes, equally active: no descent, equal weights.

    >>> lam, value = simplex_minimum(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.zeros(2))
    >>> lam.round(6).tolist(), round(value, 9)
    ([0.5, 0.5], 0.0)
    """
    m = len(a)
    if m == 1:
        return np.ones(1), float(0.5 * H[0, 0] - a[0])
    diagonal = np.maximum(np.diag(H), 0.0)
    # pieces much steeper than the others (a boundary close by) get variables of their own scale
    middle = float(np.median(diagonal))
    e = np.sqrt(middle / np.maximum(diagonal, middle)) if middle > 0.0 else np.ones(m)
    size = max(float((diagonal * e * e).max()), float(np.ptp(a)), 1e-300)
    top = float(a.max())
    Q, c = H * np.outer(e, e) / size, e * (a - top) / size
    # lam = e mu: minimise mu' Q mu / 2 - c' mu over mu >= 0, e' mu = 1
    mu: FloatArray = np.full(m, 1.0 / float(e.sum()))
    s: FloatArray = np.ones(m)
    nu = 0.0
    columns: FloatArray = np.asfortranarray(Q)  # as LAPACK has a matrix
    hessian: FloatArray = np.empty((m, m), order="F")  # its factor takes its place
    entries = hessian.reshape(-1, order="F")[:: m + 1]
    for _ in range(MAX_ITERATIONS):
        residual = Q @ mu - c - s + nu * e
        gap = float(mu @ s) / m
        if gap < tolerance and np.abs(residual).max() < 1e-12:
            break
        hessian[...] = columns
        entries += s / mu + 1e-14
        factor, failed = linalg.lapack.dpotrf(cast("Matrix", hessian), lower=1, clean=0, overwrite_a=1)
        if failed:
            raise linalg.LinAlgError("the program is not convex")
        rest = (residual, factor, linalg.lapack.dpotrs(factor, e, lower=1)[0], e, mu, s)
        dmu, ds, _ = _newton(-mu * s, *rest)
        step = min(_longest(mu, dmu), _longest(s, ds))
        centre = (float((mu + step * dmu) @ (s + step * ds)) / m / gap) ** 3 if gap > 0 else 0.0
        dmu, ds, dnu = _newton(-mu * s - dmu * ds + centre * gap, *rest)
        step = 0.995 * min(_longest(mu, dmu), _longest(s, ds))
        mu, s, nu = mu + step * dmu, s + step * ds, nu + step * dnu
    lam = np.maximum(e * mu, 0.0)
    lam /= lam.sum()
    return lam, float(0.5 * lam @ H @ lam - a @ lam)


def prox_direction(
    f: FloatArray, G: FloatArray, factor: Any, weight: float, planes: IntArray
) -> tuple[FloatArray, float, IntArray]:
    """Minimise ``max(f + G d) + weight d' H d / 2`` for values f (m,) and slopes G (m, n).

    `factor` is the Cholesky factor of H (n, n) of ``scipy.linalg.cho_factor``. Only the `planes` enter the first
    quadratic program, others are added while they are violated. Answers d (n,), the decrease that the linear model
    predicts, and the planes of the last program.
    """
    current, linear = float(f.max()), f
    d: FloatArray = np.zeros(G.shape[1])
    for _ in range(PROGRAMS):
        chosen = linalg.cho_solve(factor, G[planes].T)
        lam, _ = simplex_minimum(G[planes] @ chosen / weight, f[planes])
        d = -(chosen @ lam) / weight
        linear = f + G @ d
        top = float(linear[planes].max())
        violated = np.setdiff1d(np.flatnonzero(linear > top + 0.05 * max(current - top, 0.0) + 1e-12), planes)
        if len(violated) == 0:
            break
        worst = violated[np.argsort(-linear[violated], kind="stable")[:ADDED]]
        planes = np.concatenate([planes[lam > 1e-9], worst, planes[lam <= 1e-9][:KEPT]])
    return d, current - float(linear.max()), planes


def _newton(
    complement: FloatArray,
    residual: FloatArray,
    factor: FloatArray,
    solved_e: FloatArray,
    e: FloatArray,
    mu: FloatArray,
    s: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Step of the perturbed optimality conditions for a requested change of the products mu s."""
    u = linalg.lapack.dpotrs(factor, complement / mu - residual, lower=1)[0]
    dnu = float(e @ u - (1.0 - e @ mu)) / float(e @ solved_e)
    dmu = u - dnu * solved_e
    return dmu, (complement - s * dmu) / mu, dnu


def _longest(v: FloatArray, dv: FloatArray) -> float:
    """Largest step up to 1 that leaves no entry of v, all positive, below zero."""
    return 1.0 / max(1.0, -float((dv / v).min()))
