"""Channels of the arrays' angle: half of their number, regular at every angle, and closed at once for many angles.

A rotation by theta is the square of a Cayley map in tau = tan(theta / 4) with four channels, two of each factor
(:mod:`titop_plant.blocks.rotation`). The first factor alone, in t = tan(theta / 2), is the whole rotation, so that the
channels of the second are left out. As t is infinite at theta = pi, a channel ``w = t z`` is written as

    w = delta (z - j w),   delta = t / (1 - j t) = sin(theta / 2) exp(j theta / 2),

which takes j from the diagonal of the matrix from w to z.

All these channels have the same delta. With the eigenvalues and eigenvectors of their matrix an LFT is a sum of terms
``delta / (1 - delta pole) residue``: many angles are one product of matrices, and what is left to be solved has the
order of the other parameters' channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.analysis.batched_linalg import solve
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from titop_plant.telescope.layout import ANGLE

FACTORS = 4
"""Channels of a rotation in a plane; the first half of them is kept."""

MAX_CONDITION = 1e9
"""Of the eigenvectors of the angle's channels."""

TOGETHER = 80
"""Points whose matrices are in the cache at once."""


def kept_channels(system: System) -> IntArray:
    """Channels of a system's Delta without those of the second factor of each rotation.

    All of them where the nominal angle is not zero: what is left out then is not the identity.
    """
    names = system.channels
    angles = [k for k, name in enumerate(names) if name == ANGLE]
    if any(p.nominal != 0.0 for p in system.parameters if p.name == ANGLE):
        angles = []
    dropped = {channel for number, channel in enumerate(angles) if number % FACTORS >= FACTORS // 2}
    return np.array([channel for channel in range(len(names)) if channel not in dropped], dtype=np.intp)


def half_turn(tau: FloatArray) -> ComplexArray:
    """Entry of Delta for an angle with ``tau = tan(theta / 4)``: ``sin(theta / 2) exp(j theta / 2)``.

    Examples
    --------
    At theta = pi:

    >>> np.round(half_turn(np.array([1.0])), 12).tolist()
    [1j]
    """
    half = 2.0 * np.arctan(tau)
    return np.asarray(np.sin(half) * np.exp(1j * half))


def half_turn_slope(tau: FloatArray) -> ComplexArray:
    """Derivative of :func:`half_turn`."""
    return np.asarray(2.0 * np.exp(4j * np.arctan(tau)) / (1.0 + tau**2))


@dataclass(frozen=True)
class AngleClosed:
    """An LFT whose angle is closed: ``constant + sum_k delta / (1 - delta poles_k) residue_k``.

    Parameters
    ----------
    poles : ndarray, complex, shape (a,)
    terms : ndarray, complex, shape (a + 1, (r + p) (r + m))
        The residues for the r other channels and p outputs, the r other channels and m inputs; last the constant.
    shape : (int, int)
        ``r + p, r + m``.
    angle : ndarray of bool, shape (a + r,)
        Which of the channels are those of the angle.
    """

    poles: ComplexArray
    terms: ComplexArray
    shape: tuple[int, int]
    angle: BoolArray

    @classmethod
    def of(cls, parts: Sequence[ComplexArray], angle: BoolArray) -> AngleClosed | None:
        """Of an LFT's parts M, T12, T21, T11; None where the eigenvectors do not carry it."""
        M, T12, T21, T11 = parts
        others = ~angle
        poles, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(M[np.ix_(angle, angle)]))
        lu, pivots, info = linalg.lapack.zgetrf(vectors)
        reciprocal = linalg.lapack.zgecon(lu, np.abs(vectors).sum(axis=0).max())[0]
        if info != 0 or not reciprocal * MAX_CONDITION >= 1.0:
            return None
        left = np.vstack([M[np.ix_(others, angle)], T12[:, angle]]) @ vectors
        into = np.hstack([M[np.ix_(angle, others)], T21[angle]])
        right = linalg.lapack.zgetrs(lu, pivots, into)[0]
        shape = (len(left), right.shape[1])
        terms: ComplexArray = np.empty((len(poles) + 1, *shape), complex)
        np.multiply(left.T[:, :, None], right[:, None, :], out=terms[:-1])
        terms[-1] = np.block([[M[np.ix_(others, others)], T21[others]], [T12[:, others], T11]])
        return cls(poles, terms.reshape(len(terms), -1), shape, angle)

    def responses(self, delta: ComplexArray) -> ComplexArray:
        """Responses for N diagonals of Delta (N, a + r): shape (N, p, m)."""
        own, first = delta[:, ~self.angle], int(np.flatnonzero(self.angle)[0])
        r, each = own.shape[1], np.arange(own.shape[1])
        out = np.empty((len(delta), self.shape[0] - r, self.shape[1] - r), complex)
        size = min(TOGETHER, len(delta))
        factors, space = np.ones((size, len(self.terms)), complex), np.empty((size, self.terms.shape[1]), complex)
        for start in range(0, len(delta), size):
            part = slice(start, min(start + size, len(delta)))
            turned, count = delta[part, first, None], part.stop - part.start
            factors[:count, :-1] = turned / (1.0 - turned * self.poles)
            whole = np.matmul(factors[:count], self.terms, out=space[:count]).reshape(-1, *self.shape)
            loop = whole[:, :r, :r].swapaxes(1, 2) * -own[part, :, None]
            loop[:, each, each] += 1.0
            z = solve(loop, whole[:, r:, :r].swapaxes(1, 2) * own[part, :, None]).swapaxes(1, 2)
            np.matmul(z, whole[:, :r, r:], out=out[part])
            out[part] += whole[:, r:, r:]
        return out


__all__ = ["AngleClosed", "half_turn", "half_turn_slope", "kept_channels"]
