"""Any line of sight as arrays: the same metrics and report as for a bag of the testbed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.read.mcap.bag_loss import TopicLoss
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.time_grid import OFF_GRID, TimeGrid, on_whole_ns, regular, time_grid
from pointing_analysis.read.topic import NANO, Topic, make_topic
from pointing_analysis.units import ANGLES

LOS = "truth/los"
"""Topic under which the analysis looks for the line of sight."""
SAMPLING = "sampling_of_the_samples"
"""Parameter of a recording of others: its rate, where that is from, and the jitter of its times."""
ORIGIN = NANO
"""Stamp of the first sample [ns] where the time has no epoch; the stamp 0 means "not stamped"."""
LONGEST = 1e9
"""Longest time from the first sample to the last one [s]; beyond it the times are in another unit."""
LARGEST_ANGLE = 1e9
"""Largest sample that counts as an angle [rad]: far above any, and its square is still a number."""
OUT_OF_STEP = 0.5
"""Samples by which a given rate may be out of step with the times from the first to the last one."""
FEW = 0.01
"""Share of the samples that may miss the grid, or fall on a place that is taken."""

_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Series:
    """A line of sight with what is known of it; a `pointing_analysis.read.recording.Recording`.

    Attributes
    ----------
    topic : the line of sight [rad], named ``truth/los``
    path : where it comes from
    parameters : what is known of the run; shown in the report
    problems : defects, one sentence each
    attachments : none
    losses : what is known to be lost, by topic
    contradictions : where a bag contradicts its own digests
    kind : what it comes from: ``bag``, ``CSV``, ``arrays`` ...
    label : name of the samples there: a topic, or columns
    """

    topic: Topic
    path: Path
    parameters: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    problems: tuple[str, ...] = ()
    attachments: Mapping[str, bytes] = field(default_factory=lambda: MappingProxyType({}))
    losses: tuple[TopicLoss, ...] = ()
    contradictions: tuple[str, ...] = ()
    kind: str = "arrays"
    label: str = "line of sight"

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics."""
        return (LOS,)

    @property
    def title(self) -> str:
        """Name of the file."""
        return self.path.name

    def changed(self, parameters: Mapping[str, Any], attachments: Mapping[str, bytes]) -> Series:
        """The same samples with other parameters and further attachments."""
        more = MappingProxyType({**self.attachments, **attachments})
        return replace(self, parameters=MappingProxyType(dict(parameters)), attachments=more)

    def shown(self, name: str) -> str:
        """Name of a topic for messages: that of the samples where they come from."""
        return self.label

    def __contains__(self, name: object) -> bool:
        return name == LOS

    def __getitem__(self, name: str) -> Topic:
        if name != LOS:
            raise BagError(f"{self.path}: topic must be {LOS}, got {name!r}")
        return self.topic


@dataclass(frozen=True)
class Provenance:
    """Source of the samples of a line of sight.

    Attributes
    ----------
    path : of the file, or a name
    kind : ``bag``, ``CSV``, ``arrays`` ...
    label : name of the samples there: a topic, or columns
    schema : type of their messages; empty where there are none
    parameters : what is known of the run
    problems : defects, one sentence each
    """

    path: str | os.PathLike[str] = "series"
    kind: str = "arrays"
    label: str = "line of sight"
    schema: str = ""
    parameters: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    problems: Sequence[str] = ()


ARRAYS = Provenance()


def scale_of(unit: str | None) -> float:
    """Radians per unit.

    Raises
    ------
    ValueError
        No unit, or an unknown one.

    Examples
    --------
    >>> scale_of("mrad")
    0.001
    """
    if unit not in ANGLES:
        raise InputError(f"unit must be one of {', '.join(ANGLES)}, got {unit if unit is None else repr(unit)}")
    return ANGLES[unit]


def sampling_rate(rate: float | None) -> float | None:
    """Return the rate [Hz] where it is one.

    Raises
    ------
    ValueError
        Not positive and finite.
    """
    if rate is not None and not 0 < rate < np.inf:
        raise InputError(f"rate must be positive [Hz], got {rate:g}")
    return rate


def gridded(stamps: IntArray, rate: float) -> tuple[IntArray, BoolArray, tuple[str, ...]]:
    """Put stamps with jitter on the grid of a known sampling rate.

    Parameters
    ----------
    stamps : (n,) [ns]
    rate : [Hz]

    Returns
    -------
    stamps : (n,) [ns], multiples of the period after the first one
    kept : (n,) False where another sample has the same place on the grid
    problems : what was moved or left out

    Raises
    ------
    ValueError
        The stamps have another rate.
    """
    if stamps.size < 2:
        return stamps, np.ones(stamps.size, bool), ()
    mean_rate = (stamps.size - 1) / max(int(stamps.max() - stamps.min()), 1) * NANO
    typical = NANO / max(float(np.median(np.diff(np.sort(stamps)))), 1.0)
    if not 0.9 < mean_rate / rate < 1.1 and not 0.9 < typical / rate < 1.1:
        raise InputError(f"rate must match the samples, about {typical:.6g} Hz, got {rate:g} Hz")
    grid = time_grid((stamps - stamps.min()) / NANO)
    if grid is not None and abs(grid.period * rate - 1.0) * np.ptp(grid.place) > OUT_OF_STEP:
        raise InputError(
            f"rate must match the samples, {1 / grid.period:.9g} Hz by their times, got {rate:.9g} Hz: "
            "without one it is taken from the time stamps"
        )
    place = np.rint((stamps - stamps[0]) * (rate / NANO)).astype(np.int64)
    first = np.zeros(stamps.size, bool)
    first[np.unique(place, return_index=True)[1]] = True
    if (~first).sum() > FEW * stamps.size:
        raise InputError(
            f"rate must fit the stamps, got {rate:g} Hz, for which {(~first).sum()} of {stamps.size} samples fall "
            "on the same tick as another one"
        )
    moved = int((np.abs(stamps - stamps[0] - place * (NANO / rate)) * rate > OFF_GRID * NANO).sum())
    notes = (
        [f"{counted(moved, 'stamp')} moved to the grid of {rate:g} Hz by more than 2 % of the period"] if moved else []
    )
    if not first.all():
        notes.append(
            f"{counted(int((~first).sum()), 'sample')} excluded: another one is on the same tick of {rate:g} Hz"
        )
    return int(stamps[0]) + on_whole_ns(place, 1 / rate), first, tuple(notes)


def stamps_of(t: ArrayLike | None, n: int, rate: float | None) -> IntArray:
    """Stamps [ns] of samples at the times `t` [s], or one period apart where there are no times.

    Raises
    ------
    ValueError
        Neither times nor a rate, not one time for each sample, or a time that is not finite.
    """
    rate = sampling_rate(rate)
    if t is None:
        if rate is None:
            raise InputError("rate must be given where the samples have no times, got none")
        return np.asarray(ORIGIN + on_whole_ns(np.arange(n, dtype=np.int64), 1 / rate))
    times = np.asarray(t)
    if times.dtype.kind == "M":
        times = (times - times.min()) / np.timedelta64(1, "s") if times.size else times
    times = times.astype(float)
    if times.shape != (n,):
        raise InputError(f"t must be {n} times [s], got an array of shape {times.shape}")
    if not np.isfinite(times).all():
        raise InputError(f"t must be finite, got {int((~np.isfinite(times)).sum())} of {n} times that are not")
    if n and np.ptp(times) > LONGEST:
        raise InputError(f"t must be in seconds, got times over {np.ptp(times):g} s")
    since = times - times.min() if n else times
    return np.asarray(ORIGIN + np.rint(since * NANO).astype(np.int64))


def make_series(
    stamps: IntArray,
    xy: FloatArray,
    *,
    unit: str | None,
    rate: float | None = None,
    published: IntArray | None = None,
    provenance: Provenance = ARRAYS,
) -> Series:
    """Line of sight from stamps and samples.

    Parameters
    ----------
    stamps : (n,) [ns]
    xy : (n, 2 or 3) in `unit`; a third component is not used
    unit : one of `ANGLES`
    rate : sampling rate [Hz] to whose grid the stamps are moved; by default that of the stamps, where they have one but
        for rounding (2 % of the period)
    published : (n,) [ns]; by default the stamps
    provenance : where the samples come from

    Raises
    ------
    ValueError
        Unknown unit, another rate, samples that are not two components each, or that jump by a full turn.
    """
    values = np.asarray(xy, dtype=float)
    if values.ndim != 2 or values.shape[1] not in (2, 3) or len(values) != len(stamps):
        raise InputError(f"xy must have the shape ({len(stamps)}, 2), got {values.shape}")
    values, notes = _angles(values[:, :2] * scale_of(unit))
    # A direction from 0 to 360 degrees is no error: it jumps by a full turn
    with np.errstate(invalid="ignore"):
        turns = np.abs(np.abs(np.diff(values, axis=0)) - 2.0 * np.pi) < 0.01 * 2.0 * np.pi
    jumps = np.flatnonzero(turns.any(axis=1))
    if jumps.size:
        raise InputError(
            f"{provenance.label} must be the error of the line of sight, actual minus target, without a wrap, got a "
            f"step of a full turn after sample {int(jumps[0]) + 1}: write angles from -180 to 180 deg"
        )
    timing: TimeGrid | None = None
    period: float | None = None
    if sampling_rate(rate) is not None:
        assert rate is not None
        stamps, kept, moved = gridded(stamps, rate)
        stamps, values, notes = stamps[kept], values[kept], (*notes, *moved)
        published = None if published is None else published[kept]
        period = 1 / rate
    else:
        stamps, timing = regular(stamps)
        if timing is not None and timing.changes:
            raise InputError(
                f"times must have one sampling rate, got one that changes by {100.0 * timing.drift:.2g} %, "
                f"{1 / timing.period:.6g} Hz on average: resample them to a constant rate"
            )
        period = timing.period if timing is not None else None
    sent = (stamps if published is None else published).copy()
    topic = make_topic(LOS, provenance.schema, "rad", ("x", "y"), stamps.copy(), values, sent, period)
    about = {
        **provenance.parameters,
        "unit_of_the_samples": unit,
        "sampling_rate_hz": 1 / topic.period if len(topic) > 1 else 0.0,
    }
    about[SAMPLING] = str(timing) if timing is not None else f"{rate:g} Hz, given" if rate else "unknown"
    return Series(
        topic,
        Path(provenance.path),
        MappingProxyType(about),
        (*provenance.problems, *notes),
        kind=provenance.kind,
        label=provenance.label,
    )


def _angles(values: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Samples [rad] with NaN in place of what cannot be an angle, and a note of how many there were."""
    with np.errstate(invalid="ignore"):
        odd: BoolArray = np.asarray((np.abs(values) > LARGEST_ANGLE).any(axis=1))
    if not odd.any():
        return values, ()
    note = f"{counted(int(odd.sum()), 'sample')} infinite or above {LARGEST_ANGLE:g} rad: counted as missing"
    return np.where(odd[:, None], np.nan, values), (note,)


def series(
    t: ArrayLike | None,
    xy: ArrayLike,
    *,
    unit: str,
    rate: float | None = None,
    name: str = "series",
) -> Series:
    """Line of sight from arrays, for `summarise`, `judge` and `write_report`.

    Parameters
    ----------
    t : (n,) times [s] or ``datetime64``, or None with a `rate`
    xy : (n, 2 or 3) error of the line of sight, NaN where a sample is missing; **actual minus target**
    unit : rad, mrad, urad, nrad, deg, mdeg, arcmin, arcsec or mas
    rate : sampling rate [Hz]; times with jitter are moved to its grid
    name : shown in tables and report

    Raises
    ------
    ValueError
        Shapes, unit, times or rate do not fit.
    """
    values = np.asarray(xy, dtype=float)
    if values.ndim != 2:
        raise InputError(f"xy must have the shape (n, 2), got {values.shape}")
    return make_series(stamps_of(t, len(values), rate), values, unit=unit, rate=rate, provenance=Provenance(name))
