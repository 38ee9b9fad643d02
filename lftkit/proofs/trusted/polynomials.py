"""Matrix polynomials in t, -1 <= t <= 1, with an elementwise bound of everything that is left out.

Every operation adds its truncation and its rounding to the radius.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, UNIT
from lftkit.proofs.trusted.proof import ComplexArray, FloatArray

ORDER = 5


class Polynomial:
    """``sum_k c[k] t^k`` plus a matrix whose entries are at most `rad` in magnitude, for every real t in [-1, 1].

    Parameters
    ----------
    c : ndarray, complex, shape (ORDER + 1, ...)
        Coefficients; missing ones are zero.
    rad : ndarray, shape (...), optional
        Zero by default.

    Raises
    ------
    ArithmeticError
        A number is not finite. Every result of an operation is one of these, so that no comparison meets such a number.
    """

    def __init__(self, c: Sequence[ComplexArray] | ComplexArray, rad: FloatArray | None = None) -> None:
        given = np.asarray(c, dtype=complex)
        self.count = len(given)  # what follows is zero
        if not 1 <= self.count <= ORDER + 1:
            raise ValueError(f"a polynomial must have 1 to {ORDER + 1} coefficients, got {self.count}")
        self.c = given
        if self.count <= ORDER:
            self.c = np.zeros((ORDER + 1, *given.shape[1:]), complex)
            self.c[: self.count] = given
        self.rad: FloatArray = np.zeros(self.c.shape[1:]) if rad is None else rad
        total = np.add.reduce(given, axis=None), np.add.reduce(self.rad, axis=None)
        if not (cmath.isfinite(total[0]) and math.isfinite(total[1])):  # sums with such numbers are none, too
            raise ArithmeticError("numbers must be finite")

    @cached_property
    def sizes(self) -> FloatArray:
        """Magnitudes of the coefficients, shape (ORDER + 1, ...)."""
        found: FloatArray = np.abs(self.c)
        return found

    @cached_property
    def above(self) -> FloatArray:
        """Bounds of the remainder and all coefficients but the first ORDER + 1 - k, for each k, and of all of it."""
        return np.add.accumulate(np.concatenate([self.rad[None], self.sizes[::-1]]))

    def bound(self) -> FloatArray:
        """Elementwise bound of the magnitude."""
        return np.asarray(INFLATE * (self.sizes.sum(axis=0) + self.rad))

    def __add__(self, other: Polynomial) -> Polynomial:
        if self.rad.ndim != other.rad.ndim:
            raise ValueError(f"sums need as many dimensions, got {self.rad.ndim} and {other.rad.ndim}")
        n = max(self.count, other.count)
        c = self.c[:n] + other.c[:n]
        return Polynomial(c, INFLATE * (self.rad + other.rad + 2.0 * UNIT * np.abs(c).sum(axis=0)))

    def __neg__(self) -> Polynomial:
        return Polynomial(-self.c[: self.count], self.rad)

    def __sub__(self, other: Polynomial) -> Polynomial:
        return self + (-other)

    def __mul__(self, other: Polynomial) -> Polynomial:
        """Elementwise product, with broadcasting."""
        return self._product(other, np.multiply, 1)

    def __matmul__(self, other: Polynomial) -> Polynomial:
        return self._product(other, np.matmul, self.c.shape[-1])

    def _product(self, other: Polynomial, times: np.ufunc, terms: int) -> Polynomial:
        gamma, whole, n = 8.0 * (terms + ORDER + 3) * UNIT, other.above[-1], max(self.rad.ndim, other.rad.ndim)
        left, right = _with(n, self.c[: self.count]), _with(n, other.c[: other.count])
        cut = times(_with(n, self.sizes[: self.count]), _with(n, other.above[: self.count] + gamma * whole))
        rad = times(self.rad, whole) + np.add.reduce(cut)
        c = np.zeros((min(self.count + other.count - 1, ORDER + 1), *rad.shape), complex)
        for i in range(min(self.count, other.count)):
            if self.count > other.count:
                part = times(left[: ORDER + 1 - i], right[i])
            else:
                part = times(left[i], right[: ORDER + 1 - i])
            c[i : i + len(part)] += part
        return Polynomial(c, INFLATE * rad + TINY)

    def adjoint(self) -> Polynomial:
        """Conjugate transpose."""
        return Polynomial(self.c[: self.count].conj().swapaxes(-1, -2), self.rad.swapaxes(-1, -2))

    def __getitem__(self, key: Any) -> Polynomial:
        """Index of the matrix dimensions, as of an ndarray."""
        inner = key if isinstance(key, tuple) else (key,)
        whole = (slice(self.count), *inner)
        return Polynomial(self.c[whole], self.rad[inner])


def _with(dimensions: int, values: Any) -> Any:
    """Coefficients of matrices with that many dimensions: further ones of size 1 in front."""
    return values.reshape(len(values), *[1] * (dimensions + 1 - values.ndim), *values.shape[1:])


def constant(value: ComplexArray | FloatArray | complex, error: float | FloatArray = 0.0) -> Polynomial:
    """Matrix that does not depend on t; `error` is a relative bound of its entries' error."""
    array = np.asarray(value, dtype=complex)
    return Polynomial(array[None], error * (np.abs(array) + TINY))  # of the smallest numbers no error is relative


def span(low: float, high: float) -> tuple[float, float]:
    """Middle and half of a window that contains [low, high], whatever the rounding."""
    return 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 4.0 * UNIT) + 4.0 * UNIT * high + TINY


def linear(middle: complex, half: complex, error: float = 0.0) -> Polynomial:
    """``middle + half t``, (1,), with a bound of its error: the variable of a window or a multiple of it."""
    return Polynomial(np.array([[middle], [half]], dtype=complex), np.array([error]))


def windows_with(works: Callable[[float, float], bool], low: float, high: float, deepest: int) -> int:
    """Windows, bisected as needed, from `low` to `high` in each of which something works; 0 if it does not."""
    waiting, done = [(low, high, 0)], 0
    while waiting:
        low, high, depth = waiting.pop()
        try:
            with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
                if works(low, high):
                    done += 1
                    continue
        except (ArithmeticError, linalg.LinAlgError):
            pass
        if depth == deepest:
            return 0
        middle = 0.5 * (low + high)
        waiting += [(middle, high, depth + 1), (low, middle, depth + 1)]
    return done


def exponential(middle: FloatArray, half: FloatArray) -> Polynomial:
    """``exp(j (middle + half t))``, elementwise."""
    c = [np.exp(1j * middle) * np.ones_like(half)]
    for k in range(1, ORDER + 1):
        c.append(c[-1] * (1j * half / k))
    tail = np.abs(half) ** (ORDER + 1) * np.exp(np.abs(half))  # of the series
    rounding = 4.0 * UNIT * (2.0 + np.abs(middle) + np.abs(half)) * (1.0 + np.abs(half))
    return Polynomial(np.asarray(c), INFLATE * (tail / math.factorial(ORDER + 1) + rounding) + TINY)


def _inverse_of_one_plus(away: Polynomial, one: Polynomial, times: Callable[..., Polynomial], rest: Any) -> Polynomial:
    """Neumann series ``1 - away + away^2 - ...``, `rest` its tail."""
    total = power = one
    for _ in range(ORDER):
        power = times(power, -away)
        total = total + power
    return Polynomial(total.c, total.rad + INFLATE * rest)


def reciprocal(p: Polynomial) -> Polynomial:
    """``1 / p``, elementwise.

    Raises
    ------
    ArithmeticError
        An entry may be zero.
    """
    first = constant(1.0 / np.where(p.c[0] == 0.0, 1.0, p.c[0]), 8.0 * UNIT)
    away = Polynomial(np.concatenate([0.0 * p.c[:1], p.c[1:]]), p.rad) * first
    share = away.bound()
    if not (np.all(p.c[0] != 0.0) and np.all(share < 0.9)):
        raise ArithmeticError("an entry may be zero")
    rest = share ** (ORDER + 1) / (1.0 - share)
    return _inverse_of_one_plus(away, constant(np.ones(share.shape)), Polynomial.__mul__, rest) * first


def weighted_share(bound: FloatArray) -> tuple[float, FloatArray]:
    """Bound of the spectral radius of all matrices below `bound`, and sizes with ``bound @ size <= share size``."""
    bound = bound + TINY
    size: FloatArray = np.ones(len(bound))
    for _ in range(8):
        size = bound @ size + 1e-3 * size
        size = size / size.max()
    return INFLATE * float(((bound @ size + TINY) / size).max()), size


def inverse(p: Polynomial) -> Polynomial:
    """Inverse of a square matrix.

    Raises
    ------
    ArithmeticError
        It may be singular.
    """
    one = constant(np.eye(p.c.shape[-1]))
    factors, pivots, _ = linalg.lapack.zgetrf(p.c[0])
    found = linalg.lapack.zgetri(factors, pivots)[0]  # whatever it is, the product below is verified
    away = constant(found) @ p - one
    share, size = weighted_share(away.bound())
    if not share < 0.9:
        raise ArithmeticError("the matrix may be singular")
    rest = share ** (ORDER + 1) / (1.0 - share) * size[:, None] / size
    return _inverse_of_one_plus(away, one, Polynomial.__matmul__, rest) @ constant(found)
