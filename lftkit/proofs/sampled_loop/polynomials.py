"""Matrix polynomials in t, -1 <= t <= 1, with an elementwise bound of everything that is left out.

Trusted code of :mod:`lftkit.proofs.sampled_loop.checker`: every operation adds its truncation and its rounding to the
radius.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray

UNIT = 2.0**-53
INFLATE = 1.0 + 1e-9  # covers the rounding of the radii themselves
TINY = 1e-290
ORDER = 5


class Polynomial:
    """``sum_k c[k] t^k`` plus a matrix whose entries are at most `rad` in magnitude, for every real t in [-1, 1].

    Parameters
    ----------
    c : ndarray, complex, shape (ORDER + 1, ...)
        Coefficients; missing ones are zero.
    rad : ndarray, shape (...), optional
        Zero by default.
    """

    def __init__(self, c: Sequence[ComplexArray] | ComplexArray, rad: FloatArray | None = None) -> None:
        given = np.asarray(c, dtype=complex)
        self.c = np.zeros((ORDER + 1, *given.shape[1:]), complex)
        self.c[: len(given)] = given
        self.rad: FloatArray = np.zeros(self.c.shape[1:]) if rad is None else rad
        self._sizes: FloatArray | None = None
        self._powers: list[int] | None = None

    def sizes(self) -> FloatArray:
        """Magnitudes of the coefficients, shape (ORDER + 1, ...); computed once, as nothing changes them."""
        if self._sizes is None:
            self._sizes = np.zeros(self.c.shape)
            for k in self._terms():
                self._sizes[k] = np.abs(self.c[k])
        return self._sizes

    def bound(self) -> FloatArray:
        """Elementwise bound of the magnitude."""
        return np.asarray(INFLATE * (self.sizes().sum(axis=0) + self.rad))

    def __add__(self, other: Polynomial) -> Polynomial:
        if self.rad.ndim != other.rad.ndim:
            raise ValueError(f"sums need as many dimensions, got {self.rad.ndim} and {other.rad.ndim}")
        c = self.c + other.c
        return Polynomial(c, INFLATE * (self.rad + other.rad + 2.0 * UNIT * np.abs(c).sum(axis=0)))

    def __sub__(self, other: Polynomial) -> Polynomial:
        return self + Polynomial(-other.c, other.rad)

    def __mul__(self, other: Polynomial) -> Polynomial:
        """Elementwise product, with broadcasting."""
        return self._product(other, np.multiply, 1)

    def __matmul__(self, other: Polynomial) -> Polynomial:
        return self._product(other, np.matmul, self.c.shape[-1])

    def _product(self, other: Polynomial, times: np.ufunc, terms: int) -> Polynomial:
        a, b = self.sizes(), other.sizes()
        gamma = 8.0 * (terms + ORDER + 3) * UNIT
        whole = b.sum(axis=0) + other.rad
        rad = times(self.rad, whole)
        c = np.zeros((ORDER + 1, *rad.shape), complex)
        mine, others = self._terms(), other._terms()
        for i in mine:
            rad = rad + times(a[i], b[ORDER + 1 - i :].sum(axis=0) + other.rad + gamma * whole)
            for k in others:
                if i + k <= ORDER:
                    c[i + k] += times(self.c[i], other.c[k])
        return Polynomial(c, INFLATE * rad + TINY)

    def _terms(self) -> list[int]:
        """Powers whose coefficients are not zero."""
        if self._powers is None:
            self._powers = np.flatnonzero(self.c.reshape(ORDER + 1, -1).any(axis=1)).tolist()
        return self._powers

    def rows(self, which: slice | Sequence[int]) -> Polynomial:
        """Some rows."""
        return Polynomial(self.c[:, which], self.rad[which])

    def adjoint(self) -> Polynomial:
        """Conjugate transpose."""
        return Polynomial(self.c.conj().swapaxes(-1, -2), self.rad.swapaxes(-1, -2))

    def __getitem__(self, key: object) -> Polynomial:
        """Index of the matrix dimensions, as of an ndarray."""
        inner = key if isinstance(key, tuple) else (key,)
        whole = (slice(None), *inner)
        return Polynomial(self.c[whole], self.rad[inner])


def constant(value: ComplexArray | FloatArray | complex, error: float = 0.0) -> Polynomial:
    """Matrix that does not depend on t; `error` is a relative bound of its entries' error."""
    array = np.asarray(value, dtype=complex)
    return Polynomial(array[None], error * np.abs(array))


def stacked(parts: Sequence[Polynomial]) -> Polynomial:
    """One below the other."""
    return Polynomial(np.concatenate([p.c for p in parts], axis=1), np.concatenate([p.rad for p in parts]))


def exponential(middle: NDArray[Any], half: NDArray[Any]) -> Polynomial:
    """``exp(j (middle + half t))``, elementwise."""
    z = np.exp(1j * middle)
    c = [z * np.ones_like(half)]
    for k in range(1, ORDER + 1):
        c.append(c[-1] * (1j * half / k))
    tail = np.abs(half) ** (ORDER + 1) * np.exp(np.abs(half))  # of the series
    rounding = 4.0 * UNIT * (2.0 + np.abs(middle) + np.abs(half)) * (1.0 + np.abs(half))
    return Polynomial(np.asarray(c), INFLATE * (tail / math.factorial(ORDER + 1) + rounding) + TINY)


def reciprocal(p: Polynomial) -> Polynomial:
    """``1 / p``, elementwise.

    Raises
    ------
    ArithmeticError
        An entry may be zero.
    """
    first = 1.0 / np.where(p.c[0] == 0.0, 1.0, p.c[0])
    away = Polynomial(np.concatenate([0.0 * p.c[:1], p.c[1:]]), p.rad) * constant(first, 8.0 * UNIT)
    share = away.bound()
    if not (np.all(p.c[0] != 0.0) and np.all(share < 0.9)):
        raise ArithmeticError("an entry may be zero")
    total, power = constant(np.ones_like(first)), constant(np.ones_like(first))
    for _ in range(ORDER):
        power = power * Polynomial(-away.c, away.rad)
        total = total + power
    total = Polynomial(total.c, total.rad + INFLATE * share ** (ORDER + 1) / (1.0 - share))
    return total * constant(first, 8.0 * UNIT)


def weighted_share(bound: FloatArray) -> tuple[float, FloatArray]:
    """Bound of the spectral radius of all matrices below `bound`, and sizes with ``bound @ size <= share size``."""
    size: FloatArray = np.ones(len(bound))
    for _ in range(8):
        size = bound @ size + 1e-3 * size
        size = size / size.max()
    return INFLATE * float((bound @ size / size).max()), size


def inverse(p: Polynomial) -> Polynomial:
    """Inverse of a square matrix.

    Raises
    ------
    ArithmeticError
        It may be singular.
    """
    n = p.c.shape[-1]
    factors, pivots, _ = linalg.lapack.zgetrf(p.c[0])
    first, singular = linalg.lapack.zgetri(factors, pivots)
    if singular:
        raise ArithmeticError("the matrix may be singular")
    away = constant(first) @ p - constant(np.eye(n))
    bound = away.bound() + TINY
    share, size = weighted_share(bound)
    if not share < 0.9:
        raise ArithmeticError("the matrix may be singular")
    total, power = constant(np.eye(n)), constant(np.eye(n))
    for _ in range(ORDER):
        power = power @ Polynomial(-away.c, away.rad)
        total = total + power
    rest = INFLATE * share ** (ORDER + 1) / (1.0 - share) * size[:, None] / size
    return Polynomial(total.c, total.rad + rest) @ constant(first)
