"""The quadratic program behind every step: a convex quadratic on the unit simplex."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
sl: Any = scipy.linalg

MOST_ITERATIONS = 60


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
    size = max(float(np.abs(np.diag(H)).max()), float(np.ptp(a)), 1e-300)
    top = float(a.max())
    H, a = H / size, (a - top) / size
    lam: FloatArray = np.full(m, 1.0 / m)
    s: FloatArray = np.ones(m)
    nu = float((a + s - H @ lam).mean())
    for _ in range(MOST_ITERATIONS):
        residual = H @ lam - a - s + nu
        gap = float(lam @ s) / m
        if gap < tolerance and np.abs(residual).max() < 1e-12:
            break
        factor = sl.cho_factor(H + np.diag(s / lam + 1e-14), lower=True, check_finite=False)
        ones = sl.cho_solve(factor, np.ones(m), check_finite=False)

        rest = (residual, factor, ones, lam, s)
        dlam, ds, _ = _newton(-lam * s, *rest)
        step = min(_longest(lam, dlam), _longest(s, ds))
        centre = (float((lam + step * dlam) @ (s + step * ds)) / m / gap) ** 3 if gap > 0 else 0.0
        dlam, ds, dnu = _newton(-lam * s - dlam * ds + centre * gap, *rest)
        step = 0.995 * min(_longest(lam, dlam), _longest(s, ds))
        lam, s, nu = lam + step * dlam, s + step * ds, nu + step * dnu
    lam = np.maximum(lam, 0.0)
    lam /= lam.sum()
    return lam, float(size * (0.5 * lam @ H @ lam - a @ lam)) - top


def _newton(
    complement: FloatArray, residual: FloatArray, factor: Any, ones: FloatArray, lam: FloatArray, s: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Step of the perturbed optimality conditions for a wanted change of the products lam s."""
    u = sl.cho_solve(factor, complement / lam - residual, check_finite=False)
    dnu = float(u.sum() - (1.0 - lam.sum())) / float(ones.sum())
    dlam = u - dnu * ones
    return dlam, (complement - s * dlam) / lam, dnu


def _longest(v: FloatArray, dv: FloatArray) -> float:
    shrinking = dv < 0
    return min(1.0, float(np.min(-v[shrinking] / dv[shrinking]))) if shrinking.any() else 1.0
