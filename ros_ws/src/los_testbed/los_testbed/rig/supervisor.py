"""Supervisor of a device: life cycle, what lasts too long, limits, ages, mirror and forces at zero, one error for all.

What a device does is judged by its samples and by its own reports. A condition that lasts for longer than the hold and
the fade of a command and the patience of the settings is a fault: the last command fades to zero, the device is asked
for its safe state and closed, and the run ends.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fsm_pma_controller.fade import fade_weights
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.config.plugins import RAISED, in_one_line
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import (
    ACTIVE,
    ASKED,
    CONFIRMED,
    ERROR,
    FINALIZED,
    INACTIVE,
    NOT_ZERO,
    TRUTH_PORT,
    UNCONFIGURED,
    Device,
    DeviceError,
    RigReport,
    Sample,
)
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.latency_histogram import LatencyHistogram, text_of_shares
from pointing_analysis.indices.mirror_following import FollowingSettings, MirrorFollowing
from pointing_analysis.requirements.verdict import FAULT
from titop_plant.interface import (
    ACCELEROMETERS,
    COLUMNS,
    DT,
    FRAMED,
    FSM_ANGLE,
    MEASURED,
    MIRROR,
    TICK_NS,
)
from titop_plant.sensors import CAMERA_PORT, GAUGE_PORT

EVERY_TICK = tuple(name for name in MEASURED if name not in FRAMED)
"""Ports of the sensors that have a sample at every tick."""

IMPOSSIBLE_TIME, NOT_FINITE, BEYOND_RANGE, LATE = "impossible_time_", "not_finite_", "beyond_range_", "late_"
"""Counts of the samples of a port that were refused: acquired in the future, or before this host was started; for a
value; for its size; too old. A clock that was set gives such times until it is tracked again; a stamp in the far future
would make all later ones late. Frames without values are none of them."""

REASONS = {
    IMPOSSIBLE_TIME: "with impossible times",
    NOT_FINITE: "not finite",
    BEYOND_RANGE: "beyond range",
    LATE: "late",
}
"""The same in messages."""

Condition = tuple[str, str]
"""What must not last: who is concerned, and how."""
SAFE, LIMITED = ("rig", "in its safe state while commanded"), ("commands", "limited by the rig")
UNANSWERED, SATURATED = ("clock requests", "unanswered"), ("command", "at its limit")
NOT_FOLLOWING = "mirror", "not following its command"
ABSENT, FROZEN = "absent", "frozen"
"""Conditions of a sensor, which is concerned by the name of its port."""


@dataclass(frozen=True)
class SupervisorSettings:
    """Limits of a device in a run.

    Parameters
    ----------
    following : FollowingSettings
        Tolerance of the mirror's angles. Its `patience` holds for all that lasts: a silent sensor, a rig in its safe
        state while it is commanded, one that limits its commands or leaves a request without an answer.
    saturated : int
        Ticks that a command may be at its limit, with pauses of at most the hold time.
    oldest : float
        Age of a sample of a sensor of every tick above which it is not used [ms].
    acceleration, camera, stroke : float
        Largest value of an accelerometer [m/s2, rad/s2] and of the camera [rad], and largest angle of the gauges over
        the authority of the mirror. Samples beyond are not used.
    frozen_samples : int
        Equal samples after which a sensor is frozen: each has noise of more than a bit. The true line of sight may be
        without noise, and at rest: of it only samples count before which the mirror was given another command.
    frozen_frames : int
        The same of a slower sensor, half a second of the usual camera, and how long its frames may be refused. With
        noise (rms) of half a step of its rounding or more, both values are as before in less than half of the frames
        at rest, and in 25 in a row once in 1e8.
    spare : int
        Ticks after which an unused sample in reserve for a tick without one is dropped.
    first : float
        Time, with two periods of the camera, within which each sensor must have sent its first sample [s].
    call : float
        Longest time that the driver may take for a call [s].
    confirmation : int
        Time for the rig's confirmation of its safe state [ms].
    at_zero : float
        Largest angle of the gauges in the safe state, over the authority of the mirror.
    """

    following: FollowingSettings = field(default_factory=FollowingSettings)
    saturated: int = 1000
    oldest: float = 4.0
    acceleration: float = 50.0
    camera: float = 0.01
    stroke: float = 1.1
    frozen_samples: int = 200
    frozen_frames: int = 25
    spare: int = 200
    first: float = 1.0
    call: float = 0.5
    confirmation: int = 200
    at_zero: float = 0.01


class _NoReturnError(BaseException):
    """A call of the driver takes too long: drivers may handle every Exception."""


class Supervisor:
    """A supervised device with its state for the loop.

    Parameters
    ----------
    device : Device
    config : RunConfig
    settings : SupervisorSettings

    Notes
    -----
    Samples of sensors that come at every tick have the stamp of the tick that they are used in; their age is counted.
    If two have come, one is kept in reserve for the next tick: their clock is not the loop's. Frames of slower
    sensors keep the time of their acquisition.

    In the main thread, a call of the driver that does not return is ended by SIGALRM.
    """

    def __init__(self, device: Device, config: RunConfig, settings: SupervisorSettings = SupervisorSettings()) -> None:
        self.device, self.settings = device, settings
        self.state = UNCONFIGURED
        self.fault, self.fault_ns = "", 0
        self.zero = ""
        """Which of the three sentences on mirror and forces is true, at the end."""
        parts = RunParts(config)
        self._config, self._ports = parts.config, parts.ports
        self._weights = fade_weights(config.fade_ticks)
        self.frame_ticks = self._ports.ticks[CAMERA_PORT]
        angle, force = parts.basis.authority
        noise = float(self._ports.noise[FSM_ANGLE].max())
        fade = config.hold_ticks + config.fade_ticks
        self._mirror = MirrorFollowing(*parts.telescope.fsm.dynamics, noise, settings.following, DT, fade)
        self._authority = np.full(self._ports.commands, force)
        self._authority[MIRROR] = angle
        self._range = {**dict.fromkeys(ACCELEROMETERS, settings.acceleration), CAMERA_PORT: settings.camera}
        self._range |= {GAUGE_PORT: settings.stroke * angle, TRUTH_PORT: math.inf}
        self._handler: Any = None
        """Of SIGALRM, while the device is open."""
        self._period = {port: self.frame_ticks if port in FRAMED else 1 for port in (*MEASURED, TRUTH_PORT)}
        of_frames = settings.frozen_frames * self.frame_ticks
        self._limits: dict[Condition, float] = {(port, FROZEN): settings.frozen_samples for port in self._period}
        self._limits |= {(port, how): of_frames for port in FRAMED for how in (ABSENT, FROZEN)}
        self._limits[SATURATED] = settings.saturated
        self._ended = False
        self._failures: dict[str, str] = {}
        self._notes: Mapping[str, Any] = {}
        self._command = np.zeros(self._ports.commands)
        self._moved = False
        self._seen: set[str] = set()
        self._begin_counts()

    def _begin_counts(self) -> None:
        """State of a run."""
        self.counts: Counter[str] = Counter()
        self.age = LatencyHistogram()
        self.delay = LatencyHistogram()
        self.measurement = np.full(self._ports.measurements, np.nan)
        self.frames: list[Sample] = []
        self._lasting: dict[Condition, tuple[int, int]] = {}
        """Ticks and begin (steady clock [ns]) of each condition that lasts."""
        self._refused: dict[str, tuple[str, int]] = {}
        """Why the last sample of a port was refused, and how many since the last one that could be used."""
        self._written_ns = self.acquired_ns = 0
        self._equal = dict.fromkeys((*MEASURED, TRUTH_PORT), 0)
        self._last: dict[str, bytes] = {}
        self._queues: dict[str, deque[Sample]] = {port: deque() for port in (*EVERY_TICK, TRUTH_PORT)}
        self._unused = dict.fromkeys((*EVERY_TICK, TRUTH_PORT), 0)
        self._unsaturated = self._config.hold_ticks + 1
        self._block: list[tuple[FloatArray, FloatArray]] = []
        self._deviating = 0
        self._mirror.reset()

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
        if threading.current_thread() is threading.main_thread():  # elsewhere there are no signals
            self._handler = signal.signal(signal.SIGALRM, _interrupt)

    def write(self, command: FloatArray, now_ns: int) -> None:
        """Apply the command (8,) of a tick; the first one activates the device."""
        self.state, self._written_ns = ACTIVE, now_ns
        self._moved = bool(np.any(command[MIRROR] != self._command[MIRROR]))
        self._command[:] = command
        saturated = bool(np.any(np.abs(command) >= (1.0 - 1e-9) * self._authority))
        self._unsaturated = 0 if saturated else self._unsaturated + 1
        self._call("write", self.device.write, command.copy(), now_ns)

    def answered(self, acquired_ns: int) -> None:
        """Record the time of the samples from which the last written command was computed."""
        self.delay.add(max(0, self._written_ns - acquired_ns))

    def read(self, now_ns: int) -> bool:
        """Read the samples up to the deadline `now_ns` (steady clock); whether all sensors of a tick have one.

        Raises
        ------
        DeviceError
            The device failed, or what must not last lasted for too long.
        """
        self.frames = []
        self.acquired_ns = now_ns
        for sample in self.samples(now_ns):
            if sample.port in FRAMED:
                self.frames.append(sample)
            elif sample.port != TRUTH_PORT and now_ns - sample.acquired_ns > 1e6 * self.settings.oldest:
                self._refuse(LATE, sample.port)
            else:
                self._queues[sample.port].append(sample)
        if (truth := self._next(TRUTH_PORT)) is not None:
            self.frames.append(truth)
        absent = []
        for port in EVERY_TICK:
            if (newest := self._next(port)) is None:
                absent.append(port)
                self.counts[f"absent_{port}"] += 1
                continue
            self._refused.pop(port, None)
            self.measurement[COLUMNS[port]] = newest.values
            self.age.add(max(0, now_ns - newest.acquired_ns))
            self.acquired_ns = min(self.acquired_ns, newest.acquired_ns)
        self._watch(absent, now_ns)
        return not absent

    def samples(self, now_ns: int) -> list[Sample]:
        """All usable new samples of the device."""
        came = self._call("read", self.device.read, now_ns)
        if not isinstance(came, Sequence) or not all(isinstance(sample, Sample) for sample in came):
            raise self.failed(f"read must return a sequence of samples, got {str(came)[:80]}")
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
        most = 1 if self._unused[port] > self.settings.spare else 2
        while len(queue) > most:
            queue.popleft()
            self.counts[f"surplus_{port}"] += 1
        return queue.popleft() if queue else None

    def _fits(self, sample: Sample, latest_ns: int) -> bool:
        """Whether a sample can be used; a frozen one is noted."""
        port = str(sample.port)
        try:
            values, time_ns = np.asarray(sample.values, float), float(sample.acquired_ns)
        except (TypeError, ValueError) as error:
            raise self.failed(f"samples must have numbers as time and values, got {in_one_line(error)}") from None
        if port not in self._range or values.shape != (COLUMNS[port].stop - COLUMNS[port].start,):
            sizes = ", ".join(f"{name} ({COLUMNS[name].stop - COLUMNS[name].start},)" for name in self._range)
            raise self.failed(f"read must give samples of these ports and shapes: {sizes}; got {port} {values.shape}")
        self._seen.add(port)
        if not 0 <= time_ns <= latest_ns:
            self._refuse(IMPOSSIBLE_TIME, port)
            return False
        if not all(map(math.isfinite, values.tolist())):
            if port in FRAMED:  # a frame without a star
                return True
            self._refuse(NOT_FINITE, port)
            return False
        if np.abs(values).max() > self._range[port]:
            self._refuse(BEYOND_RANGE, port)
            return False
        if port in FRAMED:  # others when they are used
            self._refused.pop(port, None)
        data = values.tobytes()
        if data != self._last.get(port):
            self._equal[port] = 0
        elif self._moved or port != TRUTH_PORT:
            self._equal[port] += 1
        self._last[port] = data
        return True

    def _refuse(self, reason: str, port: str) -> None:
        self.counts[f"{reason}{port}"] += 1
        self._refused[port] = REASONS[reason], self._refused.get(port, ("", 0))[1] + 1

    def _watch(self, absent: Sequence[str], now_ns: int) -> None:
        """Raise where what must not last has lasted for too long; `absent` are the ports without a sample."""
        report, lasting = self._report(), self._lasting
        saturated = self._unsaturated <= self._config.hold_ticks
        states = (SAFE, report.safe), (LIMITED, report.limited), (UNANSWERED, report.unanswered), (SATURATED, saturated)
        present = [*((port, ABSENT) for port in absent), *(name for name, holds in states if holds)]
        counts = {name: lasting[name][0] + 1 if name in lasting else 1 for name in present}
        frames = {port: self._refused[port][1] for port in FRAMED if port in self._refused}
        counts |= {(port, ABSENT): refused * self.frame_ticks for port, refused in frames.items()}
        counts |= {(port, FROZEN): equal * self._period[port] for port, equal in self._equal.items() if equal}
        angle = np.full(2, np.nan) if GAUGE_PORT in absent else self.measurement[FSM_ANGLE].copy()
        self._block.append((self._command[MIRROR].copy(), angle))
        if len(self._block) == self.settings.following.block:
            command, seen = (np.array(rows) for rows in zip(*self._block))
            self._deviating, self._block = int(self._mirror.lasting(self._mirror.deviates(command, seen))[0]), []
        if self._deviating:
            counts[NOT_FOLLOWING] = self._deviating
        self._lasting = {
            name: (n, lasting[name][1] if name in lasting else now_ns - (n - 1) * TICK_NS) for name, n in counts.items()
        }
        limits = {name: self._limits.get(name, self._mirror.limit) for name in counts}
        if len(absent) == len(EVERY_TICK):  # of a line without samples that is all to say
            limits[UNANSWERED] = math.inf
        if over := [since for name, (count, since) in self._lasting.items() if count > limits[name]]:
            notable = self._config.hold_ticks + self._config.fade_ticks
            groups: dict[str, list[str]] = {}
            for (subject, what), count in counts.items():
                if count > min(notable, limits[subject, what]):
                    how = what
                    if what == ABSENT:
                        reason, refused = self._refused.get(subject, ("", 0))
                        how = reason if 2 * refused * self._period[subject] > count else "silent"
                    groups.setdefault(f"{how} for {min(count, limits[subject, what])} ms", []).append(subject)
            text = ", ".join(f"{', '.join(subjects)} {rest}" for rest, subjects in groups.items())
            if groups.get(f"silent for {self._mirror.limit} ms") == [*EVERY_TICK]:
                text = f"no sample for {self._mirror.limit} ms"
            raise self.failed(text, min(over))

    def _report(self) -> RigReport:
        """What the rig says of itself, nothing where its driver has no such method or before it does."""
        report = getattr(self.device, "report", None)
        return (self._call("report", report) if callable(report) else None) or RigReport(0)

    def await_first(self) -> None:
        """Read until each sensor has sent a sample.

        Raises
        ------
        DeviceError
            One has not within the time of the settings.
        """
        limit = self.settings.first + 2 * self.frame_ticks * DT
        for _ in range(math.ceil(limit / DT)):
            if self._seen.issuperset(MEASURED):
                return
            self.drain()
            time.sleep(DT)
        missing = ", ".join(port for port in MEASURED if port not in self._seen)
        raise self.failed(f"each sensor must send samples before the run, got none of {missing} within {limit:g} s")

    def _guarded(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Result of a call of the driver; a call that takes too long is interrupted."""
        if self._handler is None:
            return method(*arguments)
        timer = signal.setitimer(signal.ITIMER_REAL, self.settings.call, self.settings.call)
        try:
            return method(*arguments)
        except _NoReturnError as late:
            text = f"it did not return within {self.settings.call:g} s"
            raise TimeoutError(text).with_traceback(late.__traceback__) from None
        finally:
            signal.setitimer(signal.ITIMER_REAL, *timer)

    def _call(self, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return self._guarded(method, *arguments)
        except RAISED as error:
            raise self.failed(f"{name} failed: {in_one_line(error)}") from error

    def failed(self, text: str, since_ns: int = 0) -> DeviceError:
        """Error of a device at fault, since a time of the steady clock [ns], default: now.

        The device is closed: the error says whether mirror and forces are at zero.
        """
        if not self.fault:
            self.fault, self.fault_ns = text, since_ns or time.monotonic_ns()
        self.state = ERROR
        self.end()
        return self._error()

    def _error(self) -> DeviceError:
        not_zero = ", ".join(self._failures[name] for name in ("write", "safe") if name in self._failures)
        rest = [text for name, text in self._failures.items() if name not in ("write", "safe")]
        zero = f"{self.zero}: {not_zero}" if self.zero == NOT_ZERO else self.zero
        if not self.fault and not self._failures:
            angle = self.settings.at_zero * self._authority[0]
            reported = f"safe, with angles of the mirror below {angle:.2g} rad, within {self.settings.confirmation} ms"
            rest = [f"after safe() the rig must report that it is {reported}, got no such report"]
        return DeviceError(f"device {self._config.device}: {'; '.join([*filter(None, [self.fault]), *rest, zero])}")

    def end(self) -> tuple[str, ...]:
        """Fade the last command to zero, ask for the safe state, and close the device, once; the failures."""
        if not self._ended and self.state != UNCONFIGURED:
            self._ended = True
            self._try("write", self._fade)
            self._try("safe", self._guarded, self.device.safe)
            failed = self._failures.keys() & {"write", "safe"}
            self.zero = CONFIRMED if self._confirmed() else NOT_ZERO if failed else ASKED
            self._try("notes", self._guarded, self._note)  # a driver need not have any when it is closed
            self._try("close", self._guarded, self.device.close)
            self.state = ERROR if self.fault or self._failures else FINALIZED
            if self._handler is not None:
                signal.signal(signal.SIGALRM, self._handler)
                self._handler = None
        return tuple(self._failures.values())

    def _fade(self) -> None:
        """Write the last command with smaller and smaller weights, the last one zero."""
        for weight in reversed(self._weights[:-1] if self._command.any() else self._weights[:1]):
            self._guarded(self.device.write, weight * self._command, time.monotonic_ns())
            time.sleep(DT if weight else 0.0)

    def _confirmed(self) -> bool:
        """Whether a rig reports its safe state, by a report and angles of the gauges of after it was asked for it."""
        asked_ns, angle = time.monotonic_ns(), math.inf
        for k in range(self.settings.confirmation if callable(getattr(self.device, "report", None)) else 0):
            try:
                if k % 20 == 19:  # the request may have been lost
                    self._guarded(self.device.safe)
                came = self._guarded(self.device.read, time.monotonic_ns())
                seen = [s for s in came if s.port == GAUGE_PORT and s.acquired_ns > asked_ns]
                angle = float(np.abs(seen[-1].values).max()) if seen else angle
                report = self._guarded(self.device.report)  # type: ignore[attr-defined]  # an optional method
                safe = report is not None and report.safe and report.received_ns > asked_ns
                if safe and angle <= self.settings.at_zero * self._authority[0]:
                    return True
            except RAISED:
                return False
            time.sleep(DT)
        return False

    def finish(self) -> None:
        """The same as :meth:`end`, where its failures are an error.

        Raises
        ------
        DeviceError
            The actuators could not be set to zero, the device not be closed, or a rig that reports its state has not
            confirmed that they are at zero.
        """
        unconfirmed = self.end() or (self.zero == ASKED and callable(getattr(self.device, "report", None)))
        if unconfirmed:
            raise self._error()

    def _try(self, name: str, method: Callable[..., Any], *arguments: Any) -> None:
        """Call a method although others have failed."""
        try:
            method(*arguments)
        except RAISED as error:
            self._failures[name] = f"{name} failed: {in_one_line(error)}"

    def _note(self) -> None:
        """Current notes of the device."""
        notes = getattr(self.device, "notes", None)
        self._notes = notes() if callable(notes) else {}

    def drain(self) -> None:
        """Discard samples that came while none were read; which sensors have sent any is known afterwards."""
        self.samples(time.monotonic_ns())

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
        notes = self._notes
        fault = "; ".join(filter(None, [self.fault, *self._failures.values()]))
        return {
            "device_state": self.state,
            **({FAULT: fault} if fault else {}),
            **({"device_zero": self.zero} if self.zero else {}),
            **{f"device_{name}": str(count) for name, count in sorted(self.counts.items()) if count},
            **{f"device_{name}": text for name, text in self.age.summary("age").items()},
            **self._delays(float(notes.get("clock_way_us", 0.0)) / 2),
            **{f"device_{name}": str(text) for name, text in notes.items()},
        }


def _interrupt(number: int, frame: Any) -> None:
    raise _NoReturnError


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
