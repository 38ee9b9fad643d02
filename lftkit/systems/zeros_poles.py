"""State space of zeros, poles and a gain, as a chain of sections of second order whose poles are those that are given.

The coefficients of a polynomial lose its roots where they are close: of twelve poles at 0.98 one comes back at 1.08. In
the chain each section has its own poles on the diagonal of an upper block triangular matrix.
"""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.errors import InputError


def zeros_poles(zeros: ArrayLike, poles: ArrayLike, gain: float, rounding: float = 1e-12) -> Matrices:
    """Matrices (A, B, C, D) with one input and one output.

    Parameters
    ----------
    zeros, poles : array_like
        Complex ones in conjugate pairs; not more zeros than poles.
    gain : float
        Ratio of the leading coefficients.
    rounding : float
        Part of a root that may be left of what is real or conjugate.

    Raises
    ------
    ValueError
        More zeros than poles, roots without their conjugates, numbers that are not finite.

    Examples
    --------
    >>> A, B, C, D = zeros_poles([-3.0], [-1.0, -2.0], 2.0)
    >>> (C @ np.linalg.inv(1.0 * np.eye(2) - A) @ B + D).round(9).tolist()
    [[1.333333333]]
    """
    up, down = (_pairs(np.asarray(roots, dtype=complex).ravel(), rounding) for roots in (zeros, poles))
    if sum(map(len, up)) > sum(map(len, down)):
        raise InputError(f"zeros must be at most as many as poles, got {sum(map(len, up))} and {sum(map(len, down))}")
    unit: Matrices = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    A, B, C, D = unit
    for z, p in zip_longest(up, down, fillvalue=np.zeros(0, complex)):
        a, b, c, d = _section(z, p)
        A = np.block([[a, b @ C], [np.zeros((len(A), len(a))), A]])
        B, C, D = np.vstack([b @ D, B]), np.hstack([c, d @ C]), d @ D
    return A, B, gain * C, gain * D


def _pairs(roots: ComplexArray, rounding: float) -> list[ComplexArray]:
    """Roots in pairs: conjugate ones, then real ones by falling size, of which the last may be alone."""
    if not np.isfinite(roots).all():
        raise InputError("zeros and poles must be finite")
    whole = np.abs(roots.imag) <= rounding * np.abs(roots)
    real = roots[whole].real[np.argsort(-np.abs(roots[whole].real), kind="stable")]
    upper, lower = roots[~whole & (roots.imag > 0.0)], roots[~whole & (roots.imag < 0.0)].conj()
    far = np.abs(upper[:, None] - lower)  # equal real parts in rounding have no order: each takes its nearest
    paired = len(upper) == len(lower)
    for k in range(len(upper) if paired else 0):
        nearest = int(far[k].argmin())
        paired = paired and bool(far[k, nearest] <= rounding * abs(upper[k]))
        far[:, nearest] = np.inf
    if not paired:
        raise InputError("system must have real coefficients, got complex ones")
    pairs = [np.array([root, root.conjugate()]) for root in upper]
    return [*pairs, *(real[k : k + 2].astype(complex) for k in range(0, len(real), 2))]


def _section(zeros: ComplexArray, poles: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """``prod(s - zeros) / prod(s - poles)``, up to two of each and not more zeros than poles."""
    n = len(poles)
    numerator = np.zeros(n + 1)
    numerator[n - len(zeros) :] = np.real(np.poly(zeros))
    through = numerator[0]
    rest = (numerator - through * np.real(np.poly(poles)))[1:]  # of lower degree
    into = np.zeros((n, 1))
    if n:
        into[-1] = 1.0
    if n == 2 and poles[0].imag:
        sigma, omega = poles[0].real, abs(poles[0].imag)
        A = np.array([[sigma, omega], [-omega, sigma]])
        out = np.array([[(rest[1] + rest[0] * sigma) / omega, rest[0]]])
    else:
        A = np.diag(poles.real) + np.diag(np.ones(max(n - 1, 0)), 1)
        out = np.array([[rest[1] + rest[0] * poles[0].real, rest[0]]]) if n == 2 else rest.reshape(1, n)
    return A, into, out, np.array([[through]])


def zeros_of(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> ComplexArray:
    """Points at which the system matrix ``[A - s, B; C, D]`` loses rank; none of a system that is not square.

    Zeros at infinity may be among them as large numbers: rounding makes them finite.

    Parameters
    ----------
    A, B, C, D : ndarray, shapes (n, n), (n, m), (m, n), (m, m)

    Returns
    -------
    ndarray, complex
        [rad/s], or of a sampled system in the z-plane.

    Examples
    --------
    ``(s - 2) / (s + 1)``:

    >>> zeros_of(np.array([[-1.0]]), np.array([[1.0]]), np.array([[-3.0]]), np.array([[1.0]])).round(9).tolist()
    [(2+0j)]
    """
    n, (outputs, inputs) = len(A), np.shape(D)
    if outputs != inputs:
        return np.zeros(0, complex)
    unit = np.zeros((n + inputs, n + inputs))
    unit[:n, :n] = np.eye(n)
    values = np.asarray(linalg.eigvals(np.block([[A, B], [C, D]]), unit), dtype=complex)
    return np.asarray(values[np.isfinite(values)])
