"""Replay: drive an observer and a controller with the sensors of a bag, and compare with what the bag recorded.

Through the recorded controllers, the replay gives the recorded estimates and commands again, bit by bit: the proof
that the bag holds all that the loop saw. Through others it gives what they would have estimated and commanded on the
same sensors (open loop: the plant does not answer to the new commands).

This module imports no controller: `Estimator` and `Controller` say what one must have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pointing_analysis.gap_stepping import GapStepper
from pointing_analysis.mcap_records import BagError
from pointing_analysis.read import Run
from pointing_analysis.topic import NANO, read_only

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
#: topic -> columns of the measurement vector (22)
MEASUREMENT = {
    "isolator/accel": slice(0, 6),
    "m1/accel": slice(6, 12),
    "m2/accel": slice(12, 18),
    "camera/los": slice(18, 20),
    "fsm/strain_gauge": slice(20, 22),
}
#: topic -> columns of the command vector (8)
COMMAND = {"fsm/command": slice(0, 2), "pma/command": slice(2, 8)}
#: sizes of the two vectors, columns of the platform's accelerations and of the camera
MEASUREMENTS = max(columns.stop for columns in MEASUREMENT.values())
COMMANDS = max(columns.stop for columns in COMMAND.values())
PLATFORM, CAMERA = MEASUREMENT["isolator/accel"], MEASUREMENT["camera/los"]


class Estimator(Protocol):
    """Observer at run time, of a node as of a replay: a measurement (22,) to an estimate (2,) [rad]."""

    def step(self, measurement: Floats, out: Floats) -> None:
        """One tick: write the estimate into `out`; camera columns of `measurement` may be NaN."""

    def reset(self) -> None:
        """Back to the zero state."""


class Controller(Protocol):
    """Controller at run time: an estimate (2,) [rad] and an acceleration (6,) to a command (8,) [rad, N]."""

    def step(self, los_estimate: Floats, accel_Ip: Floats, out: Floats) -> None:
        """One tick: write the command into `out`."""

    def reset(self) -> None:
        """Back to the zero state."""


@dataclass(frozen=True)
class Sensors:
    """Sensors of a run, joined by stamp.

    Attributes
    ----------
    stamp : (n,) [ns], ticks on which every sensor is there
    measurement : (n, 22) in the order of `MEASUREMENT`; camera columns NaN between frames and on dropped frames
    period : tick [ns]
    incomplete : ticks left out because a sensor is missing in the bag
    """

    stamp: Stamps
    measurement: Floats
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
    command : (m, 8) mirror angles [rad] and actuator forces [N]
    """

    stamp: Stamps
    estimate: Floats
    command_stamp: Stamps
    command: Floats

    def topics(self) -> dict[str, tuple[Stamps, Floats]]:
        """Stamps and values by topic name, ready to be written into a bag."""
        found = {"los_estimate": (self.stamp, self.estimate)}
        for name, columns in COMMAND.items():
            found[name] = (self.command_stamp, self.command[:, columns])
        return found


def sensors(run: Run) -> Sensors:
    """Join the sensors of a run by stamp.

    Raises
    ------
    BagError
        A sensor topic is missing or has another number of values.
    """
    for name, columns in MEASUREMENT.items():
        if name not in run:
            raise BagError(f"{run.path}: for a replay the bag must hold the topic {name}, got {', '.join(run.topics)}")
        if run[name].values.shape[1] < columns.stop - columns.start:
            raise BagError(f"{run.path}: {name}: messages must have {columns.stop - columns.start} values or more")
    fast = [run[name] for name in MEASUREMENT if name != "camera/los"]
    stamp = fast[0].stamp
    for topic in fast[1:]:
        stamp = np.intersect1d(stamp, topic.stamp, assume_unique=True)
    if not stamp.size:
        raise BagError(f"{run.path}: the sensors must have common stamps, got none")
    camera = run["camera/los"]
    frame = round(camera.period * NANO) if len(camera) > 1 else 0
    if frame:
        # A frame that is due and not in the bag: the node never saw this tick complete, or the bag lacks the frame.
        due = (stamp % frame == camera.stamp[0] % frame) & (stamp >= camera.stamp[0])
        stamp = stamp[~due | np.isin(stamp, camera.stamp)]
    measurement = np.full((len(stamp), MEASUREMENTS), np.nan)
    for name, columns in MEASUREMENT.items():
        topic = run[name]
        _, rows, source = np.intersect1d(stamp, topic.stamp, assume_unique=True, return_indices=True)
        measurement[rows, columns] = topic.values[source, : columns.stop - columns.start]
    period = round(fast[0].period * NANO)
    longest = max(len(topic) for topic in fast)
    return Sensors(read_only(stamp.copy()), read_only(measurement), period, longest - len(stamp))


def _ticks(stamp: Stamps, done: Stamps | None) -> NDArray[np.int64]:
    """Rows to step on: those the node acted on, as far as the bag tells; all of them if it tells nothing."""
    if done is None or not done.size:
        return np.arange(len(stamp))
    return np.flatnonzero(np.isin(stamp, done))


def _gaps(stamp: Stamps, period: int) -> list[int]:
    """Ticks missing before each one."""
    return np.append(0, np.diff(stamp) // period - 1).tolist()  # type: ignore[no-any-return]


def replay(
    run: Run,
    estimator: Estimator,
    controller: Controller,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Replayed:
    """Step observer and controller on the sensors of a run, as the nodes do, from the zero state.

    Both are stepped on the ticks for which the bag holds an estimate (a command): over a tick that a node missed they
    step on held samples, as the node did.

    Parameters
    ----------
    run : with the sensor topics
    estimator, controller : both are reset first
    progress : called with (ticks done, all ticks) about every second of the run
    """
    given = sensors(run)
    recorded = run["los_estimate"].stamp if "los_estimate" in run else None
    rows = _ticks(given.stamp, recorded)
    stamp, measurement = given.stamp[rows], given.measurement[rows]
    total = 2 * len(stamp)
    estimate = np.zeros((len(stamp), 2))
    estimator.reset()
    step = GapStepper(estimator.step, MEASUREMENTS, CAMERA)
    for i, gap in enumerate(_gaps(stamp, given.period)):
        step(measurement[i], gap, estimate[i])
        if i % 1000 == 0:
            progress(i, total)
    acted = _ticks(stamp, run["fsm/command"].stamp if "fsm/command" in run else None)
    command_stamp = stamp[acted]
    command = _commands(controller, estimate[acted], measurement[acted, PLATFORM], _gaps(command_stamp, given.period))
    progress(total, total)
    return Replayed(read_only(stamp.copy()), read_only(estimate), read_only(command_stamp.copy()), read_only(command))


def _commands(controller: Controller, estimate: Floats, accel: Floats, gaps: list[int]) -> Floats:
    samples, command = np.hstack([estimate, accel]), np.zeros((len(estimate), COMMANDS))
    controller.reset()
    step = GapStepper(lambda sample, out: controller.step(sample[:2], sample[2:], out), samples.shape[1])
    for i, gap in enumerate(gaps):
        step(samples[i], gap, command[i])
    return command


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
    largest : largest absolute difference, unit of the topic
    """

    topic: str
    compared: int
    different: int
    missing: int
    first: float | None
    largest: float

    @property
    def identical(self) -> bool:
        """Same ticks, same bits."""
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
        """Whether the replay gave the recording again, bit by bit."""
        return bool(self.differences) and all(d.identical for d in self.differences)

    def __str__(self) -> str:
        if self.identical:
            ticks = min(d.compared for d in self.differences)
            return f"replay identical to the recording, bit by bit, on {ticks} ticks: the bag is complete"
        parts = []
        for d in self.differences:
            if d.identical:
                parts.append(f"{d.topic}: identical on {d.compared} ticks")
            else:
                begin = "" if d.first is None else f", first after {d.first:.3f} s, largest {d.largest:.3g}"
                parts.append(f"{d.topic}: {d.different} of {d.compared} ticks differ{begin}; {d.missing} ticks missing")
        return "; ".join(parts) or "the bag holds neither estimates nor commands to compare with"


def compare(run: Run, replayed: Replayed) -> Comparison:
    """Compare a replay with the estimates and commands in the bag, by the bits of each number."""
    found = []
    for name, (stamp, values) in replayed.topics().items():
        if name not in run or not len(run[name]):
            continue
        topic = run[name]
        _, i, j = np.intersect1d(stamp, topic.stamp, assume_unique=True, return_indices=True)
        a = np.ascontiguousarray(values[i])
        b = np.ascontiguousarray(topic.values[j, : values.shape[1]])
        wrong = np.any(a.view(np.int64) != b.view(np.int64), axis=1)
        where = np.flatnonzero(wrong)
        first = float((topic.stamp[j[where[0]]] - topic.stamp[0]) / NANO) if where.size else None
        largest = float(np.nanmax(np.abs(a - b))) if len(a) else 0.0
        lone = len(stamp) + len(topic) - 2 * len(i)
        found.append(Difference(name, len(i), int(wrong.sum()), lone, first, largest))
    return Comparison(tuple(found), sensors(run).incomplete)
