"""The metrics of a run: what the command line prints and the report begins with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.formatting.number_text import digits, number, percent, with_unit
from pointing_analysis.image.optics import optics_of
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import (
    RAD_PER_ARCSEC,
    RAD_PER_MAS,
    SETTLING,
    ErrorSeries,
    knowledge_error,
    on_camera,
    performance_error,
)
from pointing_analysis.indices.motion import read_motion
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts
from pointing_analysis.read.mcap.bag_loss import TopicLoss
from pointing_analysis.read.mcap.records import BagError, RefutedBagError
from pointing_analysis.read.recorded_sensors import RecordedSensor, read_sensors
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run_end import missed_share, statistics_of
from pointing_analysis.read.series import SAMPLING
from pointing_analysis.requirements.conditions import UNKNOWN_CONDITIONS, Conditions, conditions_of
from pointing_analysis.requirements.exposure import (
    USUAL_PROBABILITY,
    Probabilities,
    exposure_of,
    finest,
    probabilities_of,
    quantile_key,
)
from pointing_analysis.requirements.guarantee import NO_PROOF
from pointing_analysis.requirements.image_summary import ImageSummary, StarExposures
from pointing_analysis.requirements.recording_state import recording_state
from pointing_analysis.requirements.requirement import time_text
from pointing_analysis.requirements.rows import (
    Beside,
    RequirementRow,
    overall,
    rows_of,
)
from pointing_analysis.requirements.settling import judge_settled
from pointing_analysis.requirements.verdict import Requirement, Verdict, from_entries, judge
from pointing_analysis.spectra.record_lines import unnamed_lines
from pointing_analysis.spectra.sidebands import FoundLine
from pointing_analysis.spectra.spectra import highest_frequency, lines
from pointing_analysis.spectra.tone_budget import ToneBudget, named_tones, tone_budget

METADATA = "requirements"
"""Key of the requirements in the metadata of a bag: a list of entries with name, text and loop."""
UNKNOWN = "no requirements are known for this recording: metrics have no limit (give --requirements FILE)"
USUAL_PROBABILITIES = Probabilities()


@dataclass(frozen=True)
class Knowledge:
    """Knowledge errors of the observer: quantile of the AKE [arcsec] and rms of the RKE [mas]."""

    ake_quantile_arcsec: float
    rke_rms_mas: float

    @classmethod
    def of(cls, error: FloatArray, dt: float, window: float, part: float = USUAL_PROBABILITY) -> Knowledge:
        """Of a knowledge error (n, 2) [rad] with the sampling period `dt` [s], in windows [s]; the quantile of `part`.

        Raises
        ------
        ValueError
            Shorter than a window.
        """
        ake = SortedValues(metrics.radial(error)).quantile(part) / RAD_PER_ARCSEC
        rke = float(np.hypot(*metrics.rpe_rms(error, dt, window))) / RAD_PER_MAS
        return cls(float(ake), rke)


@dataclass(frozen=True)
class Performance:
    """Metrics of a performance error, as in :class:`Summary`; NaN for what needs a window and has none."""

    ape_max: float
    ape_quantile: float
    rpe_rms: float
    rpe_quantile: float
    rpe_axis: tuple[float, float]
    windows: int
    windows_skipped: int
    rpe_windows_quantile: float

    @classmethod
    def of(cls, error: FloatArray, dt: float, window: float, parts: Probabilities = USUAL_PROBABILITIES) -> Performance:
        """Of an error (n, 2) [rad], NaN where a sample is missing, with the period `dt` [s], in windows [s]."""
        ape = SortedValues(by_parts(lambda e: metrics.radial(e) / RAD_PER_ARCSEC, error))
        nan = float("nan")
        rms: FloatArray = np.full(2, nan)
        of_instants, of_windows, cut, skipped = nan, nan, 0, 0
        if metrics.holds(window, dt) and dt * len(error) >= window:
            w = metrics.windows(error, dt, window)
            rms, cut, skipped = w.rpe_rms / RAD_PER_MAS, len(w.mean), w.skipped
            instant = metrics.rpe_instant(error, dt, window)
            radial = by_parts(lambda e: metrics.radial(e) / RAD_PER_MAS, instant)
            of_instants = SortedValues(radial).quantile(parts.rpe)
            sizes = metrics.radial(np.sqrt(w.variance)) / RAD_PER_MAS
            of_windows = SortedValues(sizes).quantile(parts.windows)
        return cls(
            float(ape.at(ape.size - 1)[0]) if ape.size else nan,
            ape.quantile(parts.ape) if ape.size else nan,
            float(np.hypot(*rms)),
            of_instants,
            (float(rms[0]), float(rms[1])),
            cut,
            skipped,
            of_windows,
        )


@dataclass(frozen=True)
class Figure:
    """A metric that no requirement asks for: name, value, unit, and the `RequirementRow.quantity` that is the same."""

    name: str
    value: float
    unit: str
    quantity: str = ""

    @property
    def text(self) -> str:
        """Value with its unit; an infinite one is a radius that the light is not within."""
        return "beyond the image" if math.isinf(self.value) else with_unit(digits(self.value), self.unit)


@dataclass(frozen=True)
class Summary:
    """Metrics of one run.

    Attributes
    ----------
    path, loop, mode, scenario : which run (`scenario_of`)
    ticks : samples of the truth topic that are there or should be
    duration : length of the recording [s]
    transient : seconds dropped at the start
    ape_max, ape_quantile : radial APE, largest and quantile [arcsec]
    probabilities : parts that the quantiles hold for
    window : of the relative error and of a star's exposure [s] (:mod:`pointing_analysis.requirements.exposure`)
    rpe_rms : radial RPE rms of disjoint windows, window estimator [mas]
    rpe_quantile : quantile of the radial RPE, over every instant of disjoint windows [mas]
    rpe_axis : RPE rms per axis [mas]
    windows, windows_skipped : complete windows, and those left out because a sample is missing
    samples_lost : samples missing in the bag, all topics
    lost_by_topic : the same by topic, where there are any
    camera_dropped : camera frames that are NaN
    knowledge : knowledge errors, None without an estimate in the bag
    verdicts : one per requirement
    problems : defects of the bag, one sentence each
    losses : messages that were recorded and cannot be read, by topic
    contradictions : where the bag contradicts its own digests, one sentence each; in `problems` as well
    rpe_windows_quantile : quantile of the rms in disjoint windows, both axes [mas]
    requirements_known : whether requirements were given or recorded, though none may apply to the loop stage
    open_end : whether the recording is truncated and the number of missing samples at its end is unknown
    budget : noise, slow tones, fast tones and total of the RPE; None for a run shorter than a window, or with
        tones that move
    sensors : as the recording describes them
    found : lines that the recording does not name, those of the budget if there is one
    star : exposures of a star, a window each; None where no optics are known
    kind : of the recording: ``bag``, ``CSV``, ``arrays`` ...
    sampling : of a recording of others its rate, where that is from, and the jitter of its times
    beside : of each verdict what else is known of it
    conditions : what acted, and on which telescope
    """

    path: Path
    loop: str
    mode: str
    scenario: str
    ticks: int
    duration: float
    transient: float
    window: float
    ape_max: float
    ape_quantile: float
    rpe_rms: float
    rpe_quantile: float
    rpe_axis: tuple[float, float]
    windows: int
    windows_skipped: int
    samples_lost: int
    lost_by_topic: dict[str, int]
    camera_dropped: int
    knowledge: Knowledge | None
    verdicts: tuple[Verdict, ...]
    problems: tuple[str, ...]
    losses: tuple[TopicLoss, ...] = ()
    contradictions: tuple[str, ...] = ()
    budget: ToneBudget | None = None
    found: tuple[FoundLine, ...] = ()
    rpe_windows_quantile: float = math.nan
    probabilities: Probabilities = USUAL_PROBABILITIES
    requirements_known: bool = True
    open_end: bool = False
    sensors: tuple[RecordedSensor, ...] = ()
    star: StarExposures | None = None
    kind: str = "bag"
    sampling: str = ""
    beside: tuple[Beside, ...] = ()
    conditions: Conditions = UNKNOWN_CONDITIONS

    @property
    def rows(self) -> tuple[RequirementRow, ...]:
        """Row of the table of requirements for each verdict."""
        return tuple(rows_of(self.verdicts, self.beside))

    @property
    def overall(self) -> str:
        """One word for all verdicts."""
        return overall(self.verdicts, self.beside[0].disturbed if self.beside else "")

    @property
    def image(self) -> ImageSummary | None:
        """Figures of the star's image, computed when they are asked for first; None where no optics are known."""
        return None if self.star is None else self.star.figures

    @property
    def figures(self) -> tuple[Figure, ...]:
        """Metrics that need no requirement; those that need a window only where there is one."""
        window, parts = time_text(self.window), self.probabilities
        ape, rpe, windows = (percent(part, 10) for part in (parts.ape, parts.rpe, parts.windows))
        figures = (
            Figure("APE max", self.ape_max, "arcsec"),
            Figure(f"APE {ape}", self.ape_quantile, "arcsec", f"|APE|, {ape}"),
            Figure(f"RPE rms, {window} windows", self.rpe_rms, "mas"),
            Figure(f"RPE of a window, {windows}", self.rpe_windows_quantile, "mas", f"rms RPE({window}), {windows}"),
            Figure(f"RPE at every instant, {rpe}", self.rpe_quantile, "mas", f"|RPE({window})|, {rpe}"),
            *(() if self.image is None else (Figure(*row) for row in self.image.rows)),
        )
        return tuple(figure for figure in figures if not math.isnan(figure.value))

    def lost_text(self, lost: int | None = None) -> str:
        """Number of lost samples in words: for a truncated recording only a part of them is known.

        Parameters
        ----------
        lost : int, optional
            Those that are known; default: :attr:`samples_lost`.
        """
        known = self.samples_lost if lost is None else lost
        if not self.open_end:
            return str(known)
        return f"at least {known}" if known else "unknown"

    def as_dict(self) -> dict[str, Any]:
        """Metrics for JSON; infinities and NaN become None."""
        parts = self.probabilities
        return {
            "bag": str(self.path),
            "kind": self.kind,
            **({"sampling": self.sampling} if self.sampling else {}),
            "mode": self.mode,
            "loop": self.loop,
            "scenario": self.scenario,
            **({"acting": list(self.conditions.acting)} if self.conditions.acting else {}),
            **({"member": self.conditions.member} if self.conditions.member else {}),
            "ticks": self.ticks,
            "transient_s": self.transient,
            "ape_arcsec": {"max": number(self.ape_max), quantile_key(parts.ape): number(self.ape_quantile)},
            "window_s": self.window,
            "rpe_mas": {
                "rms": number(self.rpe_rms),
                quantile_key(parts.rpe): number(self.rpe_quantile),
                f"windows_{quantile_key(parts.windows)}": number(self.rpe_windows_quantile),
            },
            "windows": self.windows,
            "windows_skipped": self.windows_skipped,
            "samples_lost": self.samples_lost,
            "cut_off": self.open_end,
            "camera_dropped": self.camera_dropped,
            "knowledge": None
            if self.knowledge is None
            else {
                f"ake_{quantile_key(parts.knowledge)}_arcsec": number(self.knowledge.ake_quantile_arcsec),
                "rke_rms_mas": number(self.knowledge.rke_rms_mas),
            },
            "requirements_known": self.requirements_known,
            "requirements": [row.as_dict() for row in self.rows],
            "lost_messages": {
                loss.topic: {"messages": loss.missing, "places": [str(span) for span in loss.spans[:100]]}
                for loss in self.losses
            },
            "budget_rpe_mas": None if self.budget is None else self.budget.as_dict(),
            "problems": list(self.problems),
            "contradictions": list(self.contradictions),
            **({} if self.image is None else {"image": self.image.as_dict(number)}),
            **({"sensors": [sensor.to_mapping() for sensor in self.sensors]} if self.sensors else {}),
        }


def requirements_of(run: Recording) -> tuple[Requirement, ...] | None:
    """Requirements that a recording holds (`METADATA`); None where it holds none, or none that can be read."""
    return _recorded(run)[0]


def exposure_of_run(run: Recording) -> float:
    """Window [s] of the figures of a recording by its own requirements."""
    return exposure_of(requirements_of(run) or ())


def _recorded(run: Recording) -> tuple[tuple[Requirement, ...] | None, str]:
    """`requirements_of`, and what is wrong with them."""
    entries = run.parameters.get(METADATA)
    if entries is None:
        return None, ""
    try:
        if not isinstance(entries, list):
            raise InputError(f"{METADATA} must be a list, got {type(entries).__name__}")
        return from_entries(entries, METADATA), ""
    except InputError as error:
        return None, f"the requirements of the recording cannot be read: {error}"


def applicable(requirements: Sequence[Requirement], run: Recording) -> tuple[Requirement, ...]:
    """Requirements that apply to the loop stage of a run (all, if the bag does not name it)."""
    loop = run.parameters.get("loop")
    return tuple(r for r in requirements if not r.loops or loop is None or loop in r.loops)


def beside_of(run: Recording, requirement: Requirement) -> Beside:
    """Results of a requirement besides its samples: missed ticks; of a loop that is named, that nothing is proven."""
    return Beside(disturbed=_disturbed(run), unproven=NO_PROOF if "loop" in run.parameters else "")


def _disturbed(run: Recording) -> str:
    """Ticks that were missed in real time, where they were more than the run permits; empty elsewhere."""
    if run.parameters.get("mode") != "realtime":
        return ""
    try:
        share = missed_share(statistics_of(run.parameters, "plant"))
        most = float(run.parameters.get("max_missed", math.inf))
    except (TypeError, ValueError):
        return "it cannot be read whether too many ticks were missed"
    return f"{share:.3g} % of the ticks were missed" if share > most else ""


def _knowledge(run: Recording, transient: float | None, window: float, part: float) -> tuple[Knowledge | None, str]:
    """Knowledge errors of a recording with estimates, or why they cannot be computed."""
    if "los_estimate" not in run:
        return None, ""
    try:
        series = knowledge_error(run, transient)
        return Knowledge.of(series.values, series.dt, window, part), ""
    except InputError as error:
        return None, f"no AKE and RKE: {str(error).replace(str(run.path), run.path.name)}"


def summarise(
    run: Recording,
    *,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
) -> Summary:
    """Metrics and verdicts of one run.

    Parameters
    ----------
    run : an opened bag
    transient : seconds to drop at the start; by default the bag's ``transient_s``, else 5 s,
        from runs shorter than 10 s their first half (:func:`pointing_analysis.indices.errors.default_transient`)
    requirements : by default those of the recording (`requirements_of`)

    Raises
    ------
    BagError
        No truth topic, only transient, or a time axis that is not uniform: there is no verdict to give. A
        `RefutedBagError` where the bag contradicts its own digests.
    """
    known, damaged = (requirements, "") if requirements is not None else _recorded(run)
    try:
        series = performance_error(run, transient)
    except BagError as refusal:
        if run.contradictions:
            raise RefutedBagError(f"{refusal}; the bag contradicts its own digests: {run.contradictions[0]}") from None
        raise
    asked = applicable(known or (), run)
    window = exposure_of(known or (), requirements_of(run) or ())  # of all stages: their summaries are compared
    parts = probabilities_of(known or requirements_of(run) or ())
    error = Performance.of(series.values, series.dt, window, parts)
    motion, unread = read_motion(run)
    budget: ToneBudget | None = None
    found: tuple[FoundLine, ...] = ()
    if motion is None and not unread:
        budget, found = _lines(run, series, window, error.rpe_windows_quantile, parts.windows)
    others = requirements is not None and tuple(requirements) != (_recorded(run)[0] or ())
    if budget is not None and (others or not _of_budget(asked, window, parts.windows)):
        budget = replace(budget, allowances={})  # those of the bag are parts of other limits
    lost, problems, dropped = recording_state(run)
    star, unusable = _star(run, series, window, parts.image) if metrics.is_whole(window, series.dt) else (None, "")
    settled = [judge_settled(r, run, transient) for r in asked]
    knowledge, without = _knowledge(run, transient, window, parts.knowledge)
    sensors, unknown = read_sensors(run)
    axes = sorted({r.axis for r in asked if r.axis})
    alone = [
        f"{a}: {text}"
        for a in axes
        for text in performance_error(run, transient, a).unseen.remarks
        if text not in series.unseen.remarks
    ]
    remarks = dict.fromkeys((*series.unseen.remarks, *alone, *(one.remark for one in settled)))
    problems += [text for text in (damaged, unusable, unread, without, unknown, *remarks) if text]
    problems += _of_series(run, series, window, transient)
    return Summary(
        path=run.path,
        loop=str(run.parameters.get("loop", "")),
        mode=str(run.parameters.get("mode", "")),
        scenario=scenario_of(run),
        ticks=round((series.start + series.duration) / _tick(run, series)),
        duration=series.start + series.duration,
        transient=series.start,
        window=window,
        **vars(error),
        probabilities=parts,
        samples_lost=sum(lost.values()),
        lost_by_topic=lost,
        camera_dropped=dropped,
        knowledge=knowledge,
        verdicts=tuple(one.verdict for one in settled),
        beside=tuple(beside_of(run, r) for r in asked),
        requirements_known=known is not None,
        problems=tuple(problems),
        losses=run.losses,
        contradictions=run.contradictions,
        open_end=series.open_end,
        budget=budget,
        found=found,
        sensors=sensors,
        star=star,
        kind=run.kind,
        sampling=str(run.parameters.get(SAMPLING, "")),
        conditions=conditions_of(run),
    )


def _tick(run: Recording, series: ErrorSeries) -> float:
    """Period of the loop [s]; of a recording without one, of the line of sight."""
    rate = run.parameters.get("rate_hz")
    return 1.0 / rate if on_camera(run) and is_number(rate) and rate > 0.0 else series.dt


def _lines(
    run: Recording, series: ErrorSeries, window: float, total: float, part: float
) -> tuple[ToneBudget | None, tuple[FoundLine, ...]]:
    """Budget of a run in which no tone moves, where it has a window, and the lines that its recording does not name."""
    if not metrics.holds(window, series.dt):  # a spectrum has lines whatever a window's samples are
        named = lines(series.values, series.dt, named_tones(run), window)
        return None, unnamed_lines(series.values, series.dt, named)[0]
    if series.duration < window or not math.isfinite(total):
        return None, ()
    budget = tone_budget(run, series, window, total, part)
    return budget, budget.found


def _of_budget(requirements: Sequence[Requirement], window: float, part: float) -> bool:
    """Whether the allowances of a bag are parts of a limit on what its budget shows: a part of the windows.

    They are parts of the strictest limit on windows.
    """
    strictest = finest(requirements)
    if strictest is None or not strictest.of_windows:
        return True
    return strictest.times == (window,) and strictest.probability == part


def _of_series(run: Recording, series: ErrorSeries, window: float, transient: float | None) -> list[str]:
    """Sentences on a period that is too long, a short start-up, a replay, and a spectrum that ends early."""
    notes = []
    if not metrics.holds(window, series.dt):
        notes.append(f"no RPE of {time_text(window)}: shorter than two samples of {1e3 * series.dt:.6g} ms")
    if transient is None and "transient_s" not in run.parameters and series.start + 0.51 * series.dt < SETTLING:
        notes.append(
            f"less than {2 * SETTLING:g} s recorded: only {series.start:g} s of start-up is excluded, not "
            f"{SETTLING:g} s (analyse --transient SECONDS)"
        )
    if run.parameters.get("mode") == "replay":
        notes.append("a replay: estimates and commands are replayed, the true line of sight is that of the recording")
    if "loop" not in run.parameters and (top := highest_frequency(series.values, series.dt)) is not None:
        notes.append(f"above {top:.3g} Hz the record is near the rounding of its numbers: figures of motion below")
    return notes


def _star(run: Recording, series: ErrorSeries, window: float, part: float) -> tuple[StarExposures | None, str]:
    """Exposures of a star, and what is wrong with the optics of the recording."""
    try:
        optics = optics_of(run)
    except InputError as error:
        return None, str(error)
    if optics is None or len(series.values) <= round(window / series.dt):
        return None, ""
    return StarExposures.of(series, optics, window, part), ""


def scenario_of(run: Recording) -> str:
    """Names of all that acted in a run; of its plant where that is another one than the telescope."""
    if names := conditions_of(run).names:
        return ", ".join(names)
    sources = run.parameters.get("disturbances")  # missing in older bags
    if isinstance(sources, list) and sources:
        return ", ".join(str(source.get("name")) for source in sources if isinstance(source, dict))
    # a plant that does not announce what it runs need not have the scenario of the recorder's settings
    unknown = statistics_of(run.parameters, "plant") and "plant_hash" not in run.parameters
    names = ("disturbance_source", "plant") if unknown else ("disturbance_source", "plant", "scenario")
    return next((str(name) for name in map(run.parameters.get, names) if name), "")


def summarise_all(
    runs: Sequence[Recording],
    *,
    transient: float | None = None,
    requirements: Sequence[Requirement] | None = None,
) -> list[Summary]:
    """:func:`summarise` of each run; a requirement over several runs has the verdict on all of them in each summary.

    The arguments are those of :func:`summarise`.
    """
    summaries = [summarise(run, transient=transient, requirements=requirements) for run in runs]
    if len(runs) < 2:
        return summaries
    of_runs = [applicable(requirements_of(run) or () if requirements is None else requirements, run) for run in runs]
    wanted = {str(r): r for chosen in of_runs for r in chosen if r.across_runs}
    joint = {
        text: judge(r, [run for run, chosen in zip(runs, of_runs) if text in map(str, chosen)], transient)
        for text, r in wanted.items()
    }
    return [replace(s, verdicts=tuple(joint.get(str(v.requirement), v) for v in s.verdicts)) for s in summaries]
