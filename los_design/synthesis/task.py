"""What is designed: samples, stages, controllers, and the parameter points that are sampled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.support.workers import Workers
from lftkit.tuning.responses import ControllerBlock, ResponseProblem
from los_design.search.worst_case_search import Search, SearchOptions, points_with_ends
from los_design.synthesis.pair_problem import STAGE_NAMES, Samples, blocks, limits, pair_problem
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.implemented_loop import ImplementedLoop

HALVINGS = 7
"""Of the way to an unstable point."""


@dataclass(frozen=True)
class Task(ABC):
    """What is designed.

    Parameters
    ----------
    samples : Samples
    stages : tuple of stages
        Whose requirements count.
    tuned : tuple of int
        Which controllers are tuned.
    seed : int
    wall_limit : float
        Of the whole design [s].
    workers : Workers
        Processes of the searches; the result does not depend on them.
    """

    samples: Samples
    stages: tuple[tuple[int, ...], ...]
    tuned: tuple[int, ...]
    seed: int = 0
    wall_limit: float = np.inf
    workers: Workers = field(default_factory=Workers)

    @property
    @abstractmethod
    def blocks(self) -> tuple[ControllerBlock, ControllerBlock]:
        """The controllers."""

    @abstractmethod
    def problem(self) -> ResponseProblem:
        """What is tuned, on the samples that there are."""

    @abstractmethod
    def limits(self, stage: tuple[int, ...]) -> dict[str, float]:
        """What a gain of 1 stands for in a stage."""

    def of_limit(self, name: str, value: float) -> float:
        """A value of a gain or noise of :meth:`problem` over what :meth:`limits` says."""
        return float(value)

    @abstractmethod
    def search(self, x: FloatArray, stage: tuple[int, ...], options: SearchOptions) -> Search:
        """Search of a stage with the controllers of `x`."""

    @abstractmethod
    def stable(self, x: FloatArray, values: Mapping[str, float] | None = None) -> bool:
        """Whether the loops of all stages are stable at a parameter point, default the nominal one."""

    def missed_peaks(self, x: FloatArray, tuned: Mapping[str, float]) -> list[float]:
        """Frequencies [rad/s] of peaks of the nominal loop that samples and searches have missed.

        Parameters
        ----------
        x : ndarray
            Entries of both gain matrices.
        tuned : mapping
            Value of each gain of :meth:`problem` with them.
        """
        return []


@dataclass(frozen=True)
class ImplementedTask(Task):
    """What is designed in the implemented loop.

    Parameters
    ----------
    sampled : callable
        From the parameter vector to the sampled K_FSM and K_PMA.
    """

    sampled: Callable[[FloatArray], tuple[SampledSystem, SampledSystem]] = field(kw_only=True)

    @property
    def blocks(self) -> tuple[ControllerBlock, ControllerBlock]:
        """The controllers."""
        return blocks(self.samples.open_loop.telescope, self.tuned)

    def problem(self) -> ResponseProblem:
        """What is tuned, on the samples that there are."""
        return pair_problem(self.samples, self.stages, self.tuned, self.workers.count)

    def limits(self, stage: tuple[int, ...]) -> dict[str, float]:
        """What a gain of 1 stands for in a stage: what is tuned for."""
        return limits(self.samples.open_loop.telescope, stage)

    def search(self, x: FloatArray, stage: tuple[int, ...], options: SearchOptions) -> Search:
        """Search of a stage with the controllers of `x`."""
        return Search(ImplementedLoop(self.samples.open_loop, *self.sampled(x), STAGE_NAMES[stage]), options)

    def stable(self, x: FloatArray, values: Mapping[str, float] | None = None) -> bool:
        """Whether the loops of all stages are stable at a parameter point, default the nominal one."""
        loop = self.samples.open_loop
        plant, pair = loop.system.at(dict(values or {})), self.sampled(x)
        sensitivity = loop.telescope.fsm.los_sensitivity
        laws = (ControlLaws(*pair, STAGE_NAMES[stage], loop.ports, sensitivity) for stage in self.stages)
        return all(sampled_loop(plant, one).spectral_radius() < 1.0 for one in laws)


def first_points(task: Task, count: int, ends: bool = False) -> list[FloatArray]:
    """The nominal point and `count` others of the box, the first half of them random corners.

    Most parameters of the second half are at an end of their range with `ends`, otherwise they are uniform in it.
    """
    rng, loop = np.random.default_rng(task.seed), task.samples.open_loop
    size = len(loop.names)
    points = points_with_ends(rng, count, size) if ends else rng.uniform(size=(count, size))
    points[: count // 2] = np.round(points[: count // 2])
    return [loop.point({}), *points]


def stable_point(task: Task, x: FloatArray, point: FloatArray) -> FloatArray:
    """A point; where the loop is unstable there, the last stable one on the way from the nominal point.

    Gains are large beside the boundary of stability, so that a descent moves it away; beyond it they are small again.
    """
    loop, stable, nominal = task.samples.open_loop, 0.0, task.samples.open_loop.point({})
    if task.stable(x, loop.values(point)):
        return point
    for step in 0.5 ** np.arange(1, HALVINGS + 1):
        if task.stable(x, loop.values(nominal + (stable + step) * (point - nominal))):
            stable += step
    return np.asarray(nominal + stable * (point - nominal))


def sample_around(task: Task, around: Sequence[tuple[float, FloatArray]]) -> None:
    """Sample the points that a round added: in the same order when a design goes on, for the same bits."""
    task.samples.add(np.array([at for _, at in around]))
    for omega, at in around:
        task.samples.add_around(omega, at)


def sample_peaks(task: Task, peaks: Sequence[float]) -> None:
    """Sample the nominal point closely around frequencies [rad/s]."""
    for omega in peaks:
        task.samples.add_around(omega, task.samples.open_loop.point({}))
