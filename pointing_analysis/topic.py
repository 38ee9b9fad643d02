"""One topic of a run as arrays on the time axis of its stamps, and what was wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointing_analysis.mcap_records import BagError

Floats = NDArray[np.float64]
NANO = 1_000_000_000


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array with writing switched off (arrays in frozen dataclasses are read-only)."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Integrity:
    """What a look at the stamps of one topic found.

    Attributes
    ----------
    messages : messages in the bag
    unstamped : messages with the stamp zero, left out: the plant sends them while it waits for the run to begin
    duplicates : messages whose stamp was there already
    conflicts : duplicates that say something else than the first: two publishers on one topic
    out_of_order : messages recorded after one with a later stamp
    missing : samples missing between the first and the last stamp
    gaps : (start, samples missing) of each gap, start in seconds after the topic's first stamp
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
    irregular: int
    nan: int
    other_rate: float


@dataclass(frozen=True)
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
    open_end : whether the recording was cut off and nothing says how much is missing at its end
    """

    name: str
    schema: str
    unit: str
    columns: tuple[str, ...]
    stamp: NDArray[np.int64]
    values: Floats
    published: NDArray[np.int64]
    period: float
    integrity: Integrity
    lost_before: int = 0
    lost_after: int = 0
    open_end: bool = False

    def __len__(self) -> int:
        return int(self.stamp.size)

    @property
    def time(self) -> Floats:
        """(n,) seconds since the topic's first stamp."""
        return (self.stamp - self.stamp[:1]) / NANO

    @property
    def span(self) -> int:
        """Periods from the first stamp to the last one, both counted."""
        steps = (int(self.stamp[-1]) - int(self.stamp[0])) / (self.period * NANO) if self.period > 0 else 0.0
        return round(steps) + 1 if len(self) else 0

    @property
    def grid_start(self) -> int:
        """Stamp [ns] of the first row of `on_grid`."""
        return int(self.stamp[0]) - round(self.lost_before * self.period * NANO)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays [byte]."""
        return self.stamp.nbytes + self.values.nbytes + self.published.nbytes


def _period_ns(stamp: NDArray[np.int64]) -> int:
    """Most frequent interval, jitter below 1 % of the median set aside; 0 with fewer than two stamps."""
    steps = np.diff(stamp)
    if not steps.size:
        return 0
    values, counts = np.unique(steps, return_counts=True)
    if counts.max() * 2 >= steps.size:
        return int(values[counts.argmax()])
    return int(np.median(steps))


def _other_rate(steps: NDArray[np.int64], period: int) -> float:
    """Share of intervals in stretches of 20 and more equal intervals that are not the period (two rates in one run)."""
    if not steps.size:
        return 0.0
    ratio = np.rint(steps / period).astype(np.int64)
    ratio = np.where(steps * 2 < period, 0, ratio)
    edges = np.flatnonzero(np.diff(ratio)) + 1
    starts, ends = np.append(0, edges), np.append(edges, ratio.size)
    runs = ends - starts
    return float(runs[(ratio[starts] != 1) & (runs >= 20)].sum() / ratio.size)


def _inspect(
    stamp: NDArray[np.int64], values: Floats, kept: NDArray[np.bool_], order: int, period: int, unstamped: int
) -> Integrity:
    first = np.maximum.accumulate(np.where(kept, np.arange(stamp.size), 0))
    again = ~kept
    differs = np.any(values[again] != values[first[again]], axis=1) if again.any() else np.zeros(0, bool)
    both_nan = np.isnan(values[again]).any(axis=1) if again.any() else differs
    unique = stamp[kept]
    steps = np.diff(unique)
    ticks = np.maximum(np.rint(steps / period), 1).astype(np.int64) if period else steps
    holes = np.flatnonzero(ticks > 1)
    return Integrity(
        messages=int(stamp.size) + unstamped,
        unstamped=unstamped,
        duplicates=int(again.sum()),
        conflicts=int((differs & ~both_nan).sum()),
        out_of_order=order,
        missing=int((ticks - 1).sum()),
        gaps=tuple((float((unique[i] - unique[0]) / NANO), int(ticks[i] - 1)) for i in holes[:1000]),
        irregular=int((np.abs(steps - ticks * period) * 50 > period).sum()),
        nan=int(np.isnan(values).any(axis=1).sum()),
        other_rate=_other_rate(steps, period) if period else 0.0,
    )


def make_topic(
    name: str,
    schema: str,
    unit: str,
    columns: tuple[str, ...],
    stamp: NDArray[np.int64],
    values: Floats,
    published: NDArray[np.int64],
) -> Topic:
    """Sort by stamp, keep the first of each stamp, and note all that was not in order."""
    real = stamp != 0
    unstamped = int(stamp.size - real.sum())
    if unstamped:
        stamp, values, published = stamp[real], values[real], published[real]
    late = int((stamp < np.maximum.accumulate(stamp)).sum()) if stamp.size else 0
    if late:
        order = np.argsort(stamp, kind="stable")
        stamp, values, published = stamp[order], values[order], published[order]
    kept = np.append(np.ones(min(stamp.size, 1), bool), np.diff(stamp) > 0)
    period = _period_ns(stamp[kept])
    integrity = _inspect(stamp, values, kept, late, period, unstamped)
    if not kept.all():
        stamp, values, published = stamp[kept], values[kept], published[kept]
    return Topic(
        name,
        schema,
        unit,
        columns,
        read_only(stamp),
        read_only(values),
        read_only(published),
        period / NANO if period else float("nan"),
        integrity,
    )


def on_grid(topic: Topic) -> tuple[Floats, float]:
    """Values on the uniform time axis of the topic's period, NaN where a sample is missing.

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
        raise BagError(f"{topic.name}: topic must have at least two samples, got {len(topic)}")
    if state.conflicts:
        raise BagError(
            f"{topic.name}: a bag must hold one plant, got two publishers on this topic: "
            f"{state.conflicts} stamps carry two different values"
        )
    if state.other_rate > 0.01:
        raise BagError(
            f"{topic.name}: topic must have one sampling rate, got another period than {1e3 * topic.period:g} ms in "
            f"{100 * state.other_rate:.0f} % of the run"
        )
    if state.irregular > 0.01 * len(topic):
        raise BagError(
            f"{topic.name}: stamps must be on a grid of {1e3 * topic.period:g} ms, not {state.irregular} others"
        )
    index = np.rint((topic.stamp - topic.stamp[0]) / (topic.period * NANO)).astype(np.int64)
    rows = int(index[-1]) + 1 + topic.lost_before + topic.lost_after
    if rows > 4 * len(topic) + 100_000:
        raise BagError(
            f"{topic.name}: recording must be continuous, got {len(topic)} samples in {rows * topic.period:g} s: "
            "the clock was stepped, or most samples are missing"
        )
    if rows == len(topic):
        return topic.values, topic.period
    grid = np.full((rows, topic.values.shape[1]), np.nan)
    grid[index + topic.lost_before] = topic.values
    return grid, topic.period
