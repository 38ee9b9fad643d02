"""H-infinity norm in discrete time in exact integer arithmetic, for systems whose poles rounding would hide.

The transfer matrix of matrices of floating-point numbers is a quotient of polynomials with integer coefficients
(Leverrier and Faddeev). On the circle, ``z = (1 + jt) / (1 - jt)``, it is one of polynomials in a real t. Stability is
the definiteness of the Schur-Cohn matrix, a level is a bound where a polynomial in t is positive, which its Bernstein
coefficients show. Nothing is rounded but the gains that are reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings, Peak, UndecidedError
from lftkit.arrays import FloatArray, Matrices

Integers = NDArray[np.object_]

SIGN = 2.0**-44  # relative size of an eigenvalue whose sign counts
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


@dataclass(frozen=True)
class Quotient:
    """``numerator(z) / denominator(z)``: coefficients of ascending powers, (n + 1, p, m) and (n + 1,), integers."""

    numerator: Integers
    denominator: Integers

    @classmethod
    def of(cls, system: Matrices, settings: NormSettings = SETTINGS) -> Quotient | None:
        """Transfer matrix, or None for a system that is too large or of too wide a range."""
        n = len(system[0])
        if n > settings.exact_states:
            return None
        scaled = [_integers(matrix) for matrix in system]
        if any(bits > settings.exact_bits for _, bits in scaled):
            return None
        (A, a), (B, b), (C, c), (D, d) = scaled
        identity = np.array([[int(i == k) for k in range(n)] for i in range(n)], dtype=object)
        power, denominator, numerator = identity, [1], []
        for k in range(1, n + 1):
            numerator.append(C @ power @ B)  # of the power n - k
            product = A @ power
            denominator.append(-int(np.trace(product)) // k)
            power = product + denominator[-1] * identity
        # det(y I - A) with y = 2^a z; the resolvent is 2^a times adjugate over determinant
        q = np.array([denominator[n - i] << (a * i) for i in range(n + 1)], dtype=object)
        common = max(b + c, d)
        N = np.zeros((n + 1, *D.shape), dtype=object)
        for k, part in enumerate(numerator, start=1):
            N[n - k] += part * (1 << (a * (n - k + 1) + common - b - c))
        N += q[:, None, None] * (D * (1 << (common - d)))
        q = q * (1 << common)
        every = [int(x) for x in (*q, *N.ravel()) if x]
        spare = min((x & -x).bit_length() - 1 for x in every)
        return cls(N // (1 << spare), q // (1 << spare))

    def stable(self, limit: float) -> bool:
        """Whether all poles have a magnitude below `limit`."""
        above, below = limit.as_integer_ratio()
        n = len(self.denominator) - 1
        q = [int(c) * above**i * below ** (n - i) for i, c in enumerate(self.denominator)]
        return _eliminated(_schur_cohn(q), n) > 0

    def variance(self) -> float:
        """Sum of the variances of the outputs for unit white noise on every input, of a stable quotient, rounded once.

        The covariance of n successive values of white noise through ``1 / denominator`` is the inverse of the
        Schur-Cohn matrix; an elimination of that matrix bordered by the numerators leaves what is asked for.
        """
        n = len(self.denominator) - 1
        q = [int(c) for c in self.denominator]
        direct = [int(x) for x in self.numerator[n].ravel()]
        V = [[int(x) * q[n] - d * q[k] for x, d in zip(self.numerator[k].ravel(), direct)] for k in range(n)]
        bordered = [[*row, *v] for row, v in zip(_schur_cohn(q), V)]
        bordered += [[*(V[k][c] for k in range(n)), *([0] * len(direct))] for c in range(len(direct))]
        size = _eliminated(bordered, n)
        strict = -sum(bordered[n + c][n + c] for c in range(len(direct)))
        return (strict + sum(d * d for d in direct) * size) / (size * q[n] ** 2)

    @cached_property
    def halves(self) -> tuple[_Half, _Half]:
        """Quotients in t from 0 to 1 (z from 1 to j) and in 1 / t from 0 to 1 (z from -1 to j)."""
        n = len(self.denominator) - 1
        basis = [_product(_power(1, i), _power(-1, n - i)) for i in range(n + 1)]
        real, imaginary = (np.array([[part[k] for part in row] for row in basis], dtype=object) for k in (0, 1))
        parts = [(x, part) for x in (self.denominator, self.numerator) for part in (real, imaginary)]
        q_real, q_imaginary, p_real, p_imaginary = (np.tensordot(part.T, x, axes=1) for x, part in parts)
        return (
            _Half(q_real, q_imaginary, p_real, p_imaginary, False),
            _Half(q_real[::-1], q_imaginary[::-1], p_real[::-1], p_imaginary[::-1], True),
        )


@dataclass(frozen=True)
class _Half:
    """Quotient in t: real and imaginary coefficients of the denominator (n + 1,) and numerator (n + 1, p, m)."""

    q_real: Integers
    q_imaginary: Integers
    p_real: Integers
    p_imaginary: Integers
    inverse: bool

    def angle(self, t: float) -> float:
        """Angle on the circle [rad]."""
        turn = 2.0 * float(np.arctan(t))
        return float(np.pi) - turn if self.inverse else turn

    def gain(self, t: float) -> float:
        """Largest singular value at t, of the response rounded once."""
        above, below = t.as_integer_ratio()
        n = len(self.q_real) - 1
        powers = np.array([above**k * below ** (n - k) for k in range(n + 1)], dtype=object)
        qr, qi = int(powers @ self.q_real), int(powers @ self.q_imaginary)
        pr, pi = np.tensordot(powers, self.p_real, axes=1), np.tensordot(powers, self.p_imaginary, axes=1)
        size = qr * qr + qi * qi
        shape = pr.shape
        real = [int(x) / size for x in (pr * qr + pi * qi).ravel()]
        imaginary = [int(x) / size for x in (pi * qr - pr * qi).ravel()]
        response = np.array(real).reshape(shape) + 1j * np.array(imaginary).reshape(shape)
        return float(linalg.svdvals(response)[0])

    @cached_property
    def squares(self) -> tuple[Integers, Integers, Integers]:
        """Bernstein coefficients on [0, 1] of ``|q|^2`` (2 n + 1,) and of ``P P^H``, real and imaginary part."""
        n = len(self.q_real) - 1
        pr, pi = self.p_real, self.p_imaginary
        if pr.shape[1] > pr.shape[2]:
            pr, pi = pr.swapaxes(1, 2), -pi.swapaxes(1, 2)
        k = pr.shape[1]
        of_denominator = np.zeros(2 * n + 1, dtype=object)
        real, imaginary = np.zeros((2 * n + 1, k, k), dtype=object), np.zeros((2 * n + 1, k, k), dtype=object)
        for i in range(n + 1):
            of_denominator[i : i + n + 1] += self.q_real[i] * self.q_real + self.q_imaginary[i] * self.q_imaginary
            for j in range(n + 1):
                real[i + j] += pr[i] @ pr[j].T + pi[i] @ pi[j].T
                imaginary[i + j] += pi[i] @ pr[j].T - pr[i] @ pi[j].T
        return _bernstein(of_denominator), _bernstein(real), _bernstein(imaginary)

    def excess(self, level: float) -> tuple[Integers, Integers]:
        """Bernstein coefficients (2 n + 1, k, k), real and imaginary, of ``level^2 |q|^2 - P P^H`` on [0, 1]."""
        above, below = level.as_integer_ratio()
        of_denominator, real, imaginary = self.squares
        k = real.shape[1]
        identity = np.array([[int(i == j) for j in range(k)] for i in range(k)], dtype=object)
        return above**2 * of_denominator[:, None, None] * identity - below**2 * real, -(below**2) * imaginary


@dataclass(frozen=True)
class ExactCircleModel:
    """Gain of a stable quotient: a :class:`~lftkit.analysis.hinf.level_iteration.GainModel` of angles [rad].

    Parameters
    ----------
    quotient : Quotient
    rtol : float
        Relative distance of the two sides.
    settings : NormSettings
    """

    quotient: Quotient
    rtol: float
    settings: NormSettings = SETTINGS

    def first_peak(self) -> Peak:
        """The peak near the best of some points of the circle."""
        count = self.settings.exact_starts
        starts = [(half, k / count) for half in self.quotient.halves for k in range(count + 1)]
        half, t = max(starts, key=lambda start: start[0].gain(start[1]))
        return _peak(half, t, 1.0 / count, self.settings.exact_steps)

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain at `peak` and the level above it, which is above zero."""
        return peak.gain, peak.gain * (1.0 + self.rtol) or 1e-300

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """The peak near a point that exceeds the level."""
        for half in self.quotient.halves:
            if (above := _above(half, level, self.settings)) is not None:
                return _peak(half, *above, self.settings.exact_steps)
        return None


def _above(half: _Half, level: float, settings: NormSettings) -> tuple[float, float] | None:
    """A point above the level and the width of its interval; None: the gain stays below."""
    parts = [(0.0, 1.0, *half.excess(level), 0)]
    done = 0
    while parts:
        low, high, real, imaginary, depth = parts.pop()
        done += 1
        signs = _signs(real, imaginary)
        for t, sign in ((low, signs[0]), (high, signs[-1])):
            if sign < 0:
                return t, high - low
        if min(signs) > 0:
            continue
        middle = 0.5 * (low + high)
        if depth >= settings.exact_depth or done >= settings.exact_parts or not low < middle < high:
            raise UndecidedError("an interval of the circle is too small")
        (first, second), (one, two) = _split(real), _split(imaginary)
        parts += [(low, middle, first, one, depth + 1), (middle, high, second, two, depth + 1)]
    return None


def _peak(half: _Half, t: float, width: float, steps: int) -> Peak:
    """Peak near t, by golden section."""
    low, high = max(t - width, 0.0), min(t + width, 1.0)
    best, place = half.gain(t), t
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    ga, gb = half.gain(a), half.gain(b)
    for _ in range(steps):
        if ga >= gb:
            high, b, gb = b, a, ga
            a = high - GOLDEN * (high - low)
            ga = half.gain(a)
        else:
            low, a, ga = a, b, gb
            b = low + GOLDEN * (high - low)
            gb = half.gain(b)
        for x, gain in ((a, ga), (b, gb)):
            if gain > best:
                best, place = gain, x
    return Peak(half.angle(place), best)


def _signs(real: Integers, imaginary: Integers) -> list[int]:
    """Sign of the smallest eigenvalue of each matrix: 1 (positive), -1, or 0 where rounding hides it."""
    if real.shape[1] == 1:
        return [(x > 0) - (x < 0) for x in real[:, 0, 0]]
    signs = []
    for x, y in zip(real, imaginary):
        bits = max(max(abs(v) for v in x.ravel()).bit_length() - 60, 0)
        matrix = (x >> bits).astype(float) + 1j * (y >> bits).astype(float)
        values = linalg.eigvalsh(matrix)
        size = SIGN * max(abs(values[0]), abs(values[-1]))
        signs.append(1 if values[0] > size else -1 if values[0] < -size else 0)
    return signs


def _bernstein(coefficients: Integers) -> Integers:
    """Bernstein coefficients on [0, 1], times a positive integer, of a polynomial in t."""
    degree = len(coefficients) - 1
    row = [1]
    for k in range(degree):
        row.append(row[-1] * (degree - k) // (k + 1))
    common = int(np.lcm.reduce(np.array(row, dtype=object)))
    out = np.array([c * (common // r) for c, r in zip(coefficients, row)], dtype=object)
    for k in range(1, degree + 1):  # b_j = sum_i comb(j, i) a_i / comb(degree, i), by sums of neighbours
        # One pass of the binomial transform
        result = out.copy()
        for j in range(len(out) - 1, k - 1, -1):
            result[j] = out[j] + out[j - 1]
        out[k:] = result[k:]
    return out


def _split(values: Integers) -> tuple[Integers, Integers]:
    """Bernstein coefficients of both halves (de Casteljau), times a power of two, the same for both."""
    degree = len(values) - 1
    first, second, row = values.copy(), values.copy(), values
    for k in range(degree + 1):
        first[k] = row[0] * (1 << (degree - k))
        second[degree - k] = row[-1] * (1 << (degree - k))
        row = row[1:] + row[:-1]
    return first, second


def _schur_cohn(q: list[int]) -> list[list[int]]:
    """Matrix (n, n) that is positive definite if and only if all roots of the polynomial are inside the circle."""
    n = len(q) - 1
    S = [[0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            S[i][j] = S[j][i] = sum(q[n - i + k] * q[n - j + k] - q[i - k] * q[j - k] for k in range(j + 1))
    return S


def _eliminated(S: list[list[int]], steps: int) -> int:
    """Last of the first `steps` leading minors, 0 where one is not positive.

    Elimination without fractions, in place (Bareiss 1968): what is left is the Schur complement times that minor.
    """
    last = 1
    for k in range(steps):
        if S[k][k] <= 0:
            return 0
        for i in range(k + 1, len(S)):
            for j in range(k + 1, len(S)):
                S[i][j] = (S[i][j] * S[k][k] - S[i][k] * S[k][j]) // last
        last = S[k][k]
    return last


def _power(sign: int, exponent: int) -> list[tuple[int, int]]:
    """Coefficients (real, imaginary) of ``(1 + sign j t)^exponent``."""
    out = [(1, 0)]
    for _ in range(exponent):
        out = _product(out, [(1, 0), (0, sign)])
    return out


def _product(a: list[tuple[int, int]], b: list[tuple[int, int]]) -> list[tuple[int, int]]:
    out = [(0, 0)] * (len(a) + len(b) - 1)
    for i, (x, y) in enumerate(a):
        for j, (u, v) in enumerate(b):
            real, imaginary = out[i + j]
            out[i + j] = real + x * u - y * v, imaginary + x * v + y * u
    return out


def _integers(matrix: FloatArray) -> tuple[Integers, int]:
    """``matrix = integers / 2^bits`` with the smallest `bits` that is 0 at least."""
    ratios = [float(x).as_integer_ratio() for x in matrix.ravel()]
    bits = max((below.bit_length() - 1 for _, below in ratios), default=0)
    values = np.empty(len(ratios), dtype=object)
    values[:] = [above << (bits - below.bit_length() + 1) for above, below in ratios]
    return values.reshape(matrix.shape), bits
