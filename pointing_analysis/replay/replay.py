"""Replay: drive an observer and a controller with the sensors of a bag, and compare with what the bag recorded.

Through the recorded controllers, the replay reproduces the recorded estimates and commands bit for bit: the proof
that the bag holds all that the loop saw. Through others it gives what they would have estimated and commanded on the
same sensors (open loop: the plant does not answer to the new commands).

This module imports no controller: `EstimatorCore` and `ControllerCore` are its interfaces.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from lftkit.support.counted_nouns import counted
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.read.mapped_arrays import GrowingArray, by_parts, common_rows, empty, parts
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import NANO, read_only
from pointing_analysis.read.unsent import unsent
from pointing_analysis.replay.gap_stepping import HOLD, GapStepper

Stamps = IntArray
REPORT = 5000
"""Ticks from one report of the progress of a replay to the next."""


@dataclass(frozen=True)
class LoopLayout:
    """Which topics the observer and the controller read, and which ones they write.

    Attributes
    ----------
    columns : topic -> columns of the joined samples of all sensors
    held : topics with samples at some ticks only, which may be lost
    observer : topics that make the measurement of the observer
    controller : topics that the controller measures, behind the estimate
    commands : topic -> columns of the command
    """

    columns: Mapping[str, slice]
    held: tuple[str, ...]
    observer: tuple[str, ...]
    controller: tuple[str, ...]
    commands: Mapping[str, slice]

    @property
    def size(self) -> int:
        """Number of joined values."""
        return int(max(columns.stop for columns in self.columns.values()))

    @property
    def command_size(self) -> int:
        """Length of the command."""
        return int(max(columns.stop for columns in self.commands.values()))

    def of(self, topics: Sequence[str]) -> IntArray:
        """Columns of some topics among the joined values, in their order."""
        return np.concatenate([np.arange(self.size)[self.columns[name]] for name in topics])


class EstimatorCore(Protocol):
    """Observer at run time, of a node as of a replay: a measurement (22,) to an estimate (2,) [rad]."""

    def step(self, measurement: FloatArray, out: FloatArray) -> None:
        """One tick: write the estimate into `out`; camera columns of `measurement` may be NaN."""

    def reset(self) -> None:
        """Back to the zero state."""


class ControllerCore(Protocol):
    """Controller at run time: an estimate (2,) [rad] and an acceleration (6,) to a command (8,) [rad, N].

    Values of further sensors are behind the acceleration, forces of further actuators behind the command.
    """

    def step(self, los_estimate: FloatArray, accel_Ip: FloatArray, out: FloatArray) -> None:
        """One tick: write the command into `out`."""

    def reset(self) -> None:
        """Back to the zero state."""


@dataclass(frozen=True)
class Sensors:
    """Sensors of a run, joined by stamp.

    Attributes
    ----------
    stamp : (n,) [ns], ticks on which every sensor is there
    measurement : (n, layout.size) in the order of the layout; columns that are held NaN between frames and on dropped
        frames
    period : tick [ns]
    incomplete : ticks left out because a sensor is missing in the bag
    """

    stamp: Stamps
    measurement: FloatArray
    period: int
    incomplete: int


@dataclass(frozen=True)
class Replayed:
    """Estimates and commands of a replay.

    Attributes
    ----------
    stamp : (n,) ticks of the estimates [ns]
    estimate : (n, 2) [rad]
    command_stamp : (m,) ticks of the commands [ns]
    command : (m, layout.command_size) mirror angles [rad] and actuator forces [N]
    layout : topics that were read and written
    sampled : (k,) ticks on which every sensor is recorded [ns]
    """

    stamp: Stamps
    estimate: FloatArray
    command_stamp: Stamps
    command: FloatArray
    layout: LoopLayout
    sampled: Stamps = field(default_factory=lambda: np.zeros(0, np.int64))

    def topics(self) -> dict[str, tuple[Stamps, FloatArray]]:
        """Stamps and values by topic name, ready to be written into a bag."""
        signals = {"los_estimate": (self.stamp, self.estimate)}
        for name, columns in self.layout.commands.items():
            signals[name] = (self.command_stamp, self.command[:, columns])
        return signals


@dataclass(frozen=True)
class LawChanges:
    """Changes of the settings of an observer or a controller during a run.

    Attributes
    ----------
    applied : tick from its first one on, and what the change calls before the step of that tick; ascending
    fade : scales the outputs (k, p) of ticks without a change between them, in place
    """

    applied: tuple[tuple[int, Callable[[], None]], ...] = ()
    fade: Callable[[FloatArray], None] = lambda outputs: None


UNCHANGED = LawChanges()


def _complete_ticks(run: Run, layout: LoopLayout) -> tuple[Stamps, int, int]:
    """Stamps on which every sensor is there, the tick [ns], and how many ticks lack a sensor."""
    for name, columns in layout.columns.items():
        if name not in run:
            raise BagError(f"{run.path}: for a replay the bag must hold the topic {name}, got {', '.join(run.topics)}")
        if run[name].values.shape[1] < columns.stop - columns.start:
            raise BagError(f"{run.path}: {name}: messages must have {columns.stop - columns.start} values or more")
    fast = [run[name] for name in layout.columns if name not in layout.held]
    stamp = fast[0].stamp
    for topic in fast[1:]:
        common = GrowingArray(None, np.int64)
        for rows, _ in common_rows(stamp, topic.stamp):
            common.append(stamp[rows])
        stamp = common.array()
    if not stamp.size:
        raise BagError(f"{run.path}: the sensors must have common stamps, got none")
    for camera in (run[name] for name in layout.held):
        frame = round(camera.period * NANO) if len(camera) > 1 else 0
        if not frame:
            continue
        # A frame that is due and not in the bag: the node never saw this tick complete, or the bag lacks the frame.
        kept = GrowingArray(None, np.int64)
        for part in parts(len(stamp)):
            ticks = stamp[part]
            due = (ticks % frame == camera.stamp[0] % frame) & (ticks >= camera.stamp[0])
            kept.append(ticks[~due | np.isin(ticks, camera.stamp)])
        stamp = kept.array()
    period = round(fast[0].period * NANO)
    first, last = min(int(topic.stamp[0]) for topic in fast), max(int(topic.stamp[-1]) for topic in fast)
    never_sent = min(unsent(run, topic.name) for topic in fast)
    return read_only(stamp), period, max((last - first) // period + 1 - never_sent - len(stamp), 0)


def sensors(run: Run, layout: LoopLayout) -> Sensors:
    """Join the sensors of a run by stamp.

    Parameters
    ----------
    run : with the sensor topics
    layout : which topics these are

    Raises
    ------
    BagError
        A sensor topic is missing, has another number of values, or values that are not finite, except held ones.
    """
    stamp, period, incomplete = _complete_ticks(run, layout)
    measurement = empty((len(stamp), layout.size))
    for part in parts(len(stamp)):
        measurement[part] = np.nan
    for name, columns in layout.columns.items():
        topic = run[name]
        for rows, source in common_rows(stamp, topic.stamp):
            values = topic.values[source, : columns.stop - columns.start]
            odd = ~np.isfinite(values).all(axis=1)
            if odd.any() and name not in layout.held:
                seconds = (stamp[rows[odd][0]] - stamp[0]) / NANO
                raise BagError(
                    f"{run.path}: for a replay the samples of {name} must be finite, got {values[odd][0]} "
                    f"{seconds:.3f} s after the first tick"
                )
            measurement[rows, columns] = values
    return Sensors(stamp, read_only(measurement), period, incomplete)


def _ticks(stamp: Stamps, done: Stamps | None) -> IntArray:
    """Rows to step on: those the node acted on, as far as the bag tells; all of them if it tells nothing."""
    kept = GrowingArray(None, np.int64)
    for part in parts(len(stamp)):
        rows = np.arange(part.start, part.stop)
        kept.append(rows if done is None or not done.size else rows[_is_in(stamp[part], done)])
    return kept.array()


def _is_in(stamp: Stamps, done: Stamps) -> BoolArray:
    low, high = np.searchsorted(done, (stamp[0], stamp[-1] + 1))
    return np.isin(stamp, done[low:high])


def replay(
    run: Run,
    estimator: EstimatorCore,
    controller: ControllerCore,
    layout: LoopLayout,
    progress: Callable[[int, int], None] = lambda done, total: None,
    changes: tuple[LawChanges, LawChanges] = (UNCHANGED, UNCHANGED),
) -> Replayed:
    """Step observer and controller on the sensors of a run, as the nodes do, from the zero state.

    Both are stepped on the ticks for which the bag holds an estimate (a command): over a tick that a node missed they
    step as the node did, on samples by the bag's setting ``lost_samples`` (``hold`` in a bag without it).

    Parameters
    ----------
    run : with the sensor topics
    estimator, controller : both are reset first
    layout : topics that are read and written
    progress : called with (ticks done, all ticks) every :data:`REPORT` ticks
    changes : of observer and controller
    """
    sensed, observed, measured = sensors(run, layout), layout.of(layout.observer), layout.of(layout.controller)
    recorded = run["los_estimate"].stamp if "los_estimate" in run else None
    rows = _ticks(sensed.stamp, recorded)
    stamp = _rows_of(sensed.stamp, rows)
    total = 2 * len(stamp)
    estimator.reset()
    fill = str(run.parameters.get("lost_samples", HOLD))
    held = np.flatnonzero(np.isin(observed, layout.of(layout.held)))
    step = GapStepper(estimator.step, observed.size, held, fill, getattr(estimator, "steps", None))
    estimate = _stepped(
        lambda part: sensed.measurement[rows[part][:, None], observed],
        step,
        stamp,
        sensed.period,
        2,
        lambda i: progress(i, total),
        changes[0],
    )
    acted = _ticks(stamp, run["fsm/command"].stamp if "fsm/command" in run else None)
    command_stamp = _rows_of(stamp, acted)
    controller.reset()
    in_rows = getattr(controller, "steps", None)
    step = GapStepper(
        lambda sample, out: controller.step(sample[:2], sample[2:], out),
        2 + measured.size,
        fill=fill,
        in_rows=None if in_rows is None else lambda samples: in_rows(samples[:, :2], samples[:, 2:]),
    )
    command = _stepped(
        lambda part: np.hstack([estimate[acted[part]], sensed.measurement[rows[acted[part]][:, None], measured]]),
        step,
        command_stamp,
        sensed.period,
        layout.command_size,
        lambda i: progress(len(stamp) + i, total),
        changes[1],
    )
    progress(total, total)
    outputs = read_only(stamp), read_only(estimate), read_only(command_stamp), read_only(command)
    return Replayed(*outputs, layout, sensed.stamp)


def _rows_of(stamp: Stamps, rows: IntArray) -> Stamps:
    return by_parts(lambda part: stamp[part], rows, dtype=np.int64)


def _stepped(
    samples: Callable[[slice], FloatArray],
    stepper: GapStepper,
    stamp: Stamps,
    period: int,
    width: int,
    progress: Callable[[int], None],
    changes: LawChanges,
) -> FloatArray:
    """Outputs (n, width) of a block that is stepped on samples, which are made part by part."""
    outputs, waiting = empty((len(stamp), width)), list(changes.applied)
    for part in parts(len(stamp)):
        # Ticks missing before each one of a part
        before = stamp[part.start - 1] if part.start else stamp[0] - period
        inputs, out, gaps = (
            samples(part),
            np.zeros((part.stop - part.start, width)),
            np.diff(stamp[part], prepend=before) // period - 1,
        )
        ticks = (stamp[part] - stamp[0]) // period
        changed = np.searchsorted(ticks, [tick for tick, _ in waiting])
        edges = sorted({*range(0, len(out), REPORT), *changed.tolist(), len(out)})
        for first, last in itertools.pairwise(edges):
            while waiting and waiting[0][0] <= ticks[first]:
                waiting.pop(0)[1]()
            stepper.rows(inputs[first:last], gaps[first:last], out[first:last])
            changes.fade(out[first:last])
            progress(part.start + first)
        outputs[part] = out
    return outputs


@dataclass(frozen=True)
class Difference:
    """Replay against recording, for one topic.

    Attributes
    ----------
    topic : name
    compared : ticks in both
    different : ticks of those that differ in at least one bit
    missing : ticks that only one of the two has
    first : time of the first difference after the first stamp of the recording [s]; None without one
    largest : largest absolute difference, unit of the topic; infinite where one of two values is not a number
    """

    topic: str
    compared: int
    different: int
    missing: int
    first: float | None
    largest: float

    @property
    def identical(self) -> bool:
        """Same ticks, bit-identical values."""
        return self.compared > 0 and self.different == 0 and self.missing == 0


@dataclass(frozen=True)
class Comparison:
    """Replay against recording.

    Attributes
    ----------
    differences : one per topic
    incomplete : ticks that could not be replayed because a sensor is missing in the bag
    """

    differences: tuple[Difference, ...]
    incomplete: int

    @property
    def identical(self) -> bool:
        """Whether the replay is bit-identical to the recording."""
        return bool(self.differences) and all(d.identical for d in self.differences)

    def __str__(self) -> str:
        if self.identical:
            ticks = min(d.compared for d in self.differences)
            return f"replay bit-identical to the recording on {ticks} ticks"
        parts = []
        for d in self.differences:
            if d.identical:
                parts.append(f"{d.topic}: identical on {d.compared} ticks")
            else:
                begin = "" if d.first is None else f", first after {d.first:.3f} s, largest {d.largest:.3g}"
                alone = f"; {counted(d.missing, 'tick')} in one of the two only" if d.missing else ""
                parts.append(f"{d.topic}: {d.different} of {d.compared} ticks differ{begin}{alone}")
        return "; ".join(parts) or "the bag holds neither estimates nor commands to compare with"


def compare(run: Run, replayed: Replayed) -> Comparison:
    """Compare a replay with the estimates and commands in the bag, by the bits of each number."""
    differences = []
    for name, (stamp, values) in replayed.topics().items():
        if name not in run or not len(run[name]):
            continue
        topic = run[name]
        compared, wrong, largest, first = 0, 0, 0.0, None
        for i, j in common_rows(stamp, topic.stamp):
            a = np.ascontiguousarray(values[i])
            b = np.ascontiguousarray(topic.values[j, : values.shape[1]])
            where = np.flatnonzero(np.any(a.view(np.int64) != b.view(np.int64), axis=1))
            if where.size and first is None:
                first = float((topic.stamp[j[where[0]]] - topic.stamp[0]) / NANO)
            compared, wrong = compared + len(i), wrong + int(where.size)
            apart = np.abs(a[where] - b[where])
            largest = max([largest, *np.where(np.isnan(apart), np.inf, apart).ravel().tolist()])
        lone = len(stamp) + len(topic) - 2 * compared
        differences.append(Difference(name, compared, wrong, lone, first, largest))
    return Comparison(tuple(differences), _complete_ticks(run, replayed.layout)[2])
