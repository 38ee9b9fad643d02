"""Responses of an uncertain system over windows of frequency, from its own matrices, with bounded remainders.

Part of what is trusted, as :mod:`lftkit.proofs.axis.checker`. Frequencies up to a border are themselves the variable,
``s = j x``; those beyond it, infinity included, are ``s = j / x``. With any matrices T and X, for which X T = I + E and
X A T = L + F with L diagonal, ::

    (j x - A)^-1 = T (j x - L + j x E - F)^-1 X,    (j / x - A)^-1 = x T (j - x L + j E - x F)^-1 X,

and a Neumann series bounds what E and F, which are rounding, make of the inverse of the diagonal matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop.coordinates import coordinates
from lftkit.proofs.trusted.polynomials import INFLATE, TINY, UNIT, Polynomial, constant, reciprocal, weighted_share
from lftkit.proofs.trusted.proof import Strip


@dataclass(frozen=True)
class AxisModel:
    """An uncertain system over one part of the frequency axis.

    Parameters
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, q + d), (q + e, n), (q + e, q + d): the channels of the parameters first.
    poles : ndarray, complex, shape (n,)
        L, about the poles of A.
    T, X : ndarray, complex, shape (n, n)
        About the eigenvectors of A and their inverse.
    groups : tuple of tuple of int
        Channels of each element.
    kinds : tuple of str
        ``real``, ``complex`` (a number) or ``full`` (a matrix) for each element; the latter two are bounded by the ends
        of an interval about zero.
    beyond : bool
        Whether the variable is the inverse of the frequency.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    poles: ComplexArray
    T: ComplexArray
    X: ComplexArray
    groups: tuple[tuple[int, ...], ...]
    kinds: tuple[str, ...]
    beyond: bool

    @cached_property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Channels, measurements (none), errors, disturbances, commands (none)."""
        q = sum(len(group) for group in self.groups)
        return q, 0, len(self.D) - q, self.D.shape[1] - q, 0

    @property
    def angle(self) -> tuple[bool, ...]:
        """No parameter is an angle."""
        return (False,) * len(self.groups)

    @property
    def slowest(self) -> float:
        """Smallest of the poles, in the unit of the variable."""
        size = np.abs(self.poles[self.poles != 0.0])
        return float((1.0 / size if self.beyond else size).min(initial=1.0 if not len(size) else np.inf))

    def amplitudes(self, x: float) -> tuple[float, FloatArray]:
        """Weight of the errors and amplitudes of the disturbances: ones."""
        return 1.0, np.ones(self.sizes[3])

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the errors' weight (1,) and of one over the disturbances' amplitudes (d,): ones."""
        return constant(np.ones(1)), constant(np.ones(self.sizes[3]))

    def at(self, x: float) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the errors by (w, d) at one value of the variable, (q, q + d) and (e, q + d), without bounds."""
        q, driven = self.sizes[0], self.X @ self.B
        states = x * driven / (1j - x * self.poles)[:, None] if self.beyond else driven / (1j * x - self.poles)[:, None]
        response = self.C @ (self.T @ states) + self.D
        return response[:q], response[q:]

    def coordinates(self, strip: Strip, number: int, omega: float, level: float) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square."""
        return coordinates(self, strip, number, omega, level)

    def responses(self, middle: float, half: float, V: ComplexArray) -> tuple[Polynomial, Polynomial]:
        """``z`` and the errors over a window ``middle + half t`` of the variable, as maps from the coordinates of V.

        Parameters
        ----------
        middle, half : float
        V : ndarray, complex, shape (q + d, N)
            (w, d) of the coordinates.

        Raises
        ------
        ArithmeticError
            The window may contain a pole of the nominal member.
        """
        q = self.sizes[0]
        x = Polynomial(np.array([[middle], [half]], dtype=complex))
        rounding = INFLATE * (abs(middle) + abs(half))
        one, E, F = constant(np.array([1j])), *self._errors
        if self.beyond:
            modes, off = reciprocal(one - x * constant(self.poles)), E + rounding * F
        else:
            modes, off = reciprocal(one * x - constant(self.poles)), rounding * E + F
        out, into = self._observed, self._excited @ constant(V)
        states = modes[:, None] * into
        size = modes.bound()
        rest = out.bound() @ (neumann(size[:, None] * off) @ (size[:, None] * into.bound()))
        whole = out @ states
        whole = Polynomial(whole.c, INFLATE * (whole.rad + rest) + TINY)
        if self.beyond:
            whole = whole * x[:, None]
        whole = whole + constant(self.D) @ constant(V)
        return whole[:q], whole[q:]

    @cached_property
    def _observed(self) -> Polynomial:
        """``C T``."""
        return constant(self.C) @ constant(self.T)

    @cached_property
    def _excited(self) -> Polynomial:
        """``X B``."""
        return constant(self.X) @ constant(self.B)

    @cached_property
    def _errors(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the entries of E and F."""
        E = constant(self.X) @ constant(self.T) - constant(np.eye(len(self.A)))
        F = constant(self.X) @ (constant(self.A) @ constant(self.T)) - constant(np.diag(self.poles))
        return E.bound(), F.bound()

    def nominal_stable(self) -> bool:
        """Whether all poles of A are certainly in the open left half plane.

        There ``|s| / |s - l| <= 1 + |l| / |Re l|``, so that E and F cannot make the pencil singular.
        """
        if not len(self.A):
            return True
        decay = -self.poles.real * (1.0 - 4.0 * UNIT)
        if not np.all(decay > 0.0):
            return False
        E, F = self._errors
        share = ((1.0 + np.abs(self.poles) / decay)[:, None] * E + F / decay[:, None]) * INFLATE
        return bool(weighted_share(share)[0] < 1.0)


def neumann(share: FloatArray) -> FloatArray:
    """Bound of ``(I + S)^-1 - I`` for all matrices S whose entries are below `share`.

    Raises
    ------
    ArithmeticError
        ``I + S`` may be singular.
    """
    if not len(share):
        return share
    radius, size = weighted_share(share)
    if not radius < 0.9:
        raise ArithmeticError("the nominal member may have a pole in the window")
    return np.asarray(INFLATE * (share + radius**2 / (1.0 - radius) * size[:, None] / size) + TINY)
