"""One member of a campaign: its metrics from a simulated run, or from the matrices of its loop.

The run is the one of :func:`los_testbed.loop.simulate.run_in_process`, the same bits without the bag; the metrics are
those that :func:`pointing_analysis.summary.summarise` reads from that bag. What all members share (the LFT of the
telescope, its parameter file, the controllers) is made once for a process.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

from los_estimator.runtime import LosEstimator
from los_testbed.campaign.model_depth import MODEL_METRICS, ModelDepth
from los_testbed.campaign.sampling import COLUMNS, DELTA, box, settings
from los_testbed.campaign.verdict import judged, share_column
from los_testbed.config import RunConfig
from los_testbed.factories import assemble_controller, load_controllers, plant_config, run_start, telescope_basis
from los_testbed.loop.simulate import Block, LoopDivergedError, simulate
from lti import SampledSystem
from lti.threads import one_thread
from titop_plant.interface import DT, FORCES, FSM_ANGLE, MIRROR, DesignBasis
from titop_plant.simulation import PlantFamily

FloatArray = NDArray[np.float64]

TIME_METRICS = (
    "ape_max_arcsec", "ape_p997_arcsec", "rpe_rms_mas", "rpe_p997_mas", "ake_p997_arcsec", "rke_rms_mas",
    "mirror_max_mrad", "force_max_n", "rpe_window_max_mas", "rpe_window_p997_mas", "ape_effective",
    "rpe_window_effective", *(share_column(r.index, r.limit) for r in judged()),
)  # fmt: skip
"""Metrics of the bag of the run; of the root mean squares in windows of 20 ms the largest and the 99.7 % quantile;
independent samples that instants and windows weigh; shares of them above the limits."""

CRASHED = "crashed"
"""Status of a member that ended its process or for which there was no memory: another machine may do better, so a
resumed campaign computes its part again."""

DEPTHS = {"time": TIME_METRICS, "model": MODEL_METRICS}
"""Columns of metrics of a depth."""


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
    """

    base: RunConfig
    family: PlantFamily
    controllers: Mapping[str, SampledSystem]
    telescope: DesignBasis

    @classmethod
    def of(cls, base: RunConfig) -> MemberEvaluator:
        """Evaluator of the members that differ from `base` in the uncertain parameters and the seed.

        Raises
        ------
        ValueError
            A file that cannot be read, controllers that cannot be used.
        """
        with one_thread():
            family = PlantFamily.of(plant_config(base))
        return cls(base, family, load_controllers(base), telescope_basis(base))

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
        metrics, status, reason = dict.fromkeys(DEPTHS[depth], math.nan), "ok", ""
        try:
            with one_thread(), np.errstate(all="ignore"):
                if depth == "time":
                    metrics |= self._simulated(replace(self.base, **settings(values)))
                else:
                    metrics |= self._modelled(values)
            if depth == "model" and not metrics["ape_gain"] < math.inf:
                status, reason = "unstable", "the sampled loop is unstable"
        except LoopDivergedError as error:
            status, reason = "diverged", str(error)
        except MemoryError as error:
            status, reason = CRASHED, " ".join(str(error).split()) or "no memory"
        except (ValueError, ArithmeticError, LinAlgError) as error:
            status, reason = "failed", " ".join(str(error).split()) or type(error).__name__
        return finished_row(index, values, metrics, status, reason)

    def _simulated(self, config: RunConfig) -> dict[str, float]:
        """Metrics of the simulated run, start-up left out."""
        from pointing_analysis.errors import default_transient
        from pointing_analysis.summary import Knowledge, Performance

        start = run_start(config, self.controllers)
        states = start.states
        rest = np.zeros(self.family.control_loop.order)
        plant = self.family.build(plant_config(config, start), rest if states is None else states.plant)
        estimator = LosEstimator(self.controllers["k_fsm"])
        controller = assemble_controller(self.controllers, self.telescope, config.loop)
        if states is not None:
            estimator.start_at(states.k_fsm, states.camera)
            controller.start_at(states.k_pma)
        estimator.reset()
        controller.reset()
        record, done = np.empty((config.ticks, 4)), 0
        largest = np.zeros(2)
        gain = float(self.family.parameters["fsm"]["los_sensitivity"])

        def keep(block: Block, rows: int) -> None:
            nonlocal done
            part = record[done : done + rows]
            part[:, :2] = block.truth[:rows]
            part[:, 2:4] = block.los_estimate[:rows] + gain * block.measurement[:rows, FSM_ANGLE] - part[:, :2]
            for k, columns in enumerate((MIRROR, FORCES)):
                largest[k] = max(largest[k], float(np.abs(block.command[:rows, columns]).max()))
            done += rows

        simulate(plant, estimator, controller, config.ticks, keep, start.command)
        first = round((default_transient(config.duration) if states is None else 0.0) / DT)
        if first >= config.ticks:
            raise ValueError(f"duration must exceed the start-up of {first * DT:g} s, got {config.duration:g} s")
        performance = Performance.of(record[first:, :2], DT)
        knowledge = Knowledge.of(record[first:, 2:4], DT)
        return dict(zip(TIME_METRICS, (
            performance.ape_max, performance.ape_p997, performance.rpe_rms, performance.rpe_p997,
            knowledge.ake_p997_arcsec, knowledge.rke_rms_mas, 1e3 * float(largest[0]), float(largest[1]),
            *_samples(record[first:, :2], performance.rpe_windows_p997),
        )))  # fmt: skip

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


def _samples(error: FloatArray, window_p997: float) -> tuple[float, ...]:
    """Last columns of a simulated run, from its performance error (n, 2) [rad]."""
    from pointing_analysis import metrics
    from pointing_analysis.confidence import effective_number
    from pointing_analysis.errors import RAD_PER_MAS
    from pointing_analysis.summary import WINDOW

    instants = metrics.radial(error)
    windows = metrics.radial(np.sqrt(metrics.windows(error, DT, WINDOW).variance))
    of = {"APE": instants, "RPE": windows}
    return (
        float(windows.max()) / RAD_PER_MAS,
        window_p997,
        effective_number(instants),
        effective_number(windows),
        *(float(np.mean(of[r.index] >= r.limit)) for r in judged()),
    )


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
