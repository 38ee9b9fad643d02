"""Supervisor of a device: life cycle, silent and frozen sensors, limits, ages, one error for all."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.config.plugins import RAISED, in_one_line
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import (
    ACTIVE,
    ERROR,
    FINALIZED,
    INACTIVE,
    TRUTH_PORT,
    UNCONFIGURED,
    Device,
    DeviceError,
    Sample,
)
from los_testbed.run.loop.latency_histogram import LatencyHistogram, text_of_shares
from titop_plant.interface import COLUMNS, COMMANDS, FRAMED, MEASURED, MEASUREMENTS, MIRROR, TICK_NS

EVERY_TICK = tuple(name for name in MEASURED if name not in FRAMED)
"""Ports of the sensors that have a sample at every tick."""

PATIENCE_TICKS = 100
"""Ticks after hold and fade that a device may be silent before the run is ended."""

SPARE_TICKS = 200
"""Ticks after which an unused sample in reserve for a tick without one is dropped."""

FROZEN_TICKS = 200
"""Ticks with equal samples after which a sensor is frozen: each has noise of more than a bit."""

FROZEN_FRAMES = 25
"""The same of a slower sensor, half a second of the usual camera. With noise (rms) of half a step of its rounding or
more, both values are as before in less than half of the frames at rest, and in 25 in a row once in 1e8."""

FROZEN = {**dict.fromkeys((*EVERY_TICK, TRUTH_PORT), FROZEN_TICKS), **dict.fromkeys(FRAMED, FROZEN_FRAMES)}
"""Equal samples after which a port is frozen. The true line of sight may be without noise, and at rest: of it only
samples count before which the mirror was given another command."""

IMPOSSIBLE_TIME = "impossible_time_"
"""Count of the rejected samples of a port: acquired in the future, or before this host was started. A clock that was
set gives such times until it is tracked again; a stamp in the far future would make all later ones late."""


NOT_FINITE = "not_finite_"
"""Count of the samples of a port that were refused for a value; frames without values are none of them."""


class Supervisor:
    """A supervised device with its state for the loop.

    Parameters
    ----------
    device : Device
    config : RunConfig

    Notes
    -----
    Samples of sensors that come at every tick have the stamp of the tick that they are used in; their age is counted.
    If two have come, one is kept in reserve for the next tick: their clock is not the loop's. Frames of slower
    sensors keep the time of their acquisition.
    """

    def __init__(self, device: Device, config: RunConfig) -> None:
        self.device = device
        self.frame_ticks = config.frame_ticks
        self.state = UNCONFIGURED
        self.fault = ""
        self._config = config
        self._limit_ticks = config.hold_ticks + config.fade_ticks + PATIENCE_TICKS
        self._ended = False
        self._failures: dict[str, str] = {}
        self._notes: Mapping[str, Any] = {}
        self._mirror, self._moved = np.zeros(MIRROR.stop - MIRROR.start), False
        self._begin_counts()

    def _begin_counts(self) -> None:
        """State of a run."""
        self.counts: Counter[str] = Counter()
        self.age = LatencyHistogram()
        self.delay = LatencyHistogram()
        self.measurement = np.full(MEASUREMENTS, np.nan)
        self.frames: list[Sample] = []
        self._silent = dict.fromkeys(EVERY_TICK, 0)
        self._odd_before = dict.fromkeys(EVERY_TICK, 0)
        """Values that were not finite up to the last sample that was used."""
        self._written_ns = self.acquired_ns = 0
        self._equal = dict.fromkeys(FROZEN, 0)
        self._last: dict[str, bytes] = {}
        self._queues: dict[str, deque[Sample]] = {port: deque() for port in (*EVERY_TICK, TRUTH_PORT)}
        self._unused = dict.fromkeys((*EVERY_TICK, TRUTH_PORT), 0)

    def reset(self) -> None:
        """Reset all counts for a run, also those of a driver that has `begin_counts`.

        The rig itself is not reset.
        """
        self._begin_counts()
        if callable(begin := getattr(self.device, "begin_counts", None)):
            self._call("begin_counts", begin)

    def open(self) -> None:
        """Configure the device; its actuators stay at zero.

        Raises
        ------
        ValueError
            It cannot be opened.
        """
        try:
            self.device.open(self._config)
        except RAISED as error:
            self.state = ERROR
            raise InputError(f"device {self._config.device} must open, got {in_one_line(error)}") from error
        self.state = INACTIVE

    def write(self, command: FloatArray, now_ns: int) -> None:
        """Apply the command (8,) of a tick; the first one activates the device."""
        self.state, self._written_ns = ACTIVE, now_ns
        self._moved = bool(np.any(command[MIRROR] != self._mirror))
        self._mirror[:] = command[MIRROR]
        self._call("write", self.device.write, command.copy(), now_ns)

    def answered(self, acquired_ns: int) -> None:
        """Record the time of the samples from which the last written command was computed."""
        self.delay.add(max(0, self._written_ns - acquired_ns))

    def read(self, now_ns: int) -> bool:
        """Read the samples up to the deadline `now_ns` (steady clock); whether all sensors of a tick have one.

        Raises
        ------
        DeviceError
            The device failed, or a sensor is silent for too long or frozen.
        """
        self.frames = []
        fresh = set()
        self.acquired_ns = now_ns
        for sample in self.samples(now_ns):
            if sample.port in FRAMED:
                self.frames.append(sample)
            else:
                self._queues[sample.port].append(sample)
        if (truth := self._next(TRUTH_PORT)) is not None:
            self.frames.append(truth)
        for port in EVERY_TICK:
            if (found := self._next(port)) is not None:
                fresh.add(port)
                self.measurement[COLUMNS[port]] = found.values
                self.age.add(max(0, now_ns - found.acquired_ns))
                self.acquired_ns = min(self.acquired_ns, found.acquired_ns)
            self._silent[port] = 0 if port in fresh else self._silent[port] + 1
            if port in fresh:
                self._odd_before[port] = self.counts[f"{NOT_FINITE}{port}"]
            if port not in fresh:
                self.counts[f"absent_{port}"] += 1
        self._watch()
        return len(fresh) == len(EVERY_TICK)

    def samples(self, now_ns: int) -> list[Sample]:
        """All usable new samples of the device."""
        came = self._call("read", self.device.read, now_ns)
        latest_ns = max(now_ns, time.monotonic_ns()) + TICK_NS
        return [sample for sample in came if self._fits(sample, latest_ns)]

    def _next(self, port: str) -> Sample | None:
        """Sample of a tick: the oldest of those that wait, of which one is kept in reserve.

        Samples around the deadline come twice in one tick and not at all in the next. One that stays unused too long
        is dropped.
        """
        queue = self._queues[port]
        spare = len(queue) > 1
        self._unused[port] = self._unused[port] + 1 if spare else 0
        most = 1 if self._unused[port] > SPARE_TICKS else 2
        while len(queue) > most:
            queue.popleft()
            self.counts[f"surplus_{port}"] += 1
        return queue.popleft() if queue else None

    def _fits(self, sample: Sample, latest_ns: int) -> bool:
        """Whether a sample can be used; a frozen one is noted."""
        columns = COLUMNS.get(sample.port)
        values = np.asarray(sample.values, float)
        if columns is None or values.shape != (columns.stop - columns.start,):
            raise self.failed(f"read must give samples of known ports, got {sample.port} {values.shape}")
        if not 0 <= sample.acquired_ns <= latest_ns:
            self.counts[f"{IMPOSSIBLE_TIME}{sample.port}"] += 1
            return False
        if not all(map(math.isfinite, values.tolist())):
            if sample.port in FRAMED:  # a frame without a star
                return True
            self.counts[f"{NOT_FINITE}{sample.port}"] += 1
            return False
        data = values.tobytes()
        if data != self._last.get(sample.port):
            self._equal[sample.port] = 0
        elif self._moved or sample.port != TRUTH_PORT:
            self._equal[sample.port] += 1
        self._last[sample.port] = data
        return True

    def _watch(self) -> None:
        """Raise where a sensor is silent for too long, or frozen."""
        silent = {port: ticks for port, ticks in self._silent.items() if ticks > self._limit_ticks}
        odd = [port for port in silent if self.counts[f"{NOT_FINITE}{port}"] > self._odd_before[port]]
        quiet = [port for port in silent if port not in odd]
        if len(quiet) == len(self._silent):
            raise self.failed(f"no sample for {self._limit_ticks} ms")
        if silent:
            what = ", ".join(
                f"{', '.join(ports)} {how}" for ports, how in ((odd, "not finite"), (quiet, "silent")) if ports
            )
            raise self.failed(f"{what} for {self._limit_ticks} ms")
        for samples in (FROZEN_TICKS, FROZEN_FRAMES):
            frozen = [port for port, most in FROZEN.items() if most == samples and self._equal[port] > most]
            if frozen:
                raise self.failed(f"{', '.join(frozen)} frozen for {samples} samples")

    def _call(self, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except RAISED as error:
            raise self.failed(f"{name} failed: {in_one_line(error)}") from error

    def failed(self, text: str) -> DeviceError:
        """Error of a faulty device. The device is closed: the error says whether it is at zero."""
        self.fault, self.state = self.fault or text, ERROR
        self.end()
        return self._error()

    def _error(self) -> DeviceError:
        not_zero = ", ".join(self._failures[name] for name in ("write", "safe") if name in self._failures)
        rest = [text for name, text in self._failures.items() if name not in ("write", "safe")]
        zero = f"could NOT be set to zero: {not_zero}" if not_zero else "were set to zero"
        parts = [*([self.fault] if self.fault else []), *rest, f"mirror and forces {zero}"]
        return DeviceError(f"device {self._config.device}: {'; '.join(parts)}")

    def end(self) -> tuple[str, ...]:
        """Set the actuators to zero and close the device, once and in any state; the failures."""
        if not self._ended and self.state != UNCONFIGURED:
            self._ended = True
            self._try("write", lambda: self.device.write(np.zeros(COMMANDS), time.monotonic_ns()))
            self._try("safe", self.device.safe)
            self._try("notes", self._note)  # a driver need not have any when it is closed
            self._try("close", self.device.close)
            self.state = ERROR if self.fault or self._failures else FINALIZED
        return tuple(self._failures.values())

    def finish(self) -> None:
        """The same as :meth:`end`, where its failures are an error.

        Raises
        ------
        DeviceError
            The actuators could not be set to zero, or the device not be closed.
        """
        if self.end():
            raise self._error()

    def _try(self, name: str, method: Callable[[], Any]) -> None:
        """Call a method although others have failed."""
        try:
            method()
        except RAISED as error:
            self._failures[name] = f"{name} failed: {in_one_line(error)}"

    def _note(self) -> None:
        """Current notes of the device."""
        notes = getattr(self.device, "notes", None)
        self._notes = notes() if callable(notes) else {}

    def drain(self) -> None:
        """Discard samples that came while none were read."""
        self._call("read", self.device.read, time.monotonic_ns())

    def _delays(self, way_us: float) -> dict[str, str]:
        """Shares of the ticks by whole ticks from a measurement to its command, on a rig that acts once a tick."""
        cells = self.delay.cells
        if not self.delay.count or not math.isfinite(way_us):
            return {}
        ticks = np.ceil((np.arange(len(cells)) + way_us) * 1e3 / TICK_NS).astype(int)
        shares = np.bincount(ticks, weights=cells) / self.delay.count
        return {"device_delay_ticks": text_of_shares(shares)}

    def statistics(self) -> dict[str, str]:
        """Counts that are not zero, ages of the samples, and the device's ``notes``."""
        if not self._ended:
            self._call("notes", self._note)
        own = self._notes
        fault = "; ".join([*([self.fault] if self.fault else []), *self._failures.values()])
        return {
            "device_state": self.state,
            **({"device_fault": fault} if fault else {}),
            **{f"device_{name}": str(count) for name, count in sorted(self.counts.items()) if count},
            **{f"device_{name}": text for name, text in self.age.summary("age").items()},
            **self._delays(float(own.get("clock_way_us", 0.0)) / 2),
            **{f"device_{name}": str(text) for name, text in own.items()},
        }


def refused_in_words(counts: Mapping[str, int]) -> list[str]:
    """Sentences about the samples that were refused for their time, one for the ports with the same number of them.

    Examples
    --------
    >>> refused_in_words({"impossible_time_one": 2, "impossible_time_other": 2, "absent_one": 3})
    ['one, other: 2 samples with an acquisition time in the future, or negative, were not used']
    """
    ports: dict[int, list[str]] = {}
    for name, count in sorted(counts.items()):
        if name.startswith(IMPOSSIBLE_TIME):
            ports.setdefault(count, []).append(name.removeprefix(IMPOSSIBLE_TIME))
    text = "samples with an acquisition time in the future, or negative, were not used"
    return [f"{', '.join(names)}: {count} {text}" for count, names in ports.items()]


def as_stamp(acquired_ns: int, first_ns: int, start: int) -> int:
    """Stamp [ns] of a time on the steady clock, where tick 0, of the stamp `start`, was at `first_ns`.

    Examples
    --------
    >>> as_stamp(5_300_000, 5_000_000, 1_000_000_000)
    1000300000
    """
    return max(1, start + int(acquired_ns) - first_ns)
