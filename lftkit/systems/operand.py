"""What operators and connections ask of their operands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.scalars import is_number
from lftkit.systems.ports import Port, total_size


class Timed(Protocol):
    """What is asked for the sampling period."""

    @property
    def order(self) -> int:
        """Number of states."""

    @property
    def dt(self) -> float:
        """Sampling period [s]; 0: continuous time."""


def common_period(systems: Iterable[Timed]) -> float:
    """Sampling period [s] of systems that are combined; gains without states fit every period.

    Raises
    ------
    ValueError
        Different periods, or continuous and discrete time.
    """
    periods = sorted({s.dt for s in systems if s.order or s.dt})
    if len(periods) > 1 and not (periods[0] and periods[-1] - periods[0] <= 1e-12 * periods[-1]):
        shown = ", ".join(f"{dt:g} s" if dt else "continuous time" for dt in periods)
        raise InputError(f"systems must have the same sampling period, got {shown}")
    return periods[0] if periods else 0.0


def same_size(first: Sequence[Port], second: Sequence[Port], where: str) -> None:
    """Raise a ValueError with the ports and sizes of both sides where their signals differ in number."""
    if total_size(first) != total_size(second):
        sides = (", ".join(f"{p.name}[{p.size}]" for p in side) or "none" for side in (first, second))
        raise InputError(f"{where} must have the same number of signals, got {' and '.join(sides)}")


def constant_matrix(value: Any) -> FloatArray | None:
    """A number or a matrix of numbers as an array (p, m); None for anything else."""
    if is_number(value):
        return np.array([[float(value)]])
    if isinstance(value, np.ndarray | list | tuple):
        array = np.asarray(value)
        if array.dtype.kind in "biuf" and array.ndim == 2:
            return array.astype(float)
    return None
