"""Runs judged by pointing requirements (:mod:`pointing_analysis.requirements.requirement`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.image.motion_blur import exposure_parts
from pointing_analysis.image.optics import NONE_KNOWN, Optics, optics_of
from pointing_analysis.indices import confidence, metrics
from pointing_analysis.indices.confidence import EffectiveSamples
from pointing_analysis.indices.errors import ErrorSeries, knowledge_error, performance_error
from pointing_analysis.indices.exceedances import BlockSums, IndependentSamples, period, pooled_number
from pointing_analysis.indices.mirror_following import COMMAND, GAUGE, not_followed
from pointing_analysis.read.mapped_arrays import by_parts, parts, present
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run_end import statistics_of
from pointing_analysis.requirements.conditions import NEVER, START_UP
from pointing_analysis.requirements.image_samples import finite, image_samples
from pointing_analysis.requirements.requirement import Requirement, from_entries, load, parse

__all__ = [
    "IndexSamples",
    "InputError",
    "Requirement",
    "Status",
    "Verdict",
    "beyond_limit",
    "decide",
    "from_entries",
    "index_samples",
    "judge",
    "load",
    "parse",
    "refusal",
    "run_samples",
    "series_of",
]

ROUNDING = 1e-9
"""Rounding tolerance of a computed count of samples."""
FAULT, FAULT_STAMP = "device_fault", "device_fault_stamp"
"""Statistics of a plant that is a device: why it failed, and the stamp [ns] of the tick from which it did."""
NOT_JUDGED = "not_judged"
"""Key of a replay whose recording is not judged: why, :func:`not_judged_by`."""
Status = Literal["compliant", "not compliant", "not enough data", "not judged"]


@dataclass(frozen=True)
class Verdict:
    """Verdict of runs on one requirement.

    Attributes
    ----------
    status : compliant, not compliant, not enough data, or not judged (the index cannot be formed; see `note`)
    exceeding : share of the samples above the limit, or below a lower one
    quantile : the required quantile with its bounds [rad], of numbers the number; of a lower limit the value that the
        required part of the samples is above
    samples : samples of the index
    effective : independent samples they weigh as much as
    seconds : length of data that was used [s]
    seconds_needed : length of data that would decide, at the exceedance rate seen so far; infinite if none would. Of an
        ensemble that of all runs together, each as long as these are on average
    note : why it was not judged, how many samples are missing, or what may be larger than the record shows
    missing : samples of the index that are missing in the judged span; see `decide`
    start : length of the start-up of a run, which precedes the data [s]
    """

    requirement: Requirement
    status: Status
    exceeding: float
    quantile: confidence.Quantile
    samples: int
    effective: float
    seconds: float
    seconds_needed: float
    note: str = ""
    missing: float = 0.0
    start: float = 0.0

    @property
    def within_limit(self) -> bool:
        """Whether the samples exceed the limit no more often than the requirement allows, proven or not.

        Missing samples count as exceeding it.
        """
        if math.isinf(self.missing):
            return False
        above = self.exceeding * self.samples + self.missing
        return above <= (1 - self.requirement.probability) * (self.samples + self.missing) + ROUNDING

    @property
    def statement(self) -> str:
        """The verdict in words: of too short a run whether it is within limit, and the length to demonstrate it."""
        if self.status != "not enough data":
            return self.status
        if self.missing and not self.within_limit:
            return f"not enough data: {_missing_note(self.requirement, self.missing, self.samples)}"
        beyond = "below" if self.requirement.lower else "above"
        if math.isinf(self.seconds_needed):
            return f"{'within' if self.within_limit else beyond} limit; not demonstrated by a run of any length"
        after = f" after {self.start:.3g} s of start-up" if self.start else ""
        needs = f"needs {math.ceil(self.seconds_needed)} s{after}"
        if self.requirement.interpretation == "ensemble":  # a longer run is one sample as well
            needs = f"needs {math.ceil(self.effective * self.seconds_needed / self.seconds - ROUNDING)} runs"
        at = f"at {100 * self.requirement.confidence:g} % confidence"
        return f"{'within' if self.within_limit else beyond} limit; not yet demonstrated {at}: {needs}"


@dataclass(frozen=True)
class IndexSamples:
    """Samples of the index of one run, or of one pair of runs for the PRE.

    Attributes
    ----------
    values : those that are there [rad]
    effective : independent samples that their exceedances of a requirement's limit weigh as much as
    seconds : length of the data, of missing samples, too [s]
    missing : samples missing; infinite if the recording is truncated and their number is unknown
    start : length of the start-up before them [s]
    """

    values: FloatArray
    effective: Callable[[Requirement], EffectiveSamples]
    seconds: float
    missing: float
    start: float = 0.0

    def decided(self, requirement: Requirement, runs: int = 1) -> Verdict:
        """Verdict on this run, or pair of runs, one of so many; see `decide`."""
        effective = self.effective(requirement)
        verdict = decide(requirement, self.values, effective, self.seconds, self.missing, runs)
        return replace(verdict, start=self.start)


def series_of(requirement: Requirement, run: Recording, transient: float | None = None) -> ErrorSeries:
    """The error series that a requirement is about: performance or knowledge error, of one axis or of both.

    Raises
    ------
    ValueError
        There is none, the sensor did not see more of the motion than the requirement allows to exceed, or the values
        are rounded to more than half of the limit.
    """
    make = knowledge_error if requirement.index in ("AKE", "MKE", "RKE") else performance_error
    series = make(run, transient, requirement.axis)
    limit = math.inf if requirement.of_image else requirement.limit
    if why := series.unseen.reason(1.0 - requirement.probability, limit):
        raise InputError(why)
    return series


def run_samples(series: ErrorSeries, requirement: Requirement, optics: Optics | None = None) -> IndexSamples:
    """Samples of the judged index of one run: a recording, or a member of a campaign.

    Parameters
    ----------
    series : the error that the requirement is about, `series_of`
    requirement : of any index but the PRE
    optics : of an index of the image

    Raises
    ------
    ValueError
        The index cannot be formed.
    """
    samples = index_samples(series, requirement, optics)
    there = present(samples.values)
    if not there.size:
        raise InputError(f"no complete window of {requirement.quantity}")
    values = finite(samples.values) if requirement.of_image else samples.values
    independent = IndependentSamples.of(values, samples.most, samples.motion)
    missing = math.inf if series.open_end else float(len(samples.values) - len(there))
    seconds = len(samples.values) * samples.step
    return IndexSamples(there, lambda r: independent.above(r.limit, r.lower), seconds, missing, series.start)


def refusal(requirement: Requirement, rows: int, dt: float, optics: Optics | None = None) -> str:
    """Why the index of a run of so many samples of `dt` [s] cannot be formed; empty where it can.

    Examples
    --------
    >>> refusal(parse("prob(rms RPE(2 s) < 1 mas) >= 0.9 at 95 % confidence"), 1000, 1e-3)
    'the run must be at least as long as the window of 2 s, got 1 s'
    """
    still = ErrorSeries(np.zeros((rows, 2)), dt, 0.0, 0)
    try:
        if not requirement.of_image:
            index_samples(still, requirement)
        elif optics is None:
            raise InputError(NONE_KNOWN)
        else:
            next(exposure_parts(still.values, dt, requirement.times[0], 1))
    except ValueError as error:
        return str(error)
    return ""


@dataclass(frozen=True)
class SamplesInTime:
    """Samples of an index in the order of time.

    Attributes
    ----------
    values : (n,) [rad], or numbers; NaN where one is missing
    step : time for each of them [s]
    motion : (n, k) signed errors whose size the values are; None for an index of a scatter or of an image
    most : no more than this many are independent
    """

    values: FloatArray
    step: float
    motion: FloatArray | None = None
    most: float = math.inf


def index_samples(series: ErrorSeries, requirement: Requirement, optics: Optics | None = None) -> SamplesInTime:
    """Samples of the judged index.

    RPE samples are those of the instant estimator: every instant of disjoint windows. Samples within one window share
    its mean, so no more than one per window counts. Of a requirement of windows each window is one sample.
    Of an index of the image each exposure is one; it needs the `optics`.
    """
    e, dt, times = series.values, series.dt, requirement.times
    if requirement.of_image:
        if optics is None:
            raise InputError(NONE_KNOWN)
        return SamplesInTime(image_samples(series, requirement, optics), times[0])
    if requirement.of_windows:
        windows = metrics.windows(e, dt, times[0])
        return SamplesInTime(windows.in_order(_norm(np.sqrt(windows.variance), requirement)), times[0])
    if requirement.index in ("RPE", "RKE"):
        instants = _norm(metrics.rpe_instant(e, dt, times[0]), requirement)
        return SamplesInTime(instants, dt, most=len(metrics.windows(e, dt, times[0]).mean))
    if requirement.index in ("APE", "AKE"):
        motion, step = e, dt
    elif requirement.index in ("MPE", "MKE"):
        windows = metrics.windows(e, dt, times[0])
        motion, step = windows.in_order(windows.mean), times[0]
    else:
        motion, step = metrics.pde(e, dt, times[0], times[1]), times[0]
    if requirement.axis:
        column = metrics.AXES.index(requirement.axis)
        motion = motion[:, column : column + 1]
        return SamplesInTime(by_parts(lambda rows: np.abs(rows[:, 0]), motion), step, motion)
    return SamplesInTime(metrics.radial(motion), step, motion)


def _reproducibility(
    requirement: Requirement, runs: Sequence[Recording], transient: float | None
) -> list[IndexSamples]:
    """Samples of the PRE of every pair of runs: each window of the one against each of the other.

    The windows of a run are used many times over, so a pair weighs as much as the shorter of its two runs.
    """
    series = [series_of(requirement, run, transient) for run in runs]
    pairs_of_runs = []
    for i, first in enumerate(series):
        for second in series[i + 1 :]:
            window = requirement.times[0]
            means = [metrics.mpe(s.values, s.dt, window) for s in (first, second)]
            values = _norm(metrics.pre(means[0], means[1]), requirement)
            if not values.size:
                raise InputError(f"no complete window of {requirement.quantity} in each run")
            most = min(IndependentSamples.of(metrics.radial(m), components=m).most for m in means)
            pairs = math.prod(int(len(s.values) * s.dt / window + ROUNDING) for s in (first, second))
            cut = first.open_end or second.open_end
            missing = math.inf if cut else float(max(pairs - len(values), 0))
            effective = partial(_of_pairs, values, min(len(means[0]), metrics.PAIRED), most)
            pairs_of_runs.append(IndexSamples(values, effective, first.duration + second.duration, missing))
    return pairs_of_runs


def _of_pairs(values: FloatArray, rows: int, most: float, requirement: Requirement) -> EffectiveSamples:
    """Independent samples that the exceedances of pairs of windows weigh as much as.

    The share that one window of a run exceeds is a sample of that run: the variances over both runs add.

    Parameters
    ----------
    values : (rows * columns,) of each window of the first run with each of the second
    rows : windows of the first run
    most : no more than this many
    """
    beyond = beyond_limit(values, requirement).reshape(rows, -1)
    share = float(beyond.mean())
    variance = share * (1.0 - share)
    shares = [np.asarray(beyond.mean(axis=axis) - share) for axis in (0, 1)]
    one = sum(BlockSums.of(of_run.__getitem__, len(of_run)).factor(variance, 0.0) / len(of_run) for of_run in shares)
    return EffectiveSamples.of(max(min(most, 1.0 / one if one else most), 1.0))


def _norm(samples: FloatArray, requirement: Requirement) -> FloatArray:
    if requirement.axis:
        column = metrics.AXES.index(requirement.axis)
        return by_parts(lambda rows: np.abs(rows[:, column]), samples)
    return metrics.radial(samples)


def not_judged(requirement: Requirement, why: str) -> Verdict:
    """A verdict with the reason why there is none."""
    nothing = confidence.Quantile(requirement.probability, requirement.confidence, math.nan, math.nan, math.inf, 0.0)
    return Verdict(requirement, "not judged", math.nan, nothing, 0, 0.0, 0.0, math.nan, why)


def decide(
    requirement: Requirement,
    values: FloatArray,
    effective: EffectiveSamples | float,
    seconds: float,
    missing: float = 0.0,
    runs: int = 1,
) -> Verdict:
    """Judge samples of the index that weigh as much as `effective` independent ones and took `seconds` to record.

    Of several `runs` that are judged alone, one that is not compliant is the verdict on all of them: each is refuted at
    so much more confidence that all of them together are falsely refuted no more often than one (Bonferroni).

    Missing samples count against either verdict: for ``compliant`` each of them as one above the limit, for ``not
    compliant`` as one below it. Where both fail, and where an unknown number is missing and the rest complies, there is
    not enough data. For ``compliant`` the samples of larger clusters that may come are above the limit, too.
    """
    effective = EffectiveSamples.of(effective)
    above = sum(int(np.count_nonzero(beyond_limit(values[part], requirement))) for part in parts(len(values)))
    rate = above / len(values)
    p, c, number = requirement.probability, requirement.confidence, effective.number
    unknown = math.isinf(missing)
    total = len(values) + (0.0 if unknown else missing)
    best, worst = above / total, 1.0 if unknown else (above + missing) / total
    unseen = effective.unseen / total
    status, needed, note = status_of(requirement, worst + unseen, best, effective, runs), seconds, ""
    if status == "not enough data":
        open_share = not unknown and best <= 1 - p < worst  # the samples that are missing would decide
        share = rate if unknown else best if best > 1 - p else worst
        each = seconds / (number if unknown else effective.with_missing)
        again = period(values, float(np.std(values))) < len(values)  # a longer record of it tells no more
        samples = math.inf if open_share or again else confidence.samples_to_decide(p, c, share, unseen * number)
        needed = max(each * samples, seconds + each)  # the record itself was not enough
        if status_of(requirement, worst, best, effective, runs) == "compliant":
            what = "exceedances come" if above else "the largest values come"
            note = f"{what} in clusters, of which too few are in the record to say how large they are"
    note = "; ".join(filter(None, (note, _missing_note(requirement, missing, len(values)))))
    bounds = confidence.quantile(-values if requirement.lower else values, p, c, effective, missing)
    if requirement.lower:
        bounds = replace(bounds, value=-bounds.value, lower=-bounds.upper, upper=-bounds.lower)
    return Verdict(requirement, status, rate, bounds, len(values), number, seconds, needed, note, missing)


def status_of(
    requirement: Requirement, worst: float, best: float, effective: EffectiveSamples | float, runs: int = 1
) -> Status:
    """Status of a share beyond the limit that is at most `worst` and at least `best`, of `effective` samples.

    Exceedances are scaled to the effective number, each bound rounded to its own safe side.
    """
    effective = EffectiveSamples.of(effective)
    c, allowed = requirement.confidence, 1 - requirement.probability
    n = max(int(effective.with_missing), 1)
    upper = confidence.exceedance_upper(math.ceil(min(worst, 1.0) * n - ROUNDING), n, c)
    n, refuting = max(int(effective.number), 1), 1 - (1 - c) / runs if runs > 1 else c
    lower = confidence.exceedance_lower(math.floor(best * n + ROUNDING), n, refuting)
    return "compliant" if upper <= allowed else "not compliant" if lower > allowed else "not enough data"


def beyond_limit(values: FloatArray, requirement: Requirement) -> BoolArray:
    """Which samples exceed the limit."""
    return np.asarray(values <= requirement.limit if requirement.lower else values >= requirement.limit)


def _missing_note(requirement: Requirement, missing: float, samples: int) -> str:
    if not missing:
        return ""
    if math.isinf(missing):
        return "the recording is truncated: the missing part is not known"
    what = "windows" if requirement.of_windows else "samples"
    return f"{missing:.0f} of {samples + missing:.0f} {what} are missing and count against the verdict"


def judge(requirement: Requirement, runs: Sequence[Recording], transient: float | None = None) -> Verdict:
    """Judge runs against one requirement.

    With the temporal interpretation every run must comply and the worst verdict counts (of m runs each is refuted at a
    confidence of 1 - (1 - c) / m); the ensemble one takes the
    worst instant of each run as one independent sample, those of runs with missing samples as missing; the mixed one
    puts the samples of all runs together. Recordings that contradict their own digests are not judged, nor are those
    of a device while it failed or its mirror did not follow its command. Nor is one of a loop that is known to be
    unstable, unless it is not compliant.
    """
    verdict = _judged(requirement, runs, transient)
    if verdict.status != "not compliant" and any(run.parameters.get(START_UP) == NEVER for run in runs):
        return not_judged(requirement, "the loop is unstable")
    return verdict


def _judged(requirement: Requirement, runs: Sequence[Recording], transient: float | None) -> Verdict:
    if len(runs) < 2 and requirement.across_runs:
        what = "PRE" if requirement.index == "PRE" else requirement.interpretation
        return not_judged(requirement, f"{what} requirements need several runs, got {len(runs)}")
    if reasons := [text for run in runs if (text := not_judged_by(run))]:
        return not_judged(requirement, reasons[0])
    try:
        collected = _collect(requirement, runs, transient)
    except ValueError as error:
        alone = f"{runs[0].path}: " if len(runs) == 1 else ""  # its name stands beside the verdict
        return not_judged(requirement, str(error).removeprefix(alone))
    seconds = sum(one.seconds for one in collected)
    if requirement.interpretation == "ensemble":
        worst_of = [_worst(one.values, requirement) for one in collected]
        known = [w for one, w in zip(collected, worst_of) if not one.missing or beyond_limit(np.array(w), requirement)]
        if not known:
            return not_judged(requirement, "every run has missing samples: no worst instant is known")
        worst = np.array(known)
        return decide(requirement, worst, len(worst), seconds, float(len(collected) - len(known)))
    if requirement.interpretation == "mixed":
        values = np.concatenate([one.values for one in collected])
        missing = sum(one.missing for one in collected)
        sizes, each = [len(one.values) for one in collected], [one.effective(requirement) for one in collected]
        number = pooled_number([n.number for n in each], sizes)
        with_missing = pooled_number([n.with_missing for n in each], sizes)
        effective = EffectiveSamples(number, with_missing, max(n.unseen for n in each))
        return decide(requirement, values, effective, seconds, missing)
    verdicts = [one.decided(requirement, len(collected)) for one in collected]
    order = {"not compliant": 0, "not enough data": 1, "compliant": 2}
    sign = 1.0 if requirement.lower else -1.0
    return min(verdicts, key=lambda v: (order[v.status], -v.exceeding, sign * v.quantile.value))


def not_judged_by(run: Recording) -> str:
    """Why nothing is judged by a recording; empty where it can be."""
    if reason := run.parameters.get(NOT_JUDGED):
        return str(reason)
    if run.contradictions:
        return f"the recording contradicts its own digests: {run.contradictions[0]}"
    cut = "; report --from, --to judge the rest"
    if periods := not_followed(run):
        more = f" and {counted(len(periods) - 1, 'more time')}" if periods[1:] else ""
        return f"the mirror did not follow its command from {periods[0][0]:.2f} to {periods[0][1]:.2f} s{more}{cut}"
    plant = statistics_of(run.parameters, "plant")
    stamp = str(plant.get(FAULT_STAMP))
    since = int(stamp) if stamp.isdecimal() else 0
    if FAULT in plant and any((run[name].stamp[-1:] >= since).any() for name in (COMMAND, GAUGE) if name in run):
        return f"the device failed: {plant[FAULT]}{cut}"
    return ""


def _worst(values: FloatArray, requirement: Requirement) -> float:
    """Worst sample of a run."""
    if requirement.lower:
        return min(float(values[part].min()) for part in parts(len(values)))
    return max(float(values[part].max()) for part in parts(len(values)))


def _collect(requirement: Requirement, runs: Sequence[Recording], transient: float | None) -> list[IndexSamples]:
    """Of each run, and for the PRE of each pair: the samples of the index."""
    if requirement.index == "PRE":
        return _reproducibility(requirement, runs, transient)
    collected = []
    for run in runs:
        series = series_of(requirement, run, transient)
        try:
            optics = optics_of(run) if requirement.of_image else None
            collected.append(run_samples(series, requirement, optics))
        except ValueError as error:
            raise BagError(f"{run.path}: {error}") from None
    return collected
