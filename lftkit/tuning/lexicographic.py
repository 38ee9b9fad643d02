"""Lexicographic tuning: the largest soft values are held where they are, and the next ones are lowered.

A minimax descent leaves every requirement but the critical ones anywhere below the largest value. Here the critical
ones become hard at what they have reached and the others are tuned again, until each has its own level (lexicographic
minimax, Ehrgott 2005, section 5.3). It works on any of the ways to tune, which it calls.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.result import Level, TuningResult
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.structures import AffineStructure, Structure, gain_matrix_of

FIRST_SHARE = 0.5
"""Part of the wall limit for the first level, and of what is left then for each further tuning."""
LEAST_SHARE = 0.01
"""Part of the wall limit below which no further tuning begins."""
TIE = 0.01
"""Relative distance from the largest value up to which a requirement may be critical, and by which it must fall alone
to be none."""
GOES_ON = (
    TuningStatus.CONVERGED,
    TuningStatus.STALLED,
    TuningStatus.INACCURATE,
    TuningStatus.ITERATIONS,
    TuningStatus.ROUNDS,
    TuningStatus.OUT_OF_TIME,
)
"""Ends of a tuning after which its next level is tuned."""


class Tuner(Protocol):
    """Tunes a structure against requirements from given starts."""

    def __call__(
        self,
        requirements: Sequence[TuningRequirement],
        structure: Structure,
        *,
        initial: Sequence[FloatArray],
        options: TuningOptions,
    ) -> TuningResult:
        """As :func:`lftkit.tuning.tune`, with the models that are known."""
        ...


def tuned_in_order(
    run: Tuner,
    requirements: Sequence[TuningRequirement],
    structure: Structure,
    initial: Sequence[FloatArray],
    options: TuningOptions,
    slack: float,
) -> TuningResult:
    """Tune level by level.

    Parameters
    ----------
    run : callable
        One of the ways to tune, with its models.
    requirements, structure, initial, options
        As given to it.
    slack : float
        Excess of a hard value over 1 with which a level is accepted.

    Returns
    -------
    TuningResult
        Values are those of the requirements as given. The status is the first one that is not ``converged`` of all
        tunings, or ``converged``.
    """
    plain = replace(options, lexicographic=False)
    begin = time.monotonic()
    share = replace(plain, wall_limit=FIRST_SHARE * plain.wall_limit)
    first = run(requirements, structure, initial=initial, options=share)
    goes_on = first.status in GOES_ON and first.certificate is not None and first.feasible
    if not goes_on or first.soft <= plain.target or not structure.size:
        return first
    plain = replace(plain, target=-np.inf)
    levels = _Levels(run, list(requirements), structure, plain, slack, begin + plain.wall_limit, first, [first])
    levels.to_the_end()
    best, left = levels.best, max(levels.left, LEAST_SHARE * plain.wall_limit)
    effort = replace(plain, starts=0, wall_limit=left)
    # The structure without parameters whose controller is that of a result
    none: IntArray = np.zeros(0, dtype=np.intp)
    K, dt = best.controller, best.controller.dt
    base = gain_matrix_of(K)
    judged = run(
        requirements,
        AffineStructure(structure.inputs, structure.outputs, K.order, base, none, none, none, np.zeros(0), dt=dt),
        initial=(),
        options=effort,
    )
    status = levels.status
    return replace(
        best,
        status=status,
        advice=best.advice if status is best.status else status.advice,
        soft=judged.soft,
        hard=judged.hard,
        values=judged.values,
        peak_frequencies=judged.peak_frequencies,
        certificate=judged.certificate,
        seconds=time.monotonic() - begin,
        evaluations=sum(r.evaluations for r in levels.runs),
        iterations=sum(r.iterations for r in levels.runs),
        starts=first.starts,
        worst=judged.worst,
        active=judged.active,
        rounds=first.rounds,
        levels=tuple(levels.levels),
    )


@dataclass
class _Levels:
    """The levels so far; `needs` are the requirements, those of past levels hard at what they have reached."""

    run: Tuner
    needs: list[TuningRequirement]
    structure: Structure
    options: TuningOptions
    slack: float
    deadline: float
    best: TuningResult
    runs: list[TuningResult]
    levels: list[Level] = field(default_factory=list)
    late: bool = False

    @property
    def left(self) -> float:
        """Time [s]."""
        return self.deadline - time.monotonic()

    @property
    def status(self) -> TuningStatus:
        """The first that is not ``converged``."""
        statuses = [r.status for r in self.runs if r.status is not TuningStatus.CONVERGED]
        statuses += [TuningStatus.OUT_OF_TIME] * self.late
        return statuses[0] if statuses else TuningStatus.CONVERGED

    def to_the_end(self) -> None:
        """Level by level, as long as something is above `met`."""
        while not self.late and self.runs[-1].status is not TuningStatus.INTERRUPTED:
            soft = [i for i, r in enumerate(self.needs) if not r.hard]
            values = largest_values(self.best)
            top = max((float(values[i]) for i in soft), default=-np.inf)
            if not top > max(self.options.met, 0.0):
                break
            # Those at the level that do not fall while the others keep it
            near = [i for i in soft if values[i] >= top * (1.0 - TIE)]
            critical = near
            for i in near:
                without = [k for k in critical if k != i]
                if without and not self.late and self._lowered(self._held(without, top), top * (1.0 - TIE)):
                    critical = without
            self.levels.append(Level(tuple(self.needs[i].name for i in critical), top))
            self.needs = self._held(critical, top)
            others = [values[i] for i in soft if i not in critical]
            if others and len(critical) == len(near):
                self._lowered(self.needs, max(others))

    def _held(self, numbers: Sequence[int], top: float) -> list[TuningRequirement]:
        limit = top * (1.0 + self.options.hold)
        return [r.held(limit) if k in numbers else r for k, r in enumerate(self.needs)]

    def _lowered(self, needs: Sequence[TuningRequirement], below: float) -> bool:
        """Whether the soft ones of `needs` fall below a value, from the best point, which moves there."""
        if self.left < LEAST_SHARE * self.options.wall_limit:
            self.late = True
            return False
        options = replace(self.options, starts=0, wall_limit=FIRST_SHARE * self.left)
        result = self.run(needs, self.structure, initial=[self.best.x], options=options)
        self.runs.append(result)
        if result.certificate is None or result.status not in (*GOES_ON, TuningStatus.INTERRUPTED):
            return False
        values, hard = largest_values(result), np.array([r.hard for r in needs])
        if np.any(values[hard] > 1.0 + self.slack) or not values[~hard].max() < below:
            return False
        self.best = result
        return True


def largest_values(result: TuningResult) -> FloatArray:
    """Largest value of each requirement: over the models, of a robust design over the box."""
    values = result.values.max(axis=1)
    return np.asarray(np.maximum(values, [w.value for w in result.worst]) if result.worst else values)
