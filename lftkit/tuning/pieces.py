"""Smooth pieces of a nonsmooth objective and what an oracle reports at a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray

HARD_TARGET = 1.0 - 1e-5
"""Value that the descent asks of hard requirements: it ends within a few millionths of it, on either side, and the
requirement itself, at most 1, is then met."""


@dataclass(frozen=True)
class Piece:
    """One smooth piece of the nonsmooth problem.

    Parameters
    ----------
    value : float
        Normalised value.
    gradient : ndarray, shape (size,)
        With respect to the structure's parameters.
    hard : bool
    requirement, model : int
        Numbers in the problem's lists.
    peak_frequency : float
        Frequency of the peak or modulus of the pole [rad/s]; 0 for an H2 norm.
    """

    value: float
    gradient: FloatArray
    hard: bool
    requirement: int
    model: int
    peak_frequency: float


@dataclass(frozen=True)
class OracleResult:
    """Values, pieces and stability margins at a point.

    Parameters
    ----------
    objective : float
        Largest soft value; infinite outside the domain (an unstable loop).
    constraint : float
        Largest hard value minus :data:`HARD_TARGET`; minus infinity without constraints.
    pieces : tuple of Piece
    barriers : tuple of (margin, gradient)
        Margins to the boundary of the domain (negative inside, 0 on it) with gradients (n,): they bound the step.
    """

    objective: float
    constraint: float
    pieces: tuple[Piece, ...]
    barriers: tuple[tuple[float, FloatArray], ...] = ()

    @property
    def inside(self) -> bool:
        """The point is in the domain."""
        return bool(np.isfinite(self.objective))

    @property
    def settled(self) -> bool:
        """In the domain, all hard requirements met, and no soft piece: nothing is left to lower."""
        return self.inside and self.constraint <= 0.0 and all(piece.hard for piece in self.pieces)

    def largest(self, count: int) -> list[Piece]:
        """The `count` largest soft pieces and as many hard ones."""
        return [
            piece
            for hard in (False, True)
            for piece in sorted((p for p in self.pieces if p.hard is hard), key=lambda p: -p.value)[:count]
        ]


Oracle = Callable[[FloatArray], OracleResult]


def matching_piece(piece: Piece, others: tuple[Piece, ...], apart: float = 0.1) -> Piece | None:
    """The piece of the same requirement and model nearest in frequency, or None.

    Peaks count as the same one up to a relative distance `apart` of their frequencies.
    """
    best, distance = None, apart
    for other in others:
        if (other.requirement, other.model, other.hard) != (piece.requirement, piece.model, piece.hard):
            continue
        d = 1e-3 * abs(other.value - piece.value) / max(abs(piece.value), 1e-12)
        if piece.peak_frequency != other.peak_frequency:
            d += abs(other.peak_frequency - piece.peak_frequency) / max(piece.peak_frequency, 1e-12)
        if d < distance:
            best, distance = other, d
    return best
