"""Bounds of the parameters of a controller structure, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.scalars import as_number
from lftkit.systems.arguments import checked
from lftkit.systems.ports import read_only
from lftkit.tuning.pieces import HARD_TARGET, Piece


@checked
@dataclass(frozen=True)
class Bounds:
    """Lowest and highest values of the parameters (size,), infinite where there is none."""

    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name), dtype=float)))
        wrong = np.flatnonzero(~(self.lower < self.upper))
        if len(wrong):
            low, high = float(self.lower[wrong[0]]), float(self.upper[wrong[0]])
            raise InputError(f"bounds must be a lowest and a higher highest value, got ({low:g}, {high:g})")

    def of(self, numbers: IntArray) -> Bounds:
        """Those of some of the parameters."""
        return Bounds(self.lower[numbers], self.upper[numbers])

    @property
    def scales(self) -> FloatArray:
        """Half the width of each interval; of a single bound its size, but at least 1."""
        finite = np.isfinite(self.lower) & np.isfinite(self.upper)
        single = np.where(np.isfinite(self.lower), np.abs(self.lower), np.abs(self.upper))
        with np.errstate(invalid="ignore"):
            half = 0.5 * (self.upper - self.lower)
        return np.asarray(np.where(finite, half, np.maximum(np.where(np.isfinite(single), single, 1.0), 1.0)))

    def clipped(self, x: FloatArray) -> FloatArray:
        """Parameters (size,) within the bounds."""
        return np.asarray(np.clip(x, self.lower, self.upper))

    def drawn(self, x: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Random parameters (size,) within: those outside are drawn from their interval, or reflected at a bound."""
        share = rng.uniform(0.01, 0.99, len(x))
        both = np.isfinite(self.lower) & np.isfinite(self.upper)
        with np.errstate(invalid="ignore"):
            uniform = self.lower + share * (self.upper - self.lower)
            reflected = np.where(x < self.lower, 2.0 * self.lower - x, 2.0 * self.upper - x)
        outside = (x < self.lower) | (x > self.upper)
        return np.asarray(np.where(outside, np.where(both, uniform, reflected), x))

    def at(self, x: FloatArray, near: float = 1e-4) -> IntArray:
        """Numbers of the parameters that are at a bound, to a distance `near` of its scale."""
        distance = np.minimum(x - self.lower, self.upper - x)
        return np.flatnonzero(distance <= near * self.scales)

    def pieces(self, x: FloatArray, requirement: int, near: float = 0.5) -> list[Piece]:
        """Bounds near the parameters `x`, as pieces of a hard requirement that is met exactly at the bound.

        They are near up to a distance `near` of their scale.
        """
        scales, pieces = self.scales, []
        for sign, distance in ((-1.0, x - self.lower), (1.0, self.upper - x)):
            for k in np.flatnonzero(distance <= near * scales):
                gradient = np.zeros(len(x))
                gradient[k] = sign / scales[k]
                value = HARD_TARGET - float(distance[k]) / float(scales[k])
                # pieces are told apart by frequency: one of its own for each parameter
                pieces.append(Piece(value, gradient, True, requirement, 0, 2.0 ** float(k % 1000)))
        return pieces


def bounds_of(structure: object) -> Bounds | None:
    """Bounds of a structure; None where it has none."""
    bounds = getattr(structure, "bounds", None)
    if bounds is not None and not isinstance(bounds, Bounds):
        raise InputError(f"bounds of a structure must be Bounds or None, got {type(bounds).__name__}")
    if bounds is None or not (np.isfinite(bounds.lower).any() or np.isfinite(bounds.upper).any()):
        return None
    return bounds


def number_of(name: str, names: Sequence[str]) -> int:
    """Number of a parameter.

    Raises
    ------
    ValueError
        An unknown name, with those that there are.
    """
    if name not in names:
        raise InputError(f"parameter must be one of {', '.join(names)}, got {name!r}")
    return list(names).index(name)


def bounds_by_name(names: Sequence[str], before: Bounds | None, limits: Mapping[str, tuple[float, float]]) -> Bounds:
    """Bounds of the named parameters, with those `before`.

    Raises
    ------
    ValueError
        An unknown name, or a lowest value that is not below the highest.
    """
    lower = np.full(len(names), -np.inf) if before is None else before.lower.copy()
    upper = np.full(len(names), np.inf) if before is None else before.upper.copy()
    for name, ends in limits.items():
        number = number_of(name, names)
        low, high = (as_number(value, f"bound of {name}") for value in ends)
        if not low < high:
            raise InputError(f"bounds of {name} must be a lowest and a higher highest value, got ({low:g}, {high:g})")
        lower[number], upper[number] = low, high
    return Bounds(lower, upper)


@dataclass(frozen=True)
class ParameterBounds:
    """Bounds of the structure's parameters, kept by the descents as a hard requirement: not one that users give."""

    hard: bool = True
    name: str = "bounds of the parameters"
