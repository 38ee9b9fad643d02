"""The loop stages side by side: same seed, same disturbance, several telescopes, both parts of the error.

Every metric is computed from the bag of its run. The parts are runs of their own: all, the disturbance alone (no sensor
noise) and the noise alone (no disturbance). In the scenario worst_case each stage has its own worst parameters and
tone, one for each index (:mod:`los_testbed.run.summary.worst_case_rows`).
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.job import Job
from los_loop.tone_model import StageTones, tone_responses
from los_testbed.config.members import MEMBER, check_ranges, random_member, worst_member
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import layered, of_scenario
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import identity
from los_testbed.run.loop.closed_loop import LoopDivergedError
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.metadata import run_metadata
from los_testbed.run.runner import Runner
from los_testbed.run.summary.worst_case_rows import WORST_INDICES, WorstToneRun, worst_tone_of
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import FAILURE, run_end, statistics_of
from pointing_analysis.requirements.summary import Summary, summarise
from titop_plant.interface import SCENARIOS, STAGES

WORST = SCENARIOS[0]

PARTS = {"all": (True, True), "disturbance": (False, True), "noise": (True, False)}
"""Parts of the error: whether there is noise and whether there is a disturbance."""

MOVING = "ramp"

COMPARED = tuple(name for name in SCENARIOS if name not in ("unit_norm", "design", MOVING))
"""Scenarios of a comparison, where none is named."""

PLAN = "plan.json"
"""File in the folder of results that are not finished: what was asked for."""

REPORTED = "fast"
"""Index of the worst-case runs that the report shows side by side."""

METRICS = ("ape_max_arcsec", "ape_quantile_arcsec", "rpe_rms_mas", "rpe_windows_quantile_mas", "mtf_nyquist", "strehl")
"""Of a run; the last two, of its star's image, are those that the required part of the exposures is above."""


@dataclass(frozen=True)
class Plan:
    """Plan of the runs.

    Parameters
    ----------
    base : RunConfig
        Duration, seed, mode, controllers and all that the stages share.
    folder : Path
        New folder for bags and results, or that of the same plan, which is resumed.
    scenarios : tuple of str
    samples : int
        Telescopes: the one of `base`, then random members 1, 2, ... of its family.
    parts : tuple of str
        Keys of :data:`PARTS`.
    keep : bool
        Keep the bags of all runs; otherwise those that the reports show.
    designs : str
        Folder of designs whose worst parameters are run; empty for the stored ones.
    """

    base: RunConfig
    folder: Path
    scenarios: tuple[str, ...] = COMPARED
    samples: int = 3
    parts: tuple[str, ...] = tuple(PARTS)
    keep: bool = False
    designs: str = ""

    def __post_init__(self) -> None:
        # the stage of a configuration, where none was asked for, is one that the telescope may not have
        object.__setattr__(self, "base", replace(self.base, loop=self.stages[-1]))

    def members(self) -> dict[str, RunConfig]:
        """Telescopes by name."""
        configs = {"nominal": self.base}
        for seed in range(1, self.samples):
            member = random_member(seed, self.base.parameters)
            settings = layered(self.base.to_mapping(), member, self._fixed)
            configs[f"sample-{seed}"] = RunConfig.from_mapping(settings)
        return configs

    @property
    def _fixed(self) -> dict[str, Any]:
        """Parameters whose values all members have, as settings."""
        return {"parameter_values": self.base.parameter_values or {}}

    @cached_property
    def stages(self) -> tuple[str, ...]:
        """Stages that the telescope has."""
        return RunParts(self.base).telescope.stages

    @cached_property
    def runs(self) -> list[StageRun]:
        """All runs, in the order of the tables; the noise alone does not depend on the scenario and is run once."""
        runs = []
        for scenario in self.scenarios:
            if scenario == WORST:
                runs += self._worst_runs()
                continue
            first = next(name for name in self.scenarios if name != WORST)
            runs += [
                self._run(scenario, member, loop, part, config)
                for member, config in self.members().items()
                for loop in self.stages
                for part in self.parts
                if part != "noise" or scenario == first
            ]
        return runs

    def _worst_runs(self) -> list[StageRun]:
        """Each stage at its own worst parameters, for each index, with the noise and without."""
        runs = []
        for loop in self.stages:
            for index in WORST_INDICES:
                member = worst_member(loop, index, self.base.parameters, self.designs)
                settings = {name: value for name, value in self.base.to_mapping().items() if name not in MEMBER}
                config = RunConfig.from_mapping(layered({**settings, "worst_of": index}, member, self._fixed))
                runs += [self._run(WORST, index, loop, part, config) for part in ("all", "disturbance")]
        return runs

    def _run(self, scenario: str, member: str, loop: str, part: str, config: RunConfig) -> StageRun:
        noise, disturbance = PARTS[part]
        config = replace(config, scenario=scenario, loop=loop, noise=noise, disturbance=disturbance)
        if scenario != WORST:
            settings = {
                name: value for name, value in config.to_mapping().items() if value is not None or name != "wheel_speed"
            }
            config = RunConfig.from_mapping({**settings, **of_scenario(settings, self.designs)})
        return StageRun(scenario, member, loop, part, config)


@dataclass(frozen=True)
class StageRun:
    """One run of the plan."""

    scenario: str
    member: str
    loop: str
    part: str
    config: RunConfig

    @property
    def reported(self) -> bool:
        """Whether a report shows it: of the first telescope (the worst case of fast tones), both parts of the error."""
        return self.part == "all" and self.member in ("nominal", REPORTED)

    @property
    def name(self) -> str:
        """Folder of its bag."""
        scenario = "any" if self.part == "noise" else self.scenario
        return f"{scenario}-{self.member}-{self.loop}" + ("" if self.part == "all" else f"-{self.part}-alone")


@dataclass(frozen=True)
class StageResult:
    """Metrics of one run.

    Parameters
    ----------
    run : StageRun
    metrics : mapping of str to float
        By :data:`METRICS`; NaN where the loop diverged, or the run is too short for it.
    transient : float
        Seconds of start-up left out.
    tones : tuple of StageTones
        Of runs with the disturbance alone.
    bag : Path or None
        Where it is kept.
    note : str
    worst : WorstToneRun or None
        Of runs of the scenario worst_case with the disturbance alone.
    summary : Summary or None
        All metrics; None where the loop diverged.
    """

    run: StageRun
    metrics: Mapping[str, float]
    transient: float
    tones: tuple[StageTones, ...] = ()
    bag: Path | None = None
    note: str = ""
    worst: WorstToneRun | None = None
    summary: Summary | None = None

    def model(self) -> tuple[FloatArray, FloatArray]:
        """Prediction of the model at the tones: frequencies [rad/s] and rms of the line of sight [rad]."""
        omega = np.array([tone.omega for tone in self.tones])
        return omega, np.array([tone.expected for tone in self.tones]) / np.sqrt(2.0)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        r = self.run
        return {
            "scenario": "any" if r.part == "noise" else r.scenario,
            "telescope": r.member,
            "loop": r.loop,
            "part": r.part,
            **{k: float(f"{v:.5g}") if math.isfinite(v) else None for k, v in self.metrics.items()},
            "transient_s": self.transient,
            "bag": None if self.bag is None else self.bag.name,
            **({"note": self.note} if self.note else {}),
            **({"worst_tone": self.worst.as_dict()} if self.worst else {}),
            **({"requirements": [row.as_dict() for row in self.summary.rows]} if self.summary else {}),
        }


def perform(plan: Plan, progress: Callable[[StageRun, int], None] = lambda run, ticks: None) -> tuple[StageResult, ...]:
    """Run everything.

    Parameters
    ----------
    plan : Plan
    progress : callable
        Called with the run and the ticks it has done.

    Raises
    ------
    ValueError
        A folder of something else, a telescope outside its family, a file that is no controller, several telescopes or
        no ramp in the scenario ramp.
    """
    if MOVING in plan.scenarios and plan.samples > 1:
        raise InputError(f"samples must be 1 in the scenario {MOVING}, got {plan.samples}")
    if MOVING in plan.scenarios:
        for config in plan.members().values():
            RunParts(replace(config, scenario=MOVING)).settings  # noqa: B018, refuses what cannot move
    for run in plan.runs:  # of all telescopes, those of the worst case, too: before there is a folder
        check_ranges(run.config, RunParts(run.config).telescope)
    _begin(plan)
    results = []
    for run in plan.runs:
        bag = plan.folder / run.name
        try:
            note = "" if bag.exists() else _recorded(run, bag, partial(progress, run))
            results.append(replace(evaluate(plan, run, bag), note=note))
        except LoopDivergedError as error:
            results.append(StageResult(run, dict.fromkeys(METRICS, math.nan), 0.0, note=str(error)))
        if not (plan.keep or run.reported):
            shutil.rmtree(bag, ignore_errors=True)
    return tuple(results)


def _begin(plan: Plan) -> None:
    """Begin or continue the job of a plan, and leave of an interrupted one the bags of its finished runs.

    Runs with node processes are repeated: the warnings of their processes are not in the bags. So are runs that
    diverged, whose bags end there.

    Raises
    ------
    ValueError
        A folder of something else.
    """
    runs = plan.runs
    asked = {"identity": identity(plan.base), "runs": {run.name: run.config.to_mapping() for run in runs}}
    Job("comparison", asked, plan.folder / PLAN).begin()
    for bag in (plan.folder / run.name for run in runs):
        if plan.base.mode != "inprocess" or not _finished(bag):
            shutil.rmtree(bag, ignore_errors=True)


def _finished(bag: Path) -> bool:
    """Whether a bag is that of a run that came to its end."""
    try:
        run = Run.open(bag)
    except (ValueError, OSError):
        return False
    return FAILURE not in statistics_of(run.parameters, "plant") and run_end(run.parameters, run.covered_ticks).by_plan


def finish(plan: Plan) -> None:
    """The folder is complete: there is nothing to resume."""
    Job("comparison", {}, plan.folder / PLAN).finish()


def _recorded(run: StageRun, bag: Path, progress: Callable[[int], None]) -> str:
    """One run, whole or not at all; its warnings."""
    try:
        return record(replace(run.config, output=str(bag)), bag, progress)
    except BaseException as error:
        if not isinstance(error, Exception):  # the bag of an interrupted run is one of a shorter run
            shutil.rmtree(bag, ignore_errors=True)
        raise


def record(config: RunConfig, bag: Path, progress: Callable[[int], None]) -> str:
    """One run in the mode of the configuration; its warnings."""
    if config.mode == "inprocess":
        run_in_process(config, bag, progress=progress)
        return ""
    results = Runner(replace(config, wait_for_recorder=True), progress).run()
    if results.interrupted:
        raise KeyboardInterrupt
    return "; ".join([*results.warnings, *results.failures])


def evaluate(plan: Plan, run: StageRun, bag: Path) -> StageResult:
    """Metrics of a recorded run."""
    opened = Run.open(bag)
    summary: Summary = summarise(opened, requirements=None if run.part == "all" else ())
    values = [summary.ape_max, summary.ape_quantile, summary.rpe_rms, summary.rpe_windows_quantile]
    if summary.image is not None:
        values += [summary.image.mtf, summary.image.strehl]
    alone = run.part == "disturbance" and run.scenario != MOVING and not run.config.ramp_duration
    tones = tone_responses(opened, RunParts(run.config).tone_model()) if alone else ()
    kept = bag if plan.keep or run.reported else None
    worst = worst_tone_of(opened, RunParts(run.config)) if alone and run.scenario == WORST else None
    return StageResult(run, dict(zip(METRICS, values)), summary.transient, tones, kept, worst=worst, summary=summary)


def stages_of(results: Sequence[StageResult]) -> tuple[str, ...]:
    """Stages of some results, in their order."""
    loops = {r.run.loop for r in results}
    return tuple(stage for stage in STAGES if stage in loops)


def select(results: Sequence[StageResult], scenario: str, loop: str, part: str) -> dict[str, StageResult]:
    """Results of one cell of the table, by telescope; the noise alone is the same in every scenario."""
    return {
        r.run.member: r
        for r in results
        if r.run.loop == loop and r.run.part == part and (part == "noise" or r.run.scenario == scenario)
    }


def provenance(plan: Plan) -> dict[str, Any]:
    """Origin of the results: software, configuration, controllers."""
    keys = ("software_version", "commit", "python")
    parts = RunParts(plan.base)
    metadata = run_metadata(parts)
    digests = identity(plan.base)
    return {
        **{key: metadata[key] for key in keys},
        "mode": plan.base.mode,
        "duration_s": plan.base.duration,
        "seed": plan.base.seed,
        "camera_rate": plan.base.camera_rate,
        "telescopes": {name: {key: c.to_mapping()[key] for key in MEMBER} for name, c in plan.members().items()},
        "controllers_sha256": {name: digests[name] for name in parts.model_files},
    }
