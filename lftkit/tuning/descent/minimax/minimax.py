"""Minimax descent: the largest of all values is lowered, by steps on a working set between looks at all values.

Most values are far from the largest one: the steps (:mod:`lftkit.tuning.descent.minimax.prox_linear`) see those near
it. A look decides whether the point that they led to is kept. Where it shows a higher value than before, the steps
since the last look are taken back, the next ones are shorter, and what was missed belongs to their working set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.tuning.descent.minimax.prox_linear import FIRST_WEIGHT, REJECTED, prox_linear
from lftkit.tuning.source import DescentSource, Look, Merit, lower
from lftkit.tuning.status import TuningStatus

VISIBLE = 1e-3
"""Relative decrease that refutes a local minimum."""
FRUITLESS = 3
"""Looks in a row after which no step was found, beyond which a descent is at its end."""
RESTORATIONS = 2
"""Working sets in a row that may bring a lower point back which violates what was met."""

L = TypeVar("L", bound=Look)


@checked
@dataclass(frozen=True)
class DescentOptions:
    """Limits of a descent, and what it counts as progress.

    Parameters
    ----------
    iterations : int
        Most steps, or quadratic programs.
    tolerance : float
        It is ``stalled`` when `patience` looks together lower the value by less than this part. For the bundle method:
        a point is stationary when the smallest convex combination of nearly active gradients is below this part.
    target : float
        It ends when the largest value is below, and the hard requirements hold.
    deadline : float
        Value of ``time.monotonic()`` at which it ends.
    evaluations : int
        Most evaluations of the bundle method.
    patience : int
    retries : int
        Looks in a row at which the steps before are taken back, beyond which it is ``stalled``.
    confirm : bool
        Where it would be ``stalled``, try what the source knows for it
        (:meth:`lftkit.tuning.source.DescentSource.trials`); it goes on where that lowers the value by 0.1 %, and is
        ``converged`` where nothing does.
    """

    iterations: int = 300
    tolerance: float = 1e-4
    target: float = -np.inf
    deadline: float = np.inf
    evaluations: int = 1_000_000
    patience: int = 4
    retries: int = 1_000_000
    confirm: bool = False


@dataclass(frozen=True)
class Descent(Generic[L]):
    """End of a descent: the best look, why it ended, steps taken."""

    point: L
    status: TuningStatus
    iterations: int

    @property
    def x(self) -> FloatArray:
        """The best point (size,)."""
        return self.point.x


@dataclass
class DescentState:
    """Where a descent is before a look; with it, it goes on with the same bits.

    Parameters
    ----------
    x, best : ndarray
        Point that is looked at, and the best one before.
    weight : float
        Of the quadratic term.
    memory : list
        Of the source.
    history : list of (violation, value)
        At the looks that lowered it.
    iteration, failures, taken_back, restored : int
    """

    x: FloatArray
    best: FloatArray
    weight: float = FIRST_WEIGHT
    memory: list[Any] = field(default_factory=list)
    history: list[Merit] = field(default_factory=list)
    iteration: int = 0
    failures: int = 0
    taken_back: int = 0
    restored: int = 0

    def to_mapping(self) -> dict[str, Any]:
        """For JSON, which keeps every bit of a finite number."""
        return {**vars(self), **{name: getattr(self, name).tolist() for name in ("x", "best")}}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> DescentState:
        """As :meth:`to_mapping` makes it."""
        arrays = {name: np.array(values[name], dtype=float) for name in ("x", "best")}
        return cls(**{**values, **arrays, "history": [(violation, value) for violation, value in values["history"]]})


@checked
def descend(
    source: DescentSource[L],
    x: FloatArray,
    options: DescentOptions | None = None,
    report: Callable[[int, L], None] = lambda iteration, look: None,
    keep: Callable[[DescentState], None] = lambda state: None,
    goes_on: DescentState | None = None,
) -> Descent[L]:
    """Lower the largest value from a stabilising start.

    Parameters
    ----------
    source : DescentSource
    x : ndarray, shape (size,)
    options : DescentOptions, optional
    report : callable
        Receives the steps so far and each look that lowered the value.
    keep : callable
        Receives the state before each look but the first.
    goes_on : DescentState, optional
        State of an interrupted descent with the same arguments: it goes on there.

    Raises
    ------
    ValueError
        A start that is not stable or has values that are not finite.
    """
    run = _Run(source, source.begin(x), options or DescentOptions(), goes_on)
    while True:
        if run.iteration and (goes_on is None or run.iteration > goes_on.iteration):
            keep(run.state())
        if run.look():
            report(run.iteration, run.best())
        status = run.ended()
        if status is None:
            run.step()
        elif status is not TuningStatus.STALLED or not run.options.confirm:
            return Descent(run.best(), status, run.iteration)
        elif (restart := lower_point(source, run.best())) is None:
            return Descent(run.best(), TuningStatus.CONVERGED, run.iteration)
        elif run.iteration >= run.options.iterations:
            return Descent(run.best(), status, run.iteration)
        else:
            run.go_on_at(restart)


def lower_point(source: DescentSource[L], best: L) -> FloatArray | None:
    """The first of a source's trials with a visibly lower value (size,); None where there is none."""
    for x in source.trials(best):
        merit = source.look(x).merit
        if lower(merit, best.merit, VISIBLE) and source.stable(x):
            return x
    return None


class _Run(Generic[L]):
    """The running descent."""

    def __init__(
        self, source: DescentSource[L], x: FloatArray, options: DescentOptions, goes_on: DescentState | None
    ) -> None:
        self.options, self._source = options, source
        self._now = replace(goes_on, history=list(goes_on.history)) if goes_on else DescentState(x, x.copy())
        if goes_on is not None:
            source.recall(goes_on.memory)
        self._best: L | None = None
        self._from: L | None = None

    @property
    def iteration(self) -> int:
        """Steps so far."""
        return self._now.iteration

    def state(self) -> DescentState:
        """For :func:`descend` to go on."""
        return replace(self._now, memory=self._source.memory(), history=list(self._now.history))

    def best(self) -> L:
        """The best look."""
        if self._best is None:
            self._best = self._source.look(self._now.best)
        return self._best

    def look(self) -> bool:
        """Look at all values of the present point; whether it is kept."""
        now, history = self._now, self._now.history
        look = self._source.look(now.x)
        if not history and not np.isfinite(look.merit).all():
            raise InputError("start must have finite gains, got a value that is not")
        self._source.note(look, min(look.merit[1], history[-1][1] if history else np.inf))
        if not history or lower(look.merit, history[-1]):
            history.append(look.merit)
            now.x = now.best = look.x
            self._best = self._from = look
            now.taken_back = now.restored = 0
            return True
        if _restorable(look.merit, history[-1]) and now.restored < RESTORATIONS:
            self._from, now.restored = look, now.restored + 1
            return False
        now.x, self._from, now.weight = now.best.copy(), self.best(), REJECTED * now.weight
        now.taken_back, now.restored = now.taken_back + 1, 0
        return False

    def ended(self) -> TuningStatus | None:
        """Why the descent is at its end; None where it is not."""
        options, now, history = self.options, self._now, self._now.history
        violation, value = history[-1]
        before = history[-1 - options.patience] if len(history) > options.patience else None
        idle = before is not None and not now.restored and not lower(history[-1], before, options.tolerance)
        if not violation > 0.0 and value < options.target:
            return TuningStatus.TARGET
        if idle or now.failures > FRUITLESS or now.taken_back > options.retries:
            return TuningStatus.STALLED
        if self._late():
            return TuningStatus.OUT_OF_TIME
        return None if now.iteration < options.iterations else TuningStatus.ITERATIONS

    def step(self) -> None:
        """The steps to the next look."""
        now, working = self._now, self._source.working_set(self._from or self.best())
        reached = prox_linear(working, now.x, weight=now.weight, stop=self._late)
        now.x, now.weight = reached.x, reached.weight
        now.iteration += working.steps
        now.failures = 0 if reached.taken else now.failures + 1

    def go_on_at(self, x: FloatArray) -> None:
        """Begin again at a lower point."""
        self._now = DescentState(x, self._now.best, iteration=self._now.iteration)

    def _late(self) -> bool:
        return time.monotonic() > self.options.deadline


def _restorable(new: Merit, old: Merit) -> bool:
    """Lower, but in violation of what was met."""
    return not old[0] > 0.0 and 0.0 < new[0] < np.inf and new[1] < old[1]
