"""Design in rounds: tune on a few models, search the implemented loop for worse parameters, add them, repeat.

The scheme of :func:`robust_design.tune_robust` with another search: that of :mod:`los_design.worst_points`, on the
sampled loop itself. What is added are the worst points of the bands of every metric that exceed its bound.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from los_design.worst_points import Search, SearchOptions, WorstPoint
from lti import SampledSystem, StateSpace
from robust_design import Requirement, TuningOptions, TuningResult, tune
from robust_design.structures import Structure

FloatArray = NDArray[np.float64]

MAX_NEW = 4
"""Points that a round adds at most."""

SLACK = 3e-3
"""A worst point counts only if it exceeds 1, or what the tuner reached above 1, by more than this part."""

APART = 0.03
"""Least relative distance of the frequencies of two new points."""


@dataclass(frozen=True)
class Effort:
    """Limits of a design in rounds; they end it, not the time: otherwise the result depends on the machine.

    Parameters
    ----------
    rounds : int
    iterations : int
        Of the tuner in each round.
    quick, thorough : SearchOptions
        Search of the rounds, and of the end: a design is ``converged`` if that finds nothing worse, either.
    """

    rounds: int
    iterations: int
    quick: SearchOptions
    thorough: SearchOptions


@dataclass(frozen=True)
class Outcome:
    """Result of a design in rounds.

    Parameters
    ----------
    status : str
        ``converged``, ``rounds`` (worse points were still found in the last round), or the tuner's where it failed.
    tuning : TuningResult
    worst : dict of str to WorstPoint
        Worst point of every metric by the last search.
    active : list of dict
        Parameter points of the models.
    bounds : mapping of str to (requirement, factor)
        See :class:`Task`.
    """

    status: str
    tuning: TuningResult
    worst: dict[str, WorstPoint]
    active: list[dict[str, float]]
    bounds: Mapping[str, tuple[str, float]]

    def worst_cases(self) -> list[dict[str, Any]]:
        """Worst value of each requirement, in its own normalisation, with frequency and parameters."""
        return [
            {
                "requirement": self.bounds[name][0],
                "value": float(f"{p.gamma * self.bounds[name][1]:.6g}"),
                "omega": p.omega,
                "parameters": dict(p.parameters),
            }
            for name, p in self.worst.items()
        ]

    @property
    def controller(self) -> StateSpace:
        """The tuned controller."""
        return self.tuning.controller


@dataclass(frozen=True)
class Task:
    """What is designed.

    Parameters
    ----------
    plant : callable
        From parameter values to the plant of the design problem.
    requirements : sequence of Requirement
    structure : Structure
    loop_delay : float
        Of the tuner [s].
    sampled : callable
        From the tuned controller to the sampled one.
    search : callable
        From the sampled controller and the effort to a search of the implemented loop.
    bounds : mapping of str to (requirement, factor)
        Figures that a requirement stands for: its name, and the factor from gamma to the requirement's value.
    """

    plant: Callable[[Mapping[str, float]], StateSpace]
    requirements: Sequence[Requirement]
    structure: Structure
    loop_delay: float
    sampled: Callable[[StateSpace], SampledSystem]
    search: Callable[[SampledSystem, SearchOptions], Search]
    bounds: Mapping[str, tuple[str, float]]


def design_in_rounds(
    task: Task,
    start: FloatArray,
    active: Sequence[Mapping[str, float]],
    effort: Effort,
    tuning: TuningOptions,
    report: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Tune, search, add, until the thorough search finds nothing worse or the rounds are over.

    Parameters
    ----------
    task : Task
    start : ndarray
        Parameters of the structure.
    active : sequence of mapping
        First parameter points.
    effort : Effort
    tuning : TuningOptions
        Its wall limit is that of the whole design.
    report : callable
        Receives one line for each round.
    """
    x, points = start, [dict(values) for values in active]
    hard = {r.name: r.hard for r in task.requirements}
    start_time, known = time.monotonic(), list[WorstPoint]()
    for number in range(effort.rounds):
        # a start that meets the requirements is kept as it is
        options = replace(tuning, target=max(tuning.target, 1.0 + SLACK)) if number == 0 else tuning
        models = [task.plant(values) for values in points]
        result = tune(
            models, task.requirements, task.structure, initial=[x], loop_delay=task.loop_delay, options=options
        )
        x, values = result.x, {n: float(v.max()) for n, v in zip(result.requirement_names, result.values)}
        if not np.isfinite(result.abscissa) or result.abscissa >= 0.0:
            return Outcome(str(result.status), result, {}, points, task.bounds)
        controller = task.sampled(result.controller)
        for search in (effort.quick, effort.thorough):
            found = task.search(controller, search).run(list(task.bounds), known)
            worst = {name: peaks[0] for name, peaks in found.items() if peaks}
            new = _new(task, found, {n: max(1.0, v if hard[n] else result.soft) for n, v in values.items()})
            if new or number + 1 == effort.rounds:
                break
        report(_line(number, result, worst, task, len(points), time.monotonic() - start_time))
        known = [p for peaks in found.values() for p in peaks[:3]]
        if not new:
            return Outcome(_status(result), result, worst, points, task.bounds)
        if number + 1 < effort.rounds:
            points += [dict(p.parameters) for p in new]
    return Outcome("rounds", result, worst, points, task.bounds)


def _status(result: TuningResult) -> str:
    """Status of a design for which no worse parameters were found."""
    bad = ("infeasible", "out_of_time", "interrupted", "not_stabilised")
    return str(result.status) if str(result.status) in bad else "converged"


def _new(task: Task, found: Mapping[str, Sequence[WorstPoint]], levels: Mapping[str, float]) -> list[WorstPoint]:
    """Worst points above the level of their requirement, at different frequencies, the largest excess first."""
    excess = []
    for name, peaks in found.items():
        requirement, factor = task.bounds[name]
        for peak in peaks:
            ratio = peak.gamma * factor / levels[requirement]
            if ratio > 1.0 + SLACK:
                excess.append((ratio, peak))
    new: list[WorstPoint] = []
    for _, peak in sorted(excess, key=lambda entry: -entry[0]):
        if len(new) < MAX_NEW and all(abs(peak.omega - p.omega) > APART * p.omega for p in new):
            new.append(peak)
    return new


def _line(
    number: int, result: TuningResult, worst: Mapping[str, WorstPoint], task: Task, models: int, seconds: float
) -> str:
    peaks = ", ".join(
        f"{name} {p.gamma * task.bounds[name][1]:.3f} at {p.omega:.4g} rad/s" for name, p in worst.items()
    )
    return f"round {number + 1}: {models} models, tuned {result.soft:.3f}, worst found: {peaks} ({seconds:.0f} s)"
