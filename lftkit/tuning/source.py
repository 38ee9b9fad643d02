"""Where the values of a descent come from: one protocol for state-space models and for frequency responses.

A descent (:func:`lftkit.tuning.descent.minimax.minimax.descend`) alternates between two views of a problem. A *look*
has all values of a point: the exact gains of state-space models, or the gains at all sampled responses. The steps
between two looks see a *working set*, the frequencies and samples at which the values are near the largest one: it is
linearised, and it has the metric of the steps. What a look shows and the working set had missed belongs to the next
one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol, TypeVar

from lftkit.arrays import FloatArray

Merit = tuple[float, float]
"""Violation of the hard requirements, 0 where they are met, and the largest value: compared in this order."""


class LocalModel(Protocol):
    """Values of a working set linearised at a point, and what steps from there bring."""

    @property
    def values(self) -> FloatArray:
        """Pieces of the progress function at the point (m,): logarithms of values."""
        ...

    @property
    def gradients(self) -> FloatArray:
        """Of the pieces with respect to the step (m, n)."""
        ...

    @property
    def merit(self) -> Merit:
        """Of the point, in logarithms."""
        ...

    def factor(self) -> Any:
        """Cholesky factor of the metric, of ``scipy.linalg.cho_factor``."""
        ...

    def decrease(self, step: FloatArray, predicted: float) -> float:
        """Of the progress function by a step (n,); minus infinity where the point is not admitted."""
        ...

    @property
    def reached(self) -> tuple[FloatArray, Merit]:
        """The point that the last trial led to."""
        ...


class WorkingSet(Protocol):
    """What the steps between two looks see."""

    @property
    def planes(self) -> int:
        """Values that enter the first quadratic program of a step; others are added while they are violated."""
        ...

    @property
    def steps(self) -> int:
        """Most steps to the next look."""
        ...

    @property
    def slow(self) -> float:
        """Decrease of the logarithms by four steps below which no other follows."""
        ...

    def at(self, x: FloatArray) -> LocalModel:
        """Linearised at the admitted point `x` (size,)."""
        ...


class Look(Protocol):
    """All values of a point."""

    @property
    def x(self) -> FloatArray:
        """The point (size,)."""
        ...

    @property
    def merit(self) -> Merit:
        """In which points are compared; infinite where a loop is unstable."""
        ...


L = TypeVar("L", bound=Look)


class DescentSource(Protocol[L]):
    """A tuning problem as a descent sees it, with the memory of what earlier working sets had missed."""

    def begin(self, x: FloatArray) -> FloatArray:
        """A start (size,) as it is admitted.

        Raises
        ------
        ValueError
            It is not stable.
        """
        ...

    def look(self, x: FloatArray) -> L:
        """All values at `x` (size,)."""
        ...

    def stable(self, x: FloatArray) -> bool:
        """Whether the loops are stable at `x` (size,), where a look does not say so."""
        ...

    def note(self, look: L, level: float) -> None:
        """Remember what a look shows for the working sets to come; `level` is the largest value that still counts."""
        ...

    def working_set(self, look: L) -> WorkingSet:
        """For steps from the point of a look."""
        ...

    def trials(self, look: L) -> Iterator[FloatArray]:
        """Points that are lower where `look` is no local minimum: other metrics, random directions."""
        ...

    def memory(self) -> list[Any]:
        """What :meth:`note` has collected, for JSON."""
        ...

    def recall(self, memory: list[Any]) -> None:
        """Continue with a :meth:`memory`."""
        ...


def lower(new: Merit, old: Merit, tolerance: float = 0.0) -> bool:
    """Met where `old` violates, or not higher and lower by at least the relative `tolerance`."""
    if (new[0] > 0.0) != (old[0] > 0.0):
        return not new[0] > 0.0
    k = 0 if new[0] > 0.0 else 1
    return new[k] * (1.0 + tolerance) <= old[k]
