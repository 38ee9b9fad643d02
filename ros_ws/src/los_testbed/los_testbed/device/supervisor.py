"""Watches a device on the side of the loop: life cycle, silent and frozen sensors, limits, ages, one error for all."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.config import RunConfig
from los_testbed.device.contract import (
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
from los_testbed.loop.latency_histogram import LatencyHistogram
from los_testbed.plugins import RAISED, in_one_line
from titop_plant.interface import COLUMNS, COMMANDS, FRAMED, MEASURED, MEASUREMENTS, TICK_NS

EVERY_TICK = tuple(name for name in MEASURED if name not in FRAMED)
"""Ports of the sensors that have a sample at every tick."""

PATIENCE_TICKS = 100
"""Ticks after hold and fade that a device may be silent before the run is ended."""

SPARE_TICKS = 200
"""A sample that is kept for a tick in which none comes is given up when it has not been needed for so many ticks."""

FROZEN_TICKS = 200
"""A sensor whose samples are equal for so many ticks is frozen: each has noise of more than a bit."""


class Supervisor:
    """A device with what the loop has to know of it.

    Parameters
    ----------
    device : Device
    config : RunConfig

    Notes
    -----
    Samples of sensors that come at every tick have the stamp of the tick that they are used in; their age is counted.
    One is kept where two have come, for the next tick may have none: their clock is not the loop's. Frames of slower
    sensors keep the time of their acquisition.
    """

    def __init__(self, device: Device, config: RunConfig) -> None:
        self.device = device
        self.frame_ticks = config.frame_ticks
        self.state = UNCONFIGURED
        self.counts: Counter[str] = Counter()
        self.age = LatencyHistogram()
        self.delay = LatencyHistogram()
        self.measurement = np.full(MEASUREMENTS, np.nan)
        self.frames: list[Sample] = []
        self.fault = ""
        self._config = config
        self._limit_ticks = config.hold_ticks + config.fade_ticks + PATIENCE_TICKS
        self._silent = dict.fromkeys(EVERY_TICK, 0)
        self._odd_before = dict.fromkeys(EVERY_TICK, 0)
        """Values that were not finite up to the last sample that was used."""
        self._written_ns = self.acquired_ns = 0
        self._equal = dict.fromkeys(MEASURED, 0)
        self._last: dict[str, bytes] = {}
        self._queues: dict[str, deque[Sample]] = {port: deque() for port in (*EVERY_TICK, TRUTH_PORT)}
        self._unused = dict.fromkeys((*EVERY_TICK, TRUTH_PORT), 0)

    def reset(self) -> None:
        """Nothing: a rig has no start to go back to."""

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
            raise ValueError(f"device {self._config.device} must open, got {in_one_line(error)}") from error
        self.state = INACTIVE

    def write(self, command: FloatArray, now_ns: int) -> None:
        """Apply the command (8,) of a tick; the first one activates the device."""
        self.state, self._written_ns = ACTIVE, now_ns
        self._call("write", self.device.write, command.copy(), now_ns)

    def answered(self, acquired_ns: int) -> None:
        """Note of what time the samples are that the command was computed from that was written last."""
        self.delay.add(max(0, self._written_ns - acquired_ns))

    def read(self, now_ns: int) -> bool:
        """Take what has come until the deadline `now_ns` (steady clock); whether all sensors of a tick have a sample.

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
                self._odd_before[port] = self.counts[f"not_finite_{port}"]
            if port not in fresh:
                self.counts[f"absent_{port}"] += 1
        self._watch()
        return len(fresh) == len(EVERY_TICK)

    def samples(self, now_ns: int) -> list[Sample]:
        """All samples that have come and can be used, as the device gives them."""
        return [sample for sample in self._call("read", self.device.read, now_ns) if self._fits(sample)]

    def _next(self, port: str) -> Sample | None:
        """Sample of a tick: the oldest of those that wait, of which one is kept for a tick in which none comes.

        Samples that come about at the deadline come twice in one tick and not at all in the next. One that has not been
        needed for so long is left out.
        """
        queue = self._queues[port]
        spare = len(queue) > 1
        self._unused[port] = self._unused[port] + 1 if spare else 0
        most = 1 if self._unused[port] > SPARE_TICKS else 2
        while len(queue) > most:
            queue.popleft()
            self.counts[f"surplus_{port}"] += 1
        return queue.popleft() if queue else None

    def _fits(self, sample: Sample) -> bool:
        """Whether a sample can be used; a frozen one is noted."""
        columns = COLUMNS.get(sample.port)
        values = np.asarray(sample.values, float)
        if columns is None or values.shape != (columns.stop - columns.start,):
            raise self.failed(f"read must give samples of known ports, got {sample.port} {values.shape}")
        if sample.port not in FRAMED and not all(map(math.isfinite, values.tolist())):
            self.counts[f"not_finite_{sample.port}"] += 1
            return False
        data = values.tobytes()
        equal = data == self._last.get(sample.port)
        self._equal[sample.port] = self._equal.get(sample.port, 0) + 1 if equal else 0
        self._last[sample.port] = data
        return True

    def _watch(self) -> None:
        """Raise where a sensor is silent for too long, or frozen."""
        silent = {port: ticks for port, ticks in self._silent.items() if ticks > self._limit_ticks}
        if len(silent) == len(self._silent):
            raise self.failed(f"no sample for {self._limit_ticks} ms")
        if silent:
            odd = any(self.counts[f"not_finite_{port}"] > self._odd_before[port] for port in silent)
            what = "not finite" if odd else "silent"
            raise self.failed(f"{', '.join(silent)} {what} for {self._limit_ticks} ms")
        frozen = [port for port in EVERY_TICK if self._equal[port] > FROZEN_TICKS]
        if frozen:
            raise self.failed(f"{', '.join(frozen)} frozen for {FROZEN_TICKS} samples")

    def _call(self, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except RAISED as error:
            raise self.failed(f"{name} failed: {in_one_line(error)}") from error

    def failed(self, text: str) -> DeviceError:
        """The error of a device with a fault, which is noted."""
        self.fault, self.state = text, ERROR
        return DeviceError(f"device {self._config.device}: {text}; mirror and forces were brought to zero")

    def end(self) -> None:
        """Bring the actuators to zero and let go of the device, whatever has happened."""
        if self.state in (UNCONFIGURED, FINALIZED):
            return
        self._try("write", lambda: self.device.write(np.zeros(COMMANDS), time.monotonic_ns()))
        self._try("safe", self.device.safe)
        self._try("close", self.device.close)
        self.state = FINALIZED

    def _try(self, name: str, method: Callable[[], Any]) -> None:
        """Call a method although others have failed."""
        try:
            method()
        except RAISED as error:
            self.fault = self.fault or f"{name} failed: {in_one_line(error)}"

    def drain(self) -> None:
        """Leave what has come while nobody read."""
        self._call("read", self.device.read, time.monotonic_ns())

    def _delays(self, way_us: float) -> dict[str, str]:
        """Shares of the ticks by whole ticks from a measurement to its command, on a rig that acts once a tick."""
        cells = self.delay.cells
        if not self.delay.count or not math.isfinite(way_us):
            return {}
        ticks = np.ceil((np.arange(len(cells)) + way_us) * 1e3 / TICK_NS).astype(int)
        shares = np.bincount(ticks, weights=cells) / self.delay.count
        return {"device_delay_ticks": " ".join(f"{n}:{share:.4f}" for n, share in enumerate(shares) if share >= 5e-5)}

    def statistics(self) -> dict[str, str]:
        """Counts that are not zero, ages of the samples, and what the device says of itself (its ``notes``)."""
        notes = getattr(self.device, "notes", None)
        own = self._call("notes", notes) if callable(notes) else {}
        return {
            "device_state": self.state,
            **({"device_fault": self.fault} if self.fault else {}),
            **{f"device_{name}": str(count) for name, count in sorted(self.counts.items()) if count},
            **{f"device_{name}": text for name, text in self.age.summary("age").items()},
            **self._delays(float(own.get("clock_way_us", 0.0)) / 2),
            **{f"device_{name}": str(text) for name, text in own.items()},
        }


def delay_ticks(text: str) -> dict[int, float]:
    """Shares of the ticks by the delay of their command, as :meth:`Supervisor.statistics` has them.

    Raises
    ------
    ValueError
        Another form.

    Examples
    --------
    >>> delay_ticks("2:0.75 3:0.25")
    {2: 0.75, 3: 0.25}
    """
    pairs = (word.split(":") for word in text.split())
    return {int(ticks): float(share) for ticks, share in pairs}


def as_stamp(acquired_ns: int, first_ns: int, start: int) -> int:
    """Stamp [ns] of a time on the steady clock, where tick 0, of the stamp `start`, was at `first_ns`.

    Examples
    --------
    >>> as_stamp(5_300_000, 5_000_000, 1_000_000_000)
    1000300000
    """
    return max(1, start + acquired_ns - first_ns)
