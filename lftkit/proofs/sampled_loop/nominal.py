"""Stability of the nominal member of a sampled loop, by the winding number of its return difference.

Part of what is trusted, as :mod:`lftkit.proofs.sampled_loop.checker`. Plant and controller are stable by their poles;
the loop is then stable if ``det(I - K G)`` does not pass zero on the unit circle and its argument comes back to where
it was (Nyquist). Frequency zero and half of the sampling rate have real matrices, so that the change between them is a
multiple of pi. In a window ``R(t) = R(0) X(t)``, and all eigenvalues of X are within `share` of 1; the argument of
``det X`` is then the sum of the arguments of the eigenvalues, which can't pass pi.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.polynomials import INFLATE, ORDER, TINY, UNIT, Polynomial, constant, weighted_share

LOOSE = 3e-5
"""Largest remainder of a window."""
DEEPEST = 50
"""Most bisections of the frequencies."""


def whole_axis(band: tuple[float, float], dt: float) -> bool:
    """Whether a band [rad/s] reaches from zero to half of the sampling rate ``1/dt``."""
    return band[0] == 0.0 and band[1] >= math.pi / dt


def nominal_windows(model: LoopModel) -> int:
    """Windows of frequency with which the nominal loop was proven stable; 0 if it was not.

    Zero too without a controller: such a plant's axis has no end at half of the sampling rate.
    """
    if not len(model.K_C) or not np.all(model.poles.real < 0.0):
        return 0
    if not np.all(np.abs(model.K_poles) < 1.0 - 8.0 * UNIT):
        return 0
    if not (is_real(model.poles, model.B, model.C) and is_real(model.K_poles, model.K_B, model.K_C)):
        return 0
    waiting, done, turned, doubt = [(0.0, math.pi / model.dt, 0)], 0, 0.0, 0.0
    while waiting:
        low, high, depth = waiting.pop()
        try:
            change, error = argument_change(model, low, high)
        except (ArithmeticError, linalg.LinAlgError):
            if depth == DEEPEST:
                return 0
            middle = 0.5 * (low + high)
            waiting += [(middle, high, depth + 1), (low, middle, depth + 1)]
            continue
        done, turned, doubt = done + 1, turned + change, doubt + error
    return done if abs(turned) + INFLATE * doubt < 3.0 else 0


def is_real(poles: ComplexArray, B: ComplexArray, C: ComplexArray) -> bool:
    """Whether the modes are real or pairs, one after the other, so that negative frequencies are conjugate."""
    k = 0
    while k < len(poles):
        other = k + 1 if poles[k].imag else k
        if other == len(poles) or poles[other] != poles[k].conjugate():
            return False
        if not (np.array_equal(B[other], B[k].conj()) and np.array_equal(C[:, other], C[:, k].conj())):
            return False
        k = other + 1
    return True


def argument_change(model: LoopModel, low: float, high: float) -> tuple[float, float]:
    """Change of the argument of ``det(I - K G)`` from `low` to `high` [rad/s], and a bound of its error [rad].

    Raises
    ------
    ArithmeticError
        The window is too wide, or the determinant may be zero in it.
    """
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 4.0 * UNIT) + 4.0 * UNIT * high
    R = model.return_difference(middle, half)
    n = len(R.rad)
    first = linalg.solve(R.c[0], np.eye(n))
    X = constant(first) @ R
    away = X - constant(np.eye(n))
    share, size = weighted_share(away.bound() + TINY)
    if not share < min(0.9, math.sin(1.5 / n)):
        raise ArithmeticError("the window is too wide")
    beyond = 16.0 * UNIT * high / half  # t of low and high is 1 to this
    slopes = sum(k * np.abs(X.c[k]) for k in range(1, ORDER + 1))
    loose = INFLATE * float(((X.rad + beyond * slopes) @ size / size).max()) / (1.0 - share)
    if not loose < LOOSE:
        raise ArithmeticError("rounding is too large")
    ends = [_argument(X, size, sign) for sign in (-1.0, 1.0)]
    return ends[1] - ends[0], 2.0 * n * (2.0 * loose + 1e3 * n * n * UNIT)


def _argument(X: Polynomial, size: FloatArray, t: float) -> float:
    """Sum of the arguments of the eigenvalues of X(t), which are near 1; in units of `size` X(t) is close to I."""
    value = sum(c * t**k for k, c in enumerate(X.c)) * size / size[:, None]
    factors, pivots, _ = linalg.lapack.zgetrf(value)
    swaps = int(np.count_nonzero(pivots != np.arange(len(pivots))))
    whole = complex(np.prod(np.diag(factors)) * (-1.0) ** swaps)
    return math.atan2(whole.imag, whole.real)
