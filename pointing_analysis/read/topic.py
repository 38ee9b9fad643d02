"""One topic of a run as arrays on the time axis of its stamps, and what was wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.support.counted_nouns import counted
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, empty, parts
from pointing_analysis.read.mcap.records import BagError, ShortRunError
from pointing_analysis.read.time_grid import whole_period

NANO = 1_000_000_000
MANY_STEPS = 100_000  # different intervals of stamps that are counted one by one
OFF_GRID = 0.01  # largest share of intervals that may be off a grid


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array with writing switched off (arrays in frozen dataclasses are read-only)."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Integrity:
    """Properties of the stamps of one topic.

    Attributes
    ----------
    messages : messages in the bag
    unstamped : messages with the stamp zero, left out: the plant sends them while it waits for the run to begin
    duplicates : messages whose stamp was there already
    conflicts : duplicates that differ from the first: two publishers on one topic, or a clock that was set back
    out_of_order : messages recorded after one with a later stamp
    missing : samples missing between the first and the last stamp
    gaps : (start, samples missing) of the first 1000 gaps, start in seconds after the topic's first stamp
    gap_count : of all
    irregular : intervals that are no multiple of the period (2 % of it allowed)
    nan : messages with a value that is not a number (for a camera: a dropped frame)
    other_rate : share of the intervals that belong to stretches at another constant rate
    """

    messages: int
    unstamped: int
    duplicates: int
    conflicts: int
    out_of_order: int
    missing: int
    gaps: tuple[tuple[float, int], ...]
    gap_count: int
    irregular: int
    nan: int
    other_rate: float


@dataclass(frozen=True, eq=False)
class Topic:
    """Messages of one topic, sorted by stamp, each stamp once.

    Attributes
    ----------
    name : name without the namespace, e.g. ``truth/los``
    schema : ROS message type
    unit : unit of the values
    columns : names of the values
    stamp : (n,) header stamps [ns], strictly increasing
    values : (n, k) in the order of `columns`
    published : (n,) time at which the publisher sent the message [ns]; that of recording where the recorder did not
        know it
    period : sampling period [s]: the most frequent distance of two stamps; NaN with fewer than two messages
    integrity : gaps, duplicates and the like
    lost_before, lost_after : samples that were recorded, or were to be, before the first stamp and after the last one,
        and are not in the bag
    unsent_after : periods behind them without a sample, see :class:`pointing_analysis.read.run_end.RunEnd`
    open_end : whether the recording is truncated and the missing part at its end is unknown
    """

    name: str
    schema: str
    unit: str
    columns: tuple[str, ...]
    stamp: IntArray
    values: FloatArray
    published: IntArray
    period: float
    integrity: Integrity
    lost_before: int = 0
    lost_after: int = 0
    unsent_after: int = 0
    open_end: bool = False

    def __len__(self) -> int:
        return int(self.stamp.size)

    @property
    def time(self) -> FloatArray:
        """(n,) seconds since the topic's first stamp."""
        return by_parts(lambda stamp: (stamp - self.stamp[:1]) / NANO, self.stamp)

    @property
    def span(self) -> int:
        """Periods from the first stamp to the last one, both counted."""
        steps = (int(self.stamp[-1]) - int(self.stamp[0])) / (self.period * NANO) if self.period > 0 else 0.0
        return round(steps) + 1 if len(self) else 0

    @property
    def absent_after(self) -> int:
        """Rows of `on_grid` behind the last sample."""
        return self.lost_after + self.unsent_after

    @property
    def grid_start(self) -> int:
        """Stamp [ns] of the first row of `on_grid`."""
        return int(self.stamp[0]) - round(self.lost_before * self.period * NANO)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays [byte]."""
        return self.stamp.nbytes + self.values.nbytes + self.published.nbytes


def _steps(stamp: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Intervals of stamps, in parts, with the index of the first stamp of each."""
    for part in parts(max(len(stamp) - 1, 0)):
        yield part.start, np.diff(stamp[part.start : part.stop + 1])


def _period_ns(stamp: IntArray) -> int:
    """Most frequent interval, ignoring jitter below 1 % of the median; 0 with fewer than two stamps."""
    if stamp.size < 2:
        return 0
    counts: Counter[int] = Counter()
    for _, steps in _steps(stamp):
        values, times = np.unique(steps, return_counts=True)
        counts.update(dict(zip(values.tolist(), times.tolist())))
        if len(counts) > MANY_STEPS:
            break
    period = min(counts, key=lambda step: (-counts[step], step))
    if len(counts) <= MANY_STEPS and counts[period] * 2 >= stamp.size - 1:
        return period
    return int(SortedValues(np.concatenate([steps.astype(float) for _, steps in _steps(stamp)])).quantile(0.5))


class _OtherRate:
    """Intervals in stretches of 20 and more equal intervals that are not the period (two rates in one run)."""

    def __init__(self, period: float) -> None:
        self.period, self.total, self.count = period, 0, 0
        self._last, self._length = 1, 0

    def add(self, steps: IntArray) -> None:
        ratio = np.where(steps * 2 < self.period, 0, np.rint(steps / self.period).astype(np.int64))
        edges = np.flatnonzero(np.diff(ratio)) + 1
        starts, ends = np.append(0, edges), np.append(edges, ratio.size)
        values, runs = ratio[starts], ends - starts
        if values[0] == self._last:
            runs[0] += self._length
        else:
            self._end_stretch()
        self._last, self._length = int(values[-1]), int(runs[-1])
        self.count += int(runs[:-1][(values[:-1] != 1) & (runs[:-1] >= 20)].sum())
        self.total += int(ratio.size)

    def _end_stretch(self) -> None:
        self.count += self._length if self._last != 1 and self._length >= 20 else 0

    def share(self) -> float:
        """Of all intervals; to be asked for once, at the end."""
        self._end_stretch()
        return self.count / self.total if self.total else 0.0


def _repeated(stamp: IntArray, values: FloatArray, kept: BoolArray) -> int:
    """Number of messages that differ from the first one of the same stamp."""
    again = np.flatnonzero(~kept)
    if not again.size:
        return 0
    first = np.searchsorted(stamp, stamp[again])
    differs = np.any(values[again] != values[first], axis=1)
    return int((differs & ~np.isnan(values[again]).any(axis=1)).sum())


def _inspect(stamp: IntArray, period: float, counts: Mapping[str, int]) -> Integrity:
    """Look at unique stamps; `counts` are the counts of what was sorted out before."""
    other, missing, irregular, gap_count = _OtherRate(period), 0, 0, 0
    gaps: list[tuple[float, int]] = []
    for begin, steps in _steps(stamp):
        ticks = np.maximum(np.rint(steps / period), 1).astype(np.int64) if period else steps
        missing += int((ticks - 1).sum())
        irregular += int((np.abs(steps - ticks * period) * 50 > period).sum())
        holes = np.flatnonzero(ticks > 1)
        gap_count += holes.size
        first = holes[: 1000 - len(gaps)].tolist()
        gaps += [(float((stamp[begin + i] - stamp[0]) / NANO), int(ticks[i] - 1)) for i in first]
        if period:
            other.add(steps)
    return Integrity(
        missing=missing,
        gaps=tuple(gaps),
        gap_count=gap_count,
        irregular=irregular,
        other_rate=other.share(),
        **counts,
    )


def _count_late(stamp: IntArray) -> int:
    """Messages behind one with a later stamp."""
    late, latest = 0, np.iinfo(np.int64).min
    for part in parts(len(stamp)):
        newest = np.maximum(np.maximum.accumulate(stamp[part]), latest)
        late += int((stamp[part] < newest).sum())
        latest = newest[-1]
    return late


def _chosen(rows: NDArray[Any], *arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Rows of arrays, by a mask or by indices."""
    index = np.flatnonzero(rows) if rows.dtype == bool else rows
    return tuple(by_parts(lambda i, array=array: array[i], index, dtype=array.dtype) for array in arrays)


def make_topic(
    name: str,
    schema: str,
    unit: str,
    columns: tuple[str, ...],
    stamp: IntArray,
    values: FloatArray,
    published: IntArray,
    period: float | None = None,
) -> Topic:
    """Sort by stamp, keep the first of each stamp, and note all that was not in order.

    `period` is that of the grid on which the stamps are [s], where it is known: it need not be a whole number of ns.
    """
    messages = int(stamp.size)
    real = by_parts(lambda part: part != 0, stamp, dtype=bool)
    if not real.all():
        stamp, values, published = _chosen(real, stamp, values, published)
    counts = {"messages": messages, "unstamped": messages - int(stamp.size), "out_of_order": _count_late(stamp)}
    if counts["out_of_order"]:
        stamp, values, published = _chosen(np.argsort(stamp, kind="stable"), stamp, values, published)
    kept = np.concatenate([np.ones(min(stamp.size, 1), bool), *(steps > 0 for _, steps in _steps(stamp))])
    nan = sum(int(np.isnan(values[part]).any(axis=1).sum()) for part in parts(len(values)))
    counts |= {"duplicates": int((~kept).sum()), "conflicts": _repeated(stamp, values, kept), "nan": nan}
    if not kept.all():
        stamp, values, published = _chosen(kept, stamp, values, published)
    step = _period_ns(stamp) if period is None or len(stamp) < 2 else whole_period(period)
    integrity = _inspect(stamp, step, counts)
    return Topic(
        name,
        schema,
        unit,
        columns,
        read_only(stamp),
        read_only(values),
        read_only(published),
        step / NANO if step else float("nan"),
        integrity,
    )


def on_grid(topic: Topic, off_grid: float = OFF_GRID) -> tuple[FloatArray, float]:
    """Values on the uniform time axis of the topic's period, NaN where a sample is missing.

    Parameters
    ----------
    topic : Topic
    off_grid : float
        Largest share of intervals that may differ from a multiple of the period by more than 2 % of it: their samples
        go to the nearest time of the grid.

    Returns
    -------
    values : (m, k), row i at the time i * period after `Topic.grid_start`; samples that were lost before the first
        stamp and after the last one are rows, too
    period : [s]

    Raises
    ------
    BagError
        Two sampling rates, two publishers, irregular stamps, a jump of the clock, or fewer than two samples.
    """
    state = topic.integrity
    if len(topic) < 2:
        raise ShortRunError(f"{topic.name}: topic must have at least two samples, got {len(topic)}")
    if state.conflicts:
        raise BagError(
            f"{topic.name}: each stamp must have one value, got {state.conflicts} with two "
            "(two publishers on the topic, or the clock was set back)"
        )
    if state.other_rate > 0.01:
        raise BagError(
            f"{topic.name}: topic must have one sampling rate, got another period than {1e3 * topic.period:g} ms in "
            f"{100 * state.other_rate:.0f} % of the run"
        )
    if state.irregular > off_grid * len(topic):
        raise BagError(
            f"{topic.name}: stamps must be on a grid of {1e3 * topic.period:g} ms ({1.0 / topic.period:.6g} Hz), got "
            f"{counted(state.irregular, 'interval')} off it "
            "(with a known sampling rate, --rate HZ moves them to its grid)"
        )
    rows = int(_grid_index(topic, topic.stamp[-1:])[0]) + 1 + topic.lost_before + topic.absent_after
    if rows - topic.unsent_after > 4 * len(topic) + 100_000:
        raise BagError(
            f"{topic.name}: recording must be continuous, got {len(topic)} samples in {rows * topic.period:g} s: "
            "the clock was stepped, or most samples are missing"
        )
    if rows == len(topic):
        return topic.values, topic.period
    grid = empty((rows, topic.values.shape[1]))
    for part in parts(rows):
        grid[part] = np.nan
    for part in parts(len(topic)):
        grid[_grid_index(topic, topic.stamp[part]) + topic.lost_before] = topic.values[part]
    return grid, topic.period


def _grid_index(topic: Topic, stamp: IntArray) -> IntArray:
    return np.asarray(np.rint((stamp - topic.stamp[0]) / (topic.period * NANO)).astype(np.int64))
