"""One member of a campaign: its metrics from a simulated run, or from the matrices of its loop.

The run is the one of :func:`los_testbed.loop.simulate.run_in_process`, the same bits without the bag; the metrics are
those that :func:`pointing_analysis.requirements.summary.summarise` reads from that bag. What all members share (the LFT
of the telescope, its parameter file, the controllers) is made once for a process.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.support.threads import one_thread
from los_estimator.runtime import LosEstimator
from los_testbed.campaign.model_depth import ModelDepth, model_metrics
from los_testbed.campaign.sampling import COLUMNS, DELTA, box, settings
from los_testbed.campaign.verdict import INDICES, judged, quantile_column, share_column
from los_testbed.config import RunConfig
from los_testbed.factories import RunParts, assemble_controller
from los_testbed.loop.compiled_loop import Signals
from los_testbed.loop.contract import RunFailedError
from los_testbed.loop.simulate import LoopDivergedError, simulate
from pointing_analysis.indices.errors import default_transient
from pointing_analysis.requirements.text import Requirement
from titop_plant.interface import DT, FORCES, FSM_ANGLE, MIRROR, DesignBasis
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.compilation import kernel

COMMON_METRICS = (
    "ape_max_arcsec",
    "ape_p997_arcsec",
    "rpe_rms_mas",
    "rpe_p997_mas",
    "ake_p997_arcsec",
    "rke_rms_mas",
    "mirror_max_mrad",
    "force_max_n",
    "rpe_window_max_mas",
    "rpe_window_p997_mas",
    "ape_effective",
    "rpe_window_effective",
)
"""Metrics of the bag of the run, whatever is required; of the root mean squares in windows of 20 ms the largest and the
99.7 % quantile; independent samples that instants and windows weigh."""

CRASHED = "crashed"
"""Status of a member that ended its process or for which there was no memory: another machine may do better, so a
resumed campaign computes its part again."""

DEPTHS = ("time", "model")
"""How a member is evaluated: from a simulated run, or from its matrices."""


def metric_columns(depth: str, requirements: Sequence[Requirement]) -> tuple[str, ...]:
    """Columns of metrics of a depth.

    Those of a simulated run are `COMMON_METRICS`, shares of the samples above the limits that a campaign judges, and
    quantiles that the requirements name.
    """
    if depth == "model":
        return model_metrics()
    of_requirements = [f(r) for f in (_share_column, quantile_column) for r in judged(requirements)]
    return tuple(dict.fromkeys((*COMMON_METRICS, *of_requirements)))


def _share_column(requirement: Requirement) -> str:
    return share_column(requirement.index, requirement.limit)


@dataclass(frozen=True)
class MemberEvaluator:
    """Evaluates the members of one campaign.

    Parameters
    ----------
    base : RunConfig
        Settings that all members share.
    family : PlantFamily
    controllers : mapping
        ``k_fsm`` and ``k_pma``.
    telescope : DesignBasis
    requirements : tuple of Requirement
        Of the telescope.
    """

    base: RunConfig
    family: PlantFamily
    controllers: Mapping[str, SampledSystem]
    telescope: DesignBasis
    requirements: tuple[Requirement, ...]

    @classmethod
    def of(cls, base: RunConfig) -> MemberEvaluator:
        """Evaluator of the members that differ from `base` in the uncertain parameters and the seed.

        Raises
        ------
        ValueError
            A file that cannot be read, controllers that cannot be used.
        """
        parts = RunParts(base)
        return cls(base, parts.family, parts.models, parts.basis, parts.requirements)

    def row(self, index: int, values: Mapping[str, Any], depth: str) -> dict[str, Any]:
        """Row of the data set: the member, its metrics, status and hash; a member that fails is a row with its reason.

        Parameters
        ----------
        index : int
            Number of the member.
        values : mapping
            ``seed`` and `COLUMNS`.
        depth : {"time", "model"}
        """
        if depth == "time":
            return self._row(index, values, depth, lambda: self._simulated(replace(self.base, **settings(values))))
        return self._row(index, values, depth, lambda: self._modelled(values))

    def rows(self, members: Sequence[Mapping[str, Any]], depth: str) -> list[dict[str, Any]]:
        """Row of each member, which does not depend on the others.

        Parameters
        ----------
        members : sequence of mappings
            ``index``, ``seed`` and `COLUMNS`.
        depth : {"time", "model"}
        """
        return [self.row(member["index"], member, depth) for member in members]

    def _row(
        self, index: int, values: Mapping[str, Any], depth: str, evaluate: Callable[[], Mapping[str, float]]
    ) -> dict[str, Any]:
        metrics, status, reason = dict.fromkeys(metric_columns(depth, self.requirements), math.nan), "ok", ""
        try:
            with one_thread(), np.errstate(all="ignore"):
                metrics |= evaluate()
            if depth == "model" and not metrics["ape_gain"] < math.inf:
                status, reason = "unstable", "the sampled loop is unstable"
        except LoopDivergedError as error:
            status, reason = "diverged", str(error)
        except RunFailedError as error:
            status, reason = CRASHED if isinstance(error.__cause__, MemoryError) else "failed", str(error)
        except MemoryError as error:
            status, reason = CRASHED, " ".join(str(error).split()) or "no memory"
        except (ValueError, ArithmeticError, LinAlgError) as error:
            status, reason = "failed", " ".join(str(error).split()) or type(error).__name__
        return finished_row(index, values, metrics, status, reason)

    def _simulated(self, config: RunConfig) -> dict[str, float]:
        """Metrics of a simulated run, start-up left out.

        Raises
        ------
        LoopDivergedError
            A signal is no longer finite.
        ValueError
            No start, or a run that is over before its start-up.
        """
        parts = RunParts(config, self.controllers)
        start = parts.start
        first = round((default_transient(config.duration) if start.states is None else 0.0) / DT)
        if first >= config.ticks:
            raise ValueError(f"duration must exceed the start-up of {first * DT:g} s, got {config.duration:g} s")
        rest = np.zeros(self.family.control_loop.order) if start.states is None else start.states.plant
        plant = self.family.build(parts.physical, rest)
        controllers = {name: replace(law) for name, law in self.controllers.items()}  # each with a state of its own
        estimator = LosEstimator(controllers["k_fsm"])
        controller = assemble_controller(controllers, self.telescope, config.loop)
        if start.states is not None:
            estimator.start_at(start.states.k_fsm, start.states.camera)
            controller.start_at(start.states.k_pma)
        estimator.reset()
        controller.reset()
        record = _Record(np.empty((config.ticks, 4)), float(self.family.parameters["fsm"]["los_sensitivity"]))
        kernel()  # of many runs, so that the first one pays for all
        simulate(plant, estimator, controller, config.ticks, record.keep, start.command)
        return record.metrics(first, self.requirements)

    @cached_property
    def _model(self) -> ModelDepth:
        """What the members share at depth model: a few seconds, once for a process."""
        k_fsm, k_pma = self.controllers["k_fsm"], self.controllers["k_pma"]
        return ModelDepth.of(self.family.control_loop, self.family.parameters, k_fsm, k_pma, self.base.loop)

    @cached_property
    def _ranges(self) -> dict[str, tuple[float, float]]:
        return box(self.base.parameters)

    def _modelled(self, row: Mapping[str, Any]) -> dict[str, float]:
        """Metrics of the sampled loop, from its matrices."""
        values = {}
        for column, name in zip(COLUMNS, DELTA):
            value, (low, high) = float(row[column]), self._ranges[column]
            if not low - 1e-9 * (high - low) <= value <= high + 1e-9 * (high - low):
                raise ValueError(f"{column} must be between {low:g} and {high:g}, got {value:g}")
            values[name] = value
        return self._model.metrics(values)


@dataclass
class _Record:
    """Errors of a run, and its largest commands."""

    values: FloatArray
    gain: float
    done: int = 0
    largest: FloatArray = field(default_factory=lambda: np.zeros(2))

    def keep(self, block: Signals, rows: int) -> None:
        """Take a block of ticks."""
        part = self.values[self.done : self.done + rows]
        part[:, :2] = block.truth[:rows]
        part[:, 2:4] = block.los_estimate[:rows] + self.gain * block.measurement[:rows, FSM_ANGLE] - part[:, :2]
        for k, columns in enumerate((MIRROR, FORCES)):
            self.largest[k] = max(self.largest[k], float(np.abs(block.command[:rows, columns]).max()))
        self.done += rows

    def metrics(self, first: int, requirements: Sequence[Requirement]) -> dict[str, float]:
        """Metrics of the rows from `first` on."""
        from pointing_analysis.requirements.summary import Knowledge, Performance

        judged_rows, largest = self.values[first:], self.largest
        samples = _Samples.of(judged_rows[:, :2])
        performance = Performance.of(judged_rows[:, :2], DT)
        knowledge = Knowledge.of(judged_rows[:, 2:4], DT)
        found = dict(
            zip(
                COMMON_METRICS,
                (
                    performance.ape_max,
                    performance.ape_p997,
                    performance.rpe_rms,
                    performance.rpe_p997,
                    knowledge.ake_p997_arcsec,
                    knowledge.rke_rms_mas,
                    1e3 * float(largest[0]),
                    float(largest[1]),
                    *samples.common(performance.rpe_windows_p997),
                ),
            )
        )
        return {**found, **samples.required(requirements)}


@dataclass(frozen=True)
class _Samples:
    """Samples of a simulated run that requirements judge [rad]: the error at each instant, its rms in each window."""

    instants: FloatArray
    windows: FloatArray

    @classmethod
    def of(cls, error: FloatArray) -> _Samples:
        """From the performance error (n, 2) [rad]."""
        from pointing_analysis.indices import metrics
        from pointing_analysis.requirements.summary import WINDOW

        return cls(metrics.radial(error), metrics.radial(np.sqrt(metrics.windows(error, DT, WINDOW).variance)))

    def common(self, window_p997: float) -> tuple[float, ...]:
        """Last of `COMMON_METRICS`."""
        from pointing_analysis.indices.confidence import effective_number
        from pointing_analysis.indices.errors import RAD_PER_MAS

        numbers = effective_number(self.instants), effective_number(self.windows)
        return (float(self.windows.max()) / RAD_PER_MAS, window_p997, *numbers)

    def required(self, requirements: Sequence[Requirement]) -> dict[str, float]:
        """Share above the limit of each requirement that a campaign judges, and quantiles that are no common metric."""
        from pointing_analysis.read.mapped_arrays import SortedValues

        found = {}
        for r in judged(requirements):
            of, scale = {"APE": self.instants, "RPE": self.windows}[r.index], INDICES[r.index][1]
            found[_share_column(r)] = float(np.mean(of >= r.limit))
            if quantile_column(r) not in COMMON_METRICS:
                found[quantile_column(r)] = SortedValues(of / scale).quantile(r.probability)
        return found


def finished_row(
    index: int, values: Mapping[str, Any], metrics: Mapping[str, float], status: str, reason: str
) -> dict[str, Any]:
    """A row with the hash of its content."""
    row: dict[str, Any] = {"index": int(index), "seed": int(values["seed"])}
    row |= {name: float(values[name]) for name in COLUMNS}
    row |= {name: float(value) for name, value in metrics.items()}
    row |= {"status": status, "reason": reason}
    return {**row, "hash": row_hash(row)}


def row_hash(row: Mapping[str, Any]) -> str:
    """Sixteen hexadecimal digits of everything in a row but the hash itself; every bit of a number counts."""
    content = [[name, v.hex() if isinstance(v, float) else v] for name, v in row.items() if name != "hash"]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]
