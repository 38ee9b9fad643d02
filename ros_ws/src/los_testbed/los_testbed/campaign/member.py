"""One member of a campaign: its metrics from a simulated run, or from the matrices of its loop.

The run is bit-identical to :func:`los_testbed.run.loop.simulate.run_in_process`, without the bag; the metrics
are those that :func:`pointing_analysis.requirements.summary.summarise` reads from that bag. What all members share (the
LFT of the telescope, its parameter file, the controllers) is made once for a process.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from los_loop.member_metrics import MemberMetrics, metric_names
from los_testbed.campaign.campaign_verdict import judged, refused
from los_testbed.campaign.meanings import RequirementColumns
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.closed_loop import LoopDivergedError, SimulatedLoop
from los_testbed.run.loop.compiled_loop import Signals
from los_testbed.run.loop.contract import RunFailedError
from los_testbed.run.loop.source_alone import errors_of_source
from pointing_analysis.image.optics import Optics
from pointing_analysis.indices.errors import ErrorSeries, default_transient
from pointing_analysis.read import mapped_arrays
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, parts
from pointing_analysis.requirements.exposure import USUAL, exposure_of
from pointing_analysis.requirements.requirement import Requirement, parse, time_text
from pointing_analysis.requirements.summary import Knowledge, Performance
from pointing_analysis.requirements.verdict import IndexSamples, beyond_limit, run_samples
from titop_plant.interface import DT, FORCES, FSM_ANGLE, MIRROR
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
)
"""Metrics of the bag of the run, whatever is required; of the root mean squares in windows the largest and the 99.7 %
quantile."""

CRASHED = "crashed"
"""Status of a member that ended its process or lacked memory: another machine may succeed, so a resumed campaign
computes its chunk again."""

ALL_FORCES = slice(FORCES.start, None)
"""Columns of all commands but those of the mirror."""

DEPTHS = ("time", "model")
"""Evaluation of a member: from a simulated run, or from its matrices."""


def source_columns(source: str) -> tuple[str, str]:
    """Columns of a source of disturbance: absolute and relative error that it makes alone.

    Examples
    --------
    >>> source_columns("cooler 1")
    ('source_cooler_1_ape_p997_arcsec', 'source_cooler_1_rpe_rms_mas')
    """
    stem = f"source_{re.sub(r'[^0-9A-Za-z]+', '_', source)}"
    return f"{stem}_ape_p997_arcsec", f"{stem}_rpe_rms_mas"


def always(exposure: float) -> tuple[Requirement, Requirement]:
    """Requirements whose columns are `COMMON_METRICS`, if they depend on no limit; in windows of an exposure [s]."""
    ape, rpe = (
        parse(f"prob({quantity} < 1 arcsec) >= 99.7 % at 95 % confidence")
        for quantity in ("|APE|", f"rms RPE({time_text(exposure)})")
    )
    return ape, replace(rpe, times=(exposure,))


def metric_columns(
    depth: str, requirements: Sequence[Requirement], sources: Sequence[str] = (), exposure: float = USUAL
) -> tuple[str, ...]:
    """Columns of metrics of a depth, of a telescope with an exposure [s].

    Those of a simulated run are `COMMON_METRICS`, then of each requirement share of the samples beyond its limit,
    quantile, worst value and effective samples (:class:`los_testbed.campaign.meanings.RequirementColumns`); two
    requirements that differ in their limits alone share what does not depend on it. Behind them are those of each
    source of disturbance that the telescope's parameter file names (:func:`source_columns`).
    """
    if depth == "model":
        return metric_names()
    of_requirements = zip(*(RequirementColumns.of(r, exposure).names for r in judged(requirements)))
    of_sources = (name for source in sources for name in source_columns(source))
    return tuple(dict.fromkeys((*COMMON_METRICS, *(name for kind in of_requirements for name in kind), *of_sources)))


def unformed(parts: RunParts) -> dict[Requirement, str]:
    """Requirements of the telescope of a campaign that the simulated run of a member cannot be judged by, and why.

    Raises
    ------
    ValueError
        The parameter file cannot be read; with requirements on the image also: its optics make none.
    """
    config, requirements = parts.config, parts.telescope.requirements
    left_out = default_transient(config.duration) if config.start == "rest" or parts.sources else 0.0
    return refused(requirements, max(config.ticks - round(left_out / DT), 0), _image_optics(parts))


def _image_optics(parts: RunParts) -> Optics | None:
    """Optics of the telescope, where a requirement needs them."""
    return parts.optics if any(r.of_image for r in parts.telescope.requirements) else None


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
    requirements : tuple of Requirement
        Of the telescope, those that a member's run can be judged by.
    optics : Optics, optional
        Of the telescope, for requirements on the image of a star.
    sources : tuple of str
        Names of the sources of disturbance of the parameter file, which act in each member.
    exposure : float
        Window of the relative error [s] (:mod:`pointing_analysis.requirements.exposure`).
    """

    base: RunConfig
    family: PlantFamily
    controllers: Mapping[str, SampledSystem]
    requirements: tuple[Requirement, ...]
    optics: Optics | None = None
    sources: tuple[str, ...] = ()
    exposure: float = USUAL

    @classmethod
    def of(cls, base: RunConfig) -> MemberEvaluator:
        """Evaluator of the members that differ from `base` in the uncertain parameters and the seed.

        Raises
        ------
        ValueError
            A file that cannot be read, controllers that cannot be used.
        """
        parts = RunParts(base)
        known = unformed(parts)
        requirements = tuple(r for r in parts.telescope.requirements if r not in known)
        names = tuple(source.name for source in parts.sources)
        optics, exposure = _image_optics(parts), exposure_of(parts.telescope.requirements)
        return cls(base, parts.family, parts.models, requirements, optics, names, exposure)

    def row(self, index: int, values: Mapping[str, Any], depth: str) -> dict[str, Any]:
        """Row of the data set: the member, its metrics, status and hash; a member that fails is a row with its reason.

        Parameters
        ----------
        index : int
            Number of the member.
        values : mapping
            ``seed`` and the columns of :class:`~los_testbed.campaign.sampling.MemberParameters`.
        depth : {"time", "model"}
        """
        if depth == "time":
            settings = self._parameters.settings(values)
            return self._row(index, values, depth, lambda: self._simulated(replace(self.base, **settings)))
        return self._row(index, values, depth, lambda: self._modelled(values))

    def rows(self, members: Sequence[Mapping[str, Any]], depth: str) -> list[dict[str, Any]]:
        """Row of each member, which does not depend on the others.

        Parameters
        ----------
        members : sequence of mappings
            ``index``, ``seed`` and the columns of :class:`~los_testbed.campaign.sampling.MemberParameters`.
        depth : {"time", "model"}
        """
        return [self.row(member["index"], member, depth) for member in members]

    def _row(
        self,
        index: int,
        values: Mapping[str, Any],
        depth: str,
        evaluate: Callable[[], tuple[Mapping[str, float], bool]],
    ) -> dict[str, Any]:
        metrics, status, reason = dict.fromkeys(self._columns(depth), math.nan), "ok", ""
        try:
            with one_thread(), np.errstate(all="ignore"):
                evaluated, unstable = evaluate()
            metrics |= evaluated
            if unstable:
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

    def _columns(self, depth: str) -> tuple[str, ...]:
        return metric_columns(depth, self.requirements, self.sources, self.exposure)

    def _simulated(self, config: RunConfig) -> tuple[dict[str, float], bool]:
        """Metrics of a simulated run, start-up left out, and whether its loop is known to be unstable.

        Raises
        ------
        LoopDivergedError
            A signal is no longer finite.
        ValueError
            No start, or a run that is over before its start-up.
        """
        laws = {name: replace(law) for name, law in self.controllers.items()}  # each with a state of its own
        parts = RunParts(config, laws, known_family=self.family)
        unsteady = parts.start.states is None or bool(parts.sources)
        first = round((default_transient(config.duration) if unsteady else 0.0) / DT)
        if first >= config.ticks:
            raise InputError(f"duration must exceed the start-up of {first * DT:g} s, got {config.duration:g} s")
        record = _Record(mapped_arrays.empty((config.ticks, 4)), float(self.family.telescope.fsm.los_sensitivity))
        kernel()  # of many runs, so that the first one pays for all
        SimulatedLoop.of(parts, recorded=False).run(config.ticks, record.keep)
        metrics = record.metrics(first, self.requirements, self.exposure, self.optics) | self._of_sources(parts)
        return metrics, parts.start.unstable

    def _of_sources(self, parts: RunParts) -> dict[str, float]:
        """Errors of each source of disturbance alone in a member."""
        columns: dict[str, float] = {}
        for index, name in enumerate(self.sources):
            alone = Performance.of(errors_of_source(parts, index, parts.config.ticks), DT, self.exposure)
            columns |= dict(zip(source_columns(name), (alone.ape_quantile, alone.rpe_rms)))
        return columns

    @cached_property
    def _model(self) -> MemberMetrics:
        """Shared data of the members at depth model: computed once per process in a few seconds."""
        pair = self.controllers["k_fsm"], self.controllers["k_pma"]
        telescope = RunParts(self.base, known_family=self.family).sampled_telescope
        return MemberMetrics.of(telescope, *pair, self.base.loop)

    @cached_property
    def _parameters(self) -> MemberParameters:
        return MemberParameters.of(self.base.parameters, self.base.parameter_values)

    def _modelled(self, row: Mapping[str, Any]) -> tuple[dict[str, float], bool]:
        """Metrics of the sampled loop, from its matrices, and whether it is unstable."""
        metrics = self._model.metrics(self._parameters.checked(row))
        return metrics, not metrics["ape_gain"] < math.inf


@dataclass
class _Record:
    """Errors of a run, and its largest commands; those of a long run are in a file, so that the memory is bounded."""

    values: FloatArray
    gain: float
    done: int = 0
    largest: FloatArray = field(default_factory=lambda: np.zeros(2))

    def keep(self, block: Signals, rows: int) -> None:
        """Append a block of ticks."""
        part = self.values[self.done : self.done + rows]
        part[:, :2] = block.truth[:rows]
        part[:, 2:4] = block.los_estimate[:rows] + self.gain * block.measurement[:rows, FSM_ANGLE] - part[:, :2]
        for k, columns in enumerate((MIRROR, ALL_FORCES)):
            self.largest[k] = max(self.largest[k], float(np.abs(block.command[:rows, columns]).max()))
        done, self.done = self.done, self.done + rows
        if done // mapped_arrays.PART != self.done // mapped_arrays.PART:
            mapped_arrays.release()

    def metrics(
        self, first: int, requirements: Sequence[Requirement], exposure: float, optics: Optics | None = None
    ) -> dict[str, float]:
        """Metrics of the rows from `first` on, in windows of an exposure [s]; `optics` for the image of a star."""
        errors, largest = self.values[first:], self.largest
        samples = _Samples(_series(errors[:, :2], first), _series(errors[:, 2:4], first), exposure, optics)
        performance = Performance.of(samples.performance.values, DT, exposure)
        knowledge = Knowledge.of(samples.knowledge.values, DT, exposure)
        usual = [samples.metrics(r) for r in always(exposure)]
        values = {
            "ape_max_arcsec": performance.ape_max,
            "ape_p997_arcsec": performance.ape_quantile,
            "rpe_rms_mas": performance.rpe_rms,
            "rpe_p997_mas": performance.rpe_quantile,
            "ake_p997_arcsec": knowledge.ake_quantile_arcsec,
            "rke_rms_mas": knowledge.rke_rms_mas,
            "mirror_max_mrad": 1e3 * float(largest[0]),
            "force_max_n": float(largest[1]),
            **{name: value for one in usual for name, value in one.items() if name in COMMON_METRICS},
        }
        for requirement in judged(requirements):
            # a loop that is not stable starts at rest: what is left without its start-up may be too short for an index
            with contextlib.suppress(ValueError):
                values |= samples.metrics(requirement)
        return values


def _series(error: FloatArray, first: int) -> ErrorSeries:
    """An error (n, 2) [rad] from a tick on."""
    missing = sum(int(np.isnan(error[part]).any(axis=1).sum()) for part in parts(len(error)))
    return ErrorSeries(error, DT, first * DT, missing)


@dataclass(frozen=True)
class _Samples:
    """Samples of the indices of a simulated run, those of each index made once."""

    performance: ErrorSeries
    knowledge: ErrorSeries
    exposure: float
    optics: Optics | None
    _made: dict[Requirement, IndexSamples] = field(default_factory=dict)

    def of(self, requirement: Requirement) -> IndexSamples:
        """Samples by which a recording of this run would be judged; ValueError: the index cannot be formed."""
        r = requirement
        index = Requirement(r.index, r.axis, r.times, 1.0, "", 0.5, 0.5, of_windows=r.of_windows, frequency=r.frequency)
        if index not in self._made:
            error = self.knowledge if index.index in ("AKE", "MKE", "RKE") else self.performance
            self._made[index] = run_samples(error, index, self.optics)
        return self._made[index]

    def metrics(self, requirement: Requirement) -> dict[str, float]:
        """Columns of a requirement; ValueError: the index cannot be formed."""
        named, samples = RequirementColumns.of(requirement, self.exposure), self.of(requirement)
        sign = -1.0 if named.lower else 1.0  # of lower limits the smallest is the worst
        values = samples.values
        ordered = SortedValues(by_parts(lambda rows: sign * rows / named.scale, values))
        above = sum(np.count_nonzero(beyond_limit(values[part], requirement)) for part in parts(len(values)))
        total, effective = len(values) + samples.missing, samples.effective(requirement)
        return {
            named.share: float((above + samples.missing) / total),
            named.quantile: sign * ordered.quantile(requirement.probability),
            named.worst: sign * float(ordered.at(ordered.size - 1)[0]),
            named.effective: effective.number,
            named.unseen: effective.unseen / total,
        }


def finished_row(
    index: int, values: Mapping[str, Any], metrics: Mapping[str, float], status: str, reason: str
) -> dict[str, Any]:
    """A row with the hash of its content."""
    row: dict[str, Any] = {"index": int(index), "seed": int(values["seed"])}
    row |= {name: float(value) for name, value in values.items() if name not in row}
    row |= {name: float(value) for name, value in metrics.items()}
    row |= {"status": status, "reason": reason}
    return {**row, "hash": row_hash(row)}


def row_hash(row: Mapping[str, Any]) -> str:
    """Sixteen hexadecimal digits of everything in a row but the hash itself; every bit of a number counts."""
    content = [[name, v.hex() if isinstance(v, float) else v] for name, v in row.items() if name != "hash"]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]
