"""Synthesis of the two controllers: design problem, tuner, sampled controller with its provenance.

Designs are tuned on frequency responses, in rounds (:mod:`los_design.synthesis.rounds`): tune, search the loop for
worse parameters, add them. The loop is the implemented one, or that of the paper's continuous problem
(:mod:`los_design.synthesis.paper_problem`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fsm_pma_controller.problem import sampled_controller
from lftkit import SampledSystem, state_space
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.job import Job
from lftkit.support.workers import Workers
from lftkit.tuning.responses import gain_matrices
from los_design.search.worst_case_search import SearchOptions
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.pair_problem import (
    ACTUATORS,
    ALONE,
    ALONE_SUFFIX,
    BOTH,
    OBSERVER,
    STAGE_NAMES,
    Samples,
    blocks,
)
from los_design.synthesis.paper_problem import ORDERS, PaperSamples, PaperTask
from los_design.synthesis.paper_start import choose_paper_start
from los_design.synthesis.provenance import law_digest
from los_design.synthesis.round_state import Outcome
from los_design.synthesis.rounds import Effort, design_in_rounds
from los_design.synthesis.start_choice import choose_start
from los_design.synthesis.starts import zero_controller
from los_design.synthesis.store import DESIGN_PACKAGES, continuous, design_ports, matrices_of
from los_design.synthesis.task import ImplementedTask, Task
from los_design.synthesis.unreachable import unreachable_limits
from los_estimator.kalman import sampled_observer
from los_loop.continuous_loop import continuous_open_loop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope

QUICK = SearchOptions(frequencies=250, points=40, ascents=70, iterations=15, patience=1, several=6, confirmed=0.8)
THOROUGH = SearchOptions(frequencies=400, points=60, ascents=150, iterations=30, seed=500, several=6, confirmed=0.8)
EFFORT = Effort(rounds=30, points=30, first=60, iterations=24, target=0.97, searches=(QUICK, THOROUGH))
SHORT_SEARCH = SearchOptions(
    frequencies=150, points=24, ascents=30, iterations=12, patience=1, several=6, confirmed=0.8
)
SHORT_EFFORT = Effort(rounds=8, points=12, first=60, iterations=24, target=0.97, searches=(SHORT_SEARCH,))
NOMINAL_EFFORT = Effort(rounds=1, points=0, first=3000, iterations=0, target=0.0, searches=())
"""Effort of a design of the implemented loop: robust, for trials, and on the nominal model alone."""
FINAL = tuple(replace(THOROUGH, ascents=400, members=256, seed=seed) for seed in (501, 502))
PAPER_EFFORT = Effort(
    rounds=60, points=60, first=150, iterations=60, target=0.0, searches=(QUICK, THOROUGH, *FINAL), ends=True
)
"""Effort of a robust design of the paper's problem, whose largest soft value is minimised. Its peaks are as narrow in
the speeds of the wheels as in frequency: the last searches begin at those of all corners and as many other members."""

STAGES_OF: Mapping[tuple[int, ...], tuple[tuple[int, ...], ...]] = {
    (OBSERVER,): (ALONE,),
    (ACTUATORS,): (BOTH,),
    (OBSERVER, ACTUATORS): (ALONE, BOTH),
}
"""Stages whose requirements count, by the controllers that are tuned."""

Report = Callable[[str], None]


def _silent(text: str) -> None:
    """Report nothing."""


def design_observer(
    telescope: Telescope,
    options: DesignOptions,
    report: Report = _silent,
    job: Job | None = None,
    start: SampledSystem | None = None,
) -> SampledSystem:
    """Tune K_FSM from the Kalman observer, or from a given one.

    Parameters
    ----------
    telescope : Telescope
    options : DesignOptions
    report : callable
        Receives one line for each step.
    job : Job, optional
        As in :func:`los_design.synthesis.rounds.design_in_rounds`.
    start : SampledSystem, optional
        K_FSM of this order or lower that a design of the paper's problem begins with, with its continuous form in the
        provenance.

    Returns
    -------
    SampledSystem
        K_FSM with the washout, ports of :mod:`los_estimator.runtime`; its provenance holds command, commit, parameters
        hash, seed, status, tuned values and the continuous controller.
    """
    _check_start(options, start)
    return _Synthesis(telescope, options, "k-fsm", (OBSERVER,), observer=start).run(report, job)[0]


def design_actuators(
    telescope: Telescope,
    observer: SampledSystem,
    options: DesignOptions,
    report: Report = _silent,
    job: Job | None = None,
    start: SampledSystem | None = None,
) -> SampledSystem:
    """Tune K_PMA with the mirror loop of an observer closed, from random starts or a given one.

    Parameters
    ----------
    telescope : Telescope
    observer : SampledSystem
        K_FSM with its continuous form in the provenance.
    options : DesignOptions
    report : callable
        Receives one line for each step.
    job : Job, optional
        As in :func:`los_design.synthesis.rounds.design_in_rounds`.
    start : SampledSystem, optional
        K_PMA of this order or lower that a design of the paper's problem begins with, with its continuous form in the
        provenance.

    Returns
    -------
    SampledSystem
        K_PMA with the washout, ports of :mod:`fsm_pma_controller.runtime`; provenance as for K_FSM.
    """
    _check_start(options, start)
    return _Synthesis(telescope, options, "k-pma", (ACTUATORS,), observer, law=start).run(report, job)[1]


def design_pair(
    telescope: Telescope,
    options: DesignOptions,
    report: Report = _silent,
    job: Job | None = None,
    workers: Workers | None = None,
    observer: SampledSystem | None = None,
) -> tuple[SampledSystem, SampledSystem]:
    """Tune both controllers together.

    A telescope without proof-mass actuators has the stage of the mirror alone: K_FSM is tuned for it, K_PMA is zero.
    In the paper's problem K_FSM keeps the goals of its own stage: of the many observers with the same largest figure
    this is one behind which K_PMA is good.

    Parameters
    ----------
    telescope : Telescope
    options : DesignOptions
    report : callable
        Receives one line for each step.
    job : Job, optional
        As in :func:`los_design.synthesis.rounds.design_in_rounds`.
    workers : Workers, optional
        Of the searches; default: as many processes as the options say. The result does not depend on them.
    observer : SampledSystem, optional
        K_FSM that a design of the paper's problem begins with; default: the Kalman observer.

    Returns
    -------
    (K_FSM, K_PMA)
        With the same provenance.
    """
    if STAGE_NAMES[BOTH] in telescope.stages:
        return _Synthesis(telescope, options, "all", (OBSERVER, ACTUATORS), observer).run(report, job, workers)
    k_fsm, _ = _Synthesis(telescope, options, "all", (OBSERVER,)).run(report, job, workers)
    made = {key: k_fsm.provenance[key] for key in ("command", "commit", "seed", "loop_delay", "status")}
    return k_fsm, replace(zero_controller("k-pma"), design_basis=k_fsm.design_basis, provenance=made)


def _check_start(options: DesignOptions, start: SampledSystem | None) -> None:
    if start is not None and options.implemented:
        raise InputError("start must be left out with a loop delay, got one")


@dataclass(frozen=True)
class _Synthesis:
    """Design of one or both controllers.

    Parameters
    ----------
    telescope : Telescope
    options : DesignOptions
    command : {"all", "k-fsm", "k-pma"}
        Of ``los-testbed design``, for the provenance.
    tuned : tuple of int
        Which controllers are tuned.
    observer, law : SampledSystem or None
        K_FSM and K_PMA that are given: a start where they are tuned, otherwise they stay as they are.
    """

    telescope: Telescope
    options: DesignOptions
    command: str
    tuned: tuple[int, ...]
    observer: SampledSystem | None = None
    law: SampledSystem | None = None

    def run(
        self, report: Report, job: Job | None, workers: Workers | None = None
    ) -> tuple[SampledSystem, SampledSystem]:
        """Design in rounds, and sample."""
        begin = time.monotonic()
        compared: list[dict[str, Any]] = []
        with Workers(self.options.workers) as started:
            task = self._task(workers or started)
            effort = self._effort(task, report, begin + task.wall_limit)
            task = replace(task, wall_limit=task.wall_limit - (time.monotonic() - begin))
            start = partial(self._start, task, report, compared)
            outcome = design_in_rounds(task, start, effort, report, job)
        common = self._provenance(outcome, compared, time.monotonic() - begin)
        sampled = []
        ports = task.samples.open_loop.ports
        for kind, stage, M in zip(DESIGN_PACKAGES, (ALONE, BOTH), gain_matrices(task.blocks, outcome.x), strict=True):
            A, B, C, D = matrices_of(kind, _in_newton(M, ports) if stage == BOTH else M, ports)
            matrices = {"A": A.tolist(), "B": B.tolist(), "C": C.tolist(), "D": D.tolist()}
            provenance = {**common, **_values(outcome, stage), "continuous": matrices}
            sampled.append(_sampled(kind, (A, B, C, D), self.telescope, self.options, provenance, ports))
        return sampled[0], sampled[1]

    def _effort(self, task: Task, report: Report, deadline: float) -> Effort:
        """Effort of the design: one round where limits are unreachable, which are reported."""
        effort = _effort_of(self.options)
        if not self.options.implemented:  # the largest value is minimised, whatever it is
            return effort
        stages = [STAGE_NAMES[stage] for stage in task.stages]
        if not unreachable_limits(task.samples.open_loop, stages, report, deadline):
            return effort
        report("goes on with one round, for the best controllers that are found for these limits")
        return replace(effort, rounds=1)

    def _start(self, task: Task, report: Report, compared: list[dict[str, Any]]) -> FloatArray:
        """Entries of both gain matrices; `compared` gets the starts of the paper's problem that were compared."""
        if isinstance(task, PaperTask):
            return choose_paper_start(task, self.options, self.observer, self.law, report, compared)
        return choose_start(task, self.telescope, self.options, self.observer, report)

    def _provenance(self, outcome: Outcome, compared: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
        """What both controllers have in their provenance."""
        common = {
            "command": _command(self.command, self.options),
            "commit": ", ".join(outcome.commits),
            "seed": self.options.seed,
            "loop_delay": self.options.loop_delay,
            "status": str(outcome.status),
            "seconds": round(seconds, 1),
            "active_models": outcome.active,
        }
        if compared:
            common["starts"] = compared
        if start := self.observer if OBSERVER in self.tuned else self.law:
            common["start"] = law_digest(start)
        return common

    def _task(self, workers: Workers) -> Task:
        """The task, with no parameter points yet."""
        return self._implemented_task(workers) if self.options.implemented else self._paper_task(workers)

    def _paper_task(self, workers: Workers) -> PaperTask:
        options = self.options
        samples = PaperSamples(continuous_open_loop(self.telescope), options.workers)
        order_of_observer = ORDERS[0] if self.observer is None else continuous(self.observer).order
        orders = (options.order, ORDERS[1]) if self.tuned == (OBSERVER,) else (order_of_observer, options.order)
        fine = not options.nominal
        common = options.seed, options.wall_limit, workers
        return PaperTask(samples, STAGES_OF[self.tuned], self.tuned, *common, orders=orders, fine=fine)

    def _implemented_task(self, workers: Workers) -> ImplementedTask:
        telescope, options, tuned = self.telescope, self.options, self.tuned
        stages, ports = STAGES_OF[tuned], telescope.loop_ports

        def in_newton(both: Sequence[FloatArray]) -> list[FloatArray]:
            return [both[0], _in_newton(both[1], ports)]

        def pair(x: FloatArray) -> tuple[SampledSystem, SampledSystem]:
            k_fsm, k_pma = (
                _sampled(kind, matrices_of(kind, M, ports), telescope, options, None, ports)
                for kind, M in zip(DESIGN_PACKAGES, in_newton(gain_matrices(blocks(telescope, tuned), x)))
            )
            return k_fsm, k_pma

        samples = Samples(OpenLoop(loop_plant(telescope, ports), telescope, ports), options.workers)
        return ImplementedTask(samples, stages, tuned, options.seed, options.wall_limit, workers, sampled=pair)


def _effort_of(options: DesignOptions) -> Effort:
    if options.nominal:
        return NOMINAL_EFFORT
    if not options.implemented:
        return PAPER_EFFORT
    return SHORT_EFFORT if options.short else EFFORT


def _values(outcome: Outcome, stage: tuple[int, ...]) -> dict[str, Any]:
    """Tuned values and worst cases of a stage: that of the mirror alone for K_FSM, of both controllers for K_PMA."""

    def own(name: str) -> bool:
        return name.endswith(ALONE_SUFFIX) == (stage == ALONE)

    tuned = {name.removesuffix(ALONE_SUFFIX): float(f"{v:.6g}") for name, v in outcome.tuned.items() if own(name)}
    worst = [
        {**case, "requirement": case["requirement"].removesuffix(ALONE_SUFFIX)}
        for case in outcome.worst_cases()
        if own(case["requirement"])
    ]
    return {"tuned_values": tuned, "worst_cases": worst}


def _in_newton(M: FloatArray, ports: LoopPorts) -> FloatArray:
    """Gain matrix of K_PMA with its commands in their units."""
    forces = ports.scale[ports.forces]
    size = np.ones(len(M))
    size[-len(forces) :] = forces
    return size[:, None] * M


def _sampled(
    kind: str,
    matrices: Sequence[FloatArray],
    telescope: Telescope,
    options: DesignOptions,
    provenance: Mapping[str, Any] | None,
    ports: LoopPorts,
) -> SampledSystem:
    """Sampled controller with the washout."""
    A, B, C, D = matrices
    system = state_space(A, B, C, D, *design_ports(kind, ports))
    sample = sampled_observer if kind == "k-fsm" else sampled_controller
    name = f"K_{kind[2:].upper()}, {options.variant}"
    washout, basis = telescope.washout, telescope.design_basis
    return sample(system, washout, name=name, basis=basis, provenance=provenance)


def _command(kind: str, options: DesignOptions) -> str:
    flags = (" --nominal" if options.nominal else "") + f" --loop-delay {options.loop_delay:g} --seed {options.seed}"
    if kind == "all":
        flags = " --nominal" if options.nominal else ""
        flags += f" --seed {options.seed}" + (" --effort short" if options.short else "")
    flags += f" --order {options.order}" if options.order != ORDERS[0] else ""
    random = kind == "k-pma" and not options.implemented and options.starts != DesignOptions.starts
    return f"los-testbed design {kind}{flags}" + (f" --starts {options.starts}" if random else "")
