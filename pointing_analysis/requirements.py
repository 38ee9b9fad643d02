"""Pointing requirements: read them, judge runs by them.

The text form is the requirement form of ECSS-E-ST-60-10C::

    prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence

with an index (APE, MPE, RPE, PDE, PRE, AKE, MKE, RKE; ``_x`` or ``_y`` for one axis), its window where it has one (two
times for PDE: window and separation), a limit, a probability, a confidence, and the interpretation: ``temporal``
(default: every run, over its time), ``ensemble`` (over runs, the worst instant of each) or ``mixed`` (over runs and
time together).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pointing_analysis import confidence, metrics
from pointing_analysis.errors import RAD_PER_ARCSEC, RAD_PER_MAS, ErrorSeries, knowledge_error, performance_error
from pointing_analysis.mcap_records import BagError
from pointing_analysis.read import Run
from pointing_analysis.structured_text import StructuredTextError, load_toml, load_yaml, read_text

ANGLES = {
    "mas": RAD_PER_MAS,
    "arcsec": RAD_PER_ARCSEC,
    "nrad": 1e-9,
    "urad": 1e-6,
    "mrad": 1e-3,
    "rad": 1.0,
}
TIMES = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}
#: index -> number of times it takes
INDICES = {"APE": 0, "MPE": 1, "RPE": 1, "PDE": 2, "PRE": 1, "AKE": 0, "MKE": 1, "RKE": 1}
INTERPRETATIONS = ("temporal", "ensemble", "mixed")
DEFAULT_FILE = Path(__file__).with_name("requirements.toml")
_TEXT = re.compile(
    r"prob\s*\(\s*\|\s*(?P<index>[A-Za-z]+)(?:_(?P<axis>[xy]))?\s*(?:\((?P<times>[^)]*)\))?\s*\|\s*<=?\s*"
    r"(?P<limit>[\d.eE+-]+)\s*(?P<unit>[a-z]+)\s*\)\s*>=?\s*(?P<p>[\d.]+)\s*(?P<pp>%?)\s*"
    r"at\s+(?P<c>[\d.]+)\s*(?P<cp>%?)\s*confidence\s*(?:,\s*(?P<kind>[a-z]+))?\s*"
)
Status = Literal["compliant", "not compliant", "not enough data", "not judged"]


class RequirementError(ValueError):
    """A requirement that cannot be read; the message says what it must be and what it is."""


@dataclass(frozen=True)
class Requirement:
    """One pointing requirement; `parse` makes it from its text.

    Attributes
    ----------
    index : one of `INDICES`
    axis : "" for the norm of the 2-vector, ``x`` or ``y`` for one axis
    times : window, and separation for PDE [s]
    limit : [rad]
    unit : unit in which the limit is shown
    probability, confidence : between 0 and 1
    interpretation : temporal, ensemble or mixed
    name : short name
    loops : loop stages it applies to; empty for all
    """

    index: str
    axis: str
    times: tuple[float, ...]
    limit: float
    unit: str
    probability: float
    confidence: float
    interpretation: str = "temporal"
    name: str = ""
    loops: tuple[str, ...] = ()

    @property
    def scale(self) -> float:
        """Radians per display unit."""
        return ANGLES[self.unit]

    @property
    def across_runs(self) -> bool:
        """Whether it is judged on several runs together and not on each."""
        return self.interpretation != "temporal" or self.index == "PRE"

    @property
    def quantity(self) -> str:
        """The judged quantity, e.g. ``|RPE(20 ms)|``."""
        times = ", ".join(f"{1e3 * t:g} ms" if t < 1 else f"{t:g} s" for t in self.times)
        axis = f"_{self.axis}" if self.axis else ""
        return f"|{self.index}{axis}{f'({times})' if times else ''}|"

    def __str__(self) -> str:
        tail = "" if self.interpretation == "temporal" else f", {self.interpretation}"
        return (
            f"prob({self.quantity} < {self.limit / self.scale:g} {self.unit}) >= {self.probability:g} "
            f"at {100 * self.confidence:g} % confidence{tail}"
        )


def parse(text: str, name: str = "", loops: Sequence[str] = ()) -> Requirement:
    """Read a requirement from its text.

    Raises
    ------
    RequirementError
        The text has another form, or names an unknown index, unit or interpretation.

    Examples
    --------
    >>> r = parse("prob(|RPE(20 ms)| < 40 mas) >= 99.7 % at 95 % confidence")
    >>> print(r)
    prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence
    """
    m = _TEXT.fullmatch(text.strip())
    if m is None:
        raise RequirementError(
            f"requirement must read like 'prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence', got {text!r}"
        )
    index, kind = m["index"].upper(), m["kind"] or "temporal"
    _member("index", index, INDICES)
    _member("unit", m["unit"], ANGLES)
    _member("interpretation", kind, INTERPRETATIONS)
    times = tuple(_time(part) for part in (m["times"] or "").split(",") if part.strip())
    if len(times) != INDICES[index]:
        raise RequirementError(f"{index}(...) must have {INDICES[index]} times, got {len(times)} in {text!r}")
    probability, confidence = (
        _float(m[value]) / (100 if m[percent] else 1) for value, percent in (("p", "pp"), ("c", "cp"))
    )
    for what, value in (("probability", probability), ("confidence", confidence)):
        if not 0 < value < 1:
            raise RequirementError(f"{what} must be between 0 and 1 (or 0 and 100 %), got {value:g} in {text!r}")
    limit = _float(m["limit"]) * ANGLES[m["unit"]]
    if not 0 < limit < math.inf:
        raise RequirementError(f"limit must be positive, got {m['limit']} in {text!r}")
    return Requirement(
        index, m["axis"] or "", times, limit, m["unit"], probability, confidence, kind, name or index, tuple(loops)
    )


def _member(what: str, value: str, known: Any) -> None:
    if value not in known:
        raise RequirementError(f"{what} must be one of {', '.join(known)}, got {value!r}")


def _time(text: str) -> float:
    m = re.fullmatch(r"\s*([\d.]+)\s*(us|ms|s|min)\s*", text)
    if m is None or not 0 < _float(m[1]) < 1e9:
        raise RequirementError(f"time must read like '20 ms', got {text.strip()!r}")
    return float(m[1]) * TIMES[m[2]]


def _float(text: str) -> float:
    """A number, NaN where the text is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def load(path: str | os.PathLike[str] = DEFAULT_FILE) -> tuple[Requirement, ...]:
    """Read a requirement file: TOML with ``[[requirement]]`` tables, or YAML with a list ``requirement``.

    Each entry has a ``text`` and may have a ``name`` and a ``loop`` (list of loop stages it applies to).

    Examples
    --------
    >>> [r.quantity for r in load()]
    ['|APE|', '|RPE(20 ms)|', '|RPE(20 ms)|']
    """
    file = Path(path)
    try:
        read = load_yaml if file.suffix in (".yaml", ".yml") else load_toml
        content = read(read_text(file), file)
    except StructuredTextError as error:
        raise RequirementError(str(error)) from None
    entries = content.get("requirement") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) and "text" in e for e in entries):
        raise RequirementError(f"{file}: must hold a list 'requirement' whose entries have a 'text'")
    found = []
    for entry in entries:
        unknown = set(entry) - {"text", "name", "loop"}
        if unknown:
            raise RequirementError(f"{file}: keys must be of text, name, loop, got {sorted(unknown)}")
        loops = entry.get("loop", ())
        loops = [loops] if isinstance(loops, str) else loops
        if not isinstance(loops, (list, tuple)) or not all(isinstance(loop, str) for loop in loops):
            raise RequirementError(f"{file}: loop must be a name or a list of names, got {loops!r}")
        found.append(parse(str(entry["text"]), str(entry.get("name", "")), loops))
    return tuple(found)


@dataclass(frozen=True)
class Verdict:
    """How runs stand against one requirement.

    Attributes
    ----------
    status : compliant, not compliant, not enough data, or not judged (the index cannot be formed; see `note`)
    exceeding : share of the samples above the limit
    quantile : the required quantile with its bounds [rad]
    samples : samples of the index
    effective : independent samples they weigh as much as
    seconds : length of data that was used [s]
    seconds_needed : length of data that would decide, at the exceedance rate seen so far; infinite if none would
    note : why it was not judged, or how many samples are missing
    missing : samples of the index that are missing in the judged span; `decide` says how they count
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


@dataclass(frozen=True)
class Samples:
    """Samples of the index of one run, or of one pair of runs for the PRE.

    Attributes
    ----------
    values : those that are there [rad]
    effective : independent samples they weigh as much as
    seconds : length of the data [s]
    missing : samples missing; infinite where the recording was cut off and nothing says how many
    """

    values: NDArray[np.float64]
    effective: float
    seconds: float
    missing: float = 0.0


def index_samples(series: ErrorSeries, requirement: Requirement) -> tuple[NDArray[np.float64], float, float]:
    """Samples of the judged index [rad], the largest number of them that may count as independent, and those missing.

    RPE samples are those of the instant estimator: every instant of disjoint windows. Samples within one window share
    its mean, so no more than one per window counts.
    """
    values, cap = _index(series.values, series.dt, requirement)
    there = values[~np.isnan(values)]
    if series.open_end:
        return there, cap, math.inf
    if not series.missing:
        return there, cap, 0.0
    whole, _ = _index(np.zeros_like(series.values), series.dt, requirement)
    return there, cap, float(len(whole) - len(there))


def _index(e: NDArray[np.float64], dt: float, requirement: Requirement) -> tuple[NDArray[np.float64], float]:
    times, cap = requirement.times, math.inf
    if requirement.index in ("APE", "AKE"):
        samples = e
    elif requirement.index in ("MPE", "MKE"):
        samples = metrics.mpe(e, dt, times[0])
    elif requirement.index in ("RPE", "RKE"):
        samples = metrics.rpe_instant(e, dt, times[0])
        cap = len(metrics.windows(e, dt, times[0]).mean)
    else:
        samples = metrics.pde(e, dt, times[0], times[1])
    return _norm(samples, requirement), cap


def _reproducibility(requirement: Requirement, runs: Sequence[Run], transient: float | None) -> list[Samples]:
    """Samples of the PRE of every pair of runs: each window of the one against each of the other.

    The windows of a run are used many times over, so a pair weighs as much as the shorter of its two runs.
    """
    series = [performance_error(run, transient) for run in runs]
    found = []
    for i, first in enumerate(series):
        for second in series[i + 1 :]:
            window = requirement.times[0]
            samples = metrics.pre(first.values, second.values, first.dt, window)
            values = _norm(samples, requirement)
            means = [metrics.mpe(s.values, s.dt, window) for s in (first, second)]
            weight = min(confidence.effective_number(metrics.radial(m)) for m in means)
            pairs = math.prod(int(len(s.values) * s.dt / window + 1e-9) for s in (first, second))
            cut = first.open_end or second.open_end
            missing = math.inf if cut else float(max(pairs - len(values), 0))
            found.append(Samples(values, weight, first.duration + second.duration, missing))
    return found


def _norm(samples: NDArray[np.float64], requirement: Requirement) -> NDArray[np.float64]:
    if requirement.axis:
        return np.asarray(np.abs(samples[:, metrics.AXES.index(requirement.axis)]))
    return metrics.radial(samples)


def _not_judged(requirement: Requirement, why: str) -> Verdict:
    nothing = confidence.Quantile(requirement.probability, requirement.confidence, math.nan, math.nan, math.inf, 0.0)
    return Verdict(requirement, "not judged", math.nan, nothing, 0, 0.0, 0.0, math.nan, why)


def decide(
    requirement: Requirement, values: NDArray[np.float64], effective: float, seconds: float, missing: float = 0.0
) -> Verdict:
    """Judge samples of the index that weigh as much as `effective` independent ones and took `seconds` to record.

    Missing samples count against either verdict: for ``compliant`` each of them as one above the limit, for ``not
    compliant`` as one below it. Where both fail, and where an unknown number is missing and the rest complies, there is
    not enough data.
    """
    n = max(int(effective), 1)
    above = int(np.count_nonzero(values >= requirement.limit))
    rate = above / len(values)
    p, c = requirement.probability, requirement.confidence
    unknown = math.isinf(missing)
    total = len(values) + (0.0 if unknown else missing)
    worst, best = (1.0 if unknown else (above + missing) / total), above / total
    # Exceedances are scaled to the effective number, each bound rounded to its own safe side.
    upper = confidence.exceedance_upper(math.ceil(worst * n - 1e-9), n, c)
    lower = confidence.exceedance_lower(math.floor(best * n + 1e-9), n, c)
    status: Status = "not enough data"
    needed = seconds
    if upper <= 1 - p:
        status = "compliant"
    elif lower > 1 - p:
        status = "not compliant"
    else:
        needed = confidence.samples_to_decide(p, c, rate if unknown else worst) * seconds / effective
    bounds = confidence.quantile(values, p, c, effective)
    note = _missing_note(missing, total)
    if missing:  # what is not there may lie beyond any bound
        bounds = replace(bounds, upper=math.inf)
    return Verdict(requirement, status, rate, bounds, len(values), effective, seconds, needed, note, missing)


def _missing_note(missing: float, total: float) -> str:
    if not missing:
        return ""
    if math.isinf(missing):
        return "the recording was cut off, how much is missing is not known"
    return f"{missing:.0f} of {total:.0f} samples are missing and count against the verdict"


def judge(requirement: Requirement, runs: Sequence[Run], transient: float | None = None) -> Verdict:
    """Judge runs against one requirement.

    With the temporal interpretation every run must comply and the worst verdict counts; the ensemble one takes the
    worst instant of each run as one independent sample, those of runs with missing samples as missing; the mixed one
    puts the samples of all runs together.
    """
    if len(runs) < 2 and requirement.across_runs:
        what = "PRE" if requirement.index == "PRE" else requirement.interpretation
        return _not_judged(requirement, f"a {what} requirement needs several runs, got {len(runs)}")
    try:
        collected = _collect(requirement, runs, transient)
    except ValueError as error:
        return _not_judged(requirement, str(error))
    seconds = sum(one.seconds for one in collected)
    if requirement.interpretation == "ensemble":
        known = [one for one in collected if not one.missing or one.values.max() >= requirement.limit]
        if not known:
            return _not_judged(requirement, "every run has missing samples: the worst instant of none is known")
        worst = np.array([one.values.max() for one in known])
        return decide(requirement, worst, len(worst), seconds, float(len(collected) - len(known)))
    if requirement.interpretation == "mixed":
        values = np.concatenate([one.values for one in collected])
        missing = sum(one.missing for one in collected)
        return decide(requirement, values, sum(one.effective for one in collected), seconds, missing)
    verdicts = [decide(requirement, one.values, one.effective, one.seconds, one.missing) for one in collected]
    order = {"not compliant": 0, "not enough data": 1, "compliant": 2, "not judged": 3}
    return min(verdicts, key=lambda v: (order[v.status], -v.exceeding, -v.quantile.value))


def _collect(requirement: Requirement, runs: Sequence[Run], transient: float | None) -> list[Samples]:
    """Of each run, and for the PRE of each pair: the samples of the index."""
    if requirement.index == "PRE":
        return _reproducibility(requirement, runs, transient)
    make = knowledge_error if requirement.index in ("AKE", "MKE", "RKE") else performance_error
    collected = []
    for run in runs:
        series = make(run, transient)
        try:
            values, cap, missing = index_samples(series, requirement)
        except ValueError as error:
            raise BagError(f"{run.path}: {error}") from None
        if not values.size:
            raise BagError(f"{run.path}: no complete window of {requirement.quantity}")
        effective = min(cap, confidence.effective_number(values))
        collected.append(Samples(values, effective, series.duration, missing))
    return collected
