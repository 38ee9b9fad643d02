"""Emulator of a rig in a separate process (``python -m los_testbed.rig.emulator``). It is not hardware.

It has a clock of its own with drift and jitter, accelerometers with latency, a camera with read-out, a mirror with
resonance, limits and a watchdog, and speaks the wire format of the reference driver. Its physics are those of the
simulated telescope of a run, or of a plant of the user. It prints a JSON object at each change of its state.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import signal
import struct
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.rig.driver import SPLIT, secret_of
from los_testbed.rig.serial import SerialLine, line_of, open_line, open_pseudo_terminal
from los_testbed.rig.supervisor import EVERY_TICK
from los_testbed.rig.udp import UdpSocket, address_of, other_machine
from los_testbed.rig.wire import LIMITED, RESTARTED, SAFE, Kind, Packet, Reader, encode, fits
from los_testbed.rig.wiring import Wiring
from los_testbed.run.loop.compiled_loop import compile_telescope
from los_testbed.run.loop.scheduling import become_real_time, sharpen_timers
from titop_plant.interface import CAMERA, COLUMNS, DT, FORCES, MIRROR, TICK_NS, TRUTH

PRIORITY = 90
"""A rig does not wait for the programs of its host."""

FAULTS = (
    *("silent", "frozen", "not_finite", "camera_silent", "brown_out", "outage", "corrupt", "repeated"),
    *("clock_jump", "deaf", "stuck"),
)
"""`deaf`: nothing that the host sends arrives; `stuck`: the mirror stays at zero, and nothing says so."""
BROWN_OUT_S = 0.5
OUTAGE_S = 0.1
"""Length of an outage of the line in both directions."""
COMPILED_TICKS = 60_000
"""Ticks that the emulator expects to work for."""
PSEUDO_TERMINAL = "pty"
"""Line that the emulator creates itself; it prints the path of the other end when it is ready."""
LEFT_NS = 1_000_000_000
"""Silence after which a host has left the rig, which another one may open."""

FAST_COLUMNS = np.concatenate([np.arange(COLUMNS[name].start, COLUMNS[name].stop) for name in EVERY_TICK])


@dataclass(frozen=True)
class RigSettings:
    """Imperfections of the rig.

    Attributes
    ----------
    drift_ppm : how much faster its clock is
    jitter_us : standard deviation of its ticks
    latency_us : from the acquisition of the fast sensors to the sending
    read_out : ticks from the acquisition of a frame to its sending
    loss, reorder : shares of its packets that are lost, or sent after the next one
    resonance, damping : of the mirror [Hz, -]
    rate : most that the mirror moves in a second [rad/s]
    watchdog : ticks without a command after which mirror and forces go to zero
    fault, fault_at : one of `FAULTS`, and seconds after the first command
    wrong : mistakes of its wiring, see :class:`los_testbed.rig.wiring.Wiring`
    serial : "" for UDP at the address of the configuration, `PSEUDO_TERMINAL`, or a serial line, PATH or PATH@BAUD
    truth : whether it sends the true line of sight
    seed : of all that is random
    """

    drift_ppm: float = 50.0
    jitter_us: float = 20.0
    latency_us: float = 300.0
    read_out: int = 7
    loss: float = 0.0
    reorder: float = 0.0
    resonance: float = 400.0
    damping: float = 0.3
    rate: float = 5.0
    watchdog: int = 50
    fault: str = ""
    fault_at: float = 1.0
    wrong: str = ""
    serial: str = ""
    truth: bool = True
    seed: int = 1


class Mirror:
    """Mirror of two axes with a resonance, limits of angle and rate; `limited` says whether the last step met one."""

    def __init__(self, limit: float, settings: RigSettings) -> None:
        w = 2 * np.pi * settings.resonance
        A = np.zeros((4, 4))
        A[0, 1], A[1, :3], A[3, 0] = 1.0, (-(w**2), -2 * settings.damping * w, w**2), 1.0 / DT
        self._rows = linalg.expm(A * DT)[[0, 1, 3], :3].tolist()
        self._limit, self._change = limit, settings.rate * DT
        self._axes = [(0.0, 0.0, 0.0)] * 2
        """Of each axis: angle, its rate, and where its driver aims."""
        self.limited = False

    def step(self, command: FloatArray) -> FloatArray:
        """Angles (2,) [rad], mean over a tick with a command (2,) [rad]."""
        means, wanted = [], command.tolist()
        for axis, (angle, rate, before) in enumerate(self._axes):
            inside = _clip(wanted[axis], self._limit)
            aim = before + _clip(inside - before, self._change)
            angle, rate, mean = (row[0] * angle + row[1] * rate + row[2] * aim for row in self._rows)
            self._axes[axis] = angle, rate, aim
            means.append(_clip(mean, self._limit))
        self.limited = [aim for _, _, aim in self._axes] != wanted
        return np.array(means)

    def stop(self) -> None:
        """At zero at once, as its driver does without power."""
        self._axes = [(0.0, 0.0, 0.0)] * 2


def _clip(value: float, limit: float) -> float:
    """The value, at most `limit` in size."""
    return min(max(value, -limit), limit)


class Emulator:
    """The rig: sockets, clock, state and physics.

    Parameters
    ----------
    config : RunConfig
        Physics, address and key.
    settings : RigSettings
    """

    def __init__(self, config: RunConfig, settings: RigSettings) -> None:
        self.settings = settings
        self._key = b""
        self.line, self._secret = self._listen(config)
        self._wiring = Wiring(settings.wrong)
        parts = RunParts(config)
        self._plant, ports = parts.plant(), parts.ports
        self._plant.reset()
        compile_telescope(self._plant, COMPILED_TICKS)
        angle, self._force = parts.basis.authority
        self._mirror = Mirror(angle, settings)
        self._random = np.random.default_rng(settings.seed)
        self._peer: Any = None
        self._reader = Reader(b"")
        self._sequence = 0
        self._newest = -1
        self._command = np.zeros(ports.commands)
        self._applied = np.zeros(ports.commands)
        self._commanded_ns = self._first_ns = self._heard_ns = 0
        self._safe, self._flags = True, 0
        self._waiting: deque[tuple[int, int, FloatArray]] = deque()
        self._held_back: bytes | None = None
        self._measurement, self._truth = np.zeros(ports.measurements), np.zeros(TRUTH)
        self._frozen: FloatArray | None = None
        self._jump = 0
        self._dead_until = 0
        self._physics = np.array([_name_of(self._plant)] if not settings.wrong else [])
        self._zero = int(self._random.integers(1, 1 << 40))
        self.stop = False

    def _listen(self, config: RunConfig) -> tuple[UdpSocket | SerialLine, bytes]:
        """Line to the host, and the key that opens the rig."""
        if not (serial := self.settings.serial):
            host, port = address_of(config.device_address)
            secret = secret_of(config, other_machine(host))
            return UdpSocket(host, port, bound=True), secret
        secret = secret_of(config)

        def ours(packet: bytes) -> bool:
            return fits(packet, secret) or bool(self._key and fits(packet, self._key))

        if serial == PSEUDO_TERMINAL:
            return open_pseudo_terminal(ours), secret
        return open_line(*line_of(serial), ours), secret

    def serve(self) -> None:
        """Work until a signal comes."""
        start, rate = time.monotonic_ns(), 1 + 1e-6 * self.settings.drift_ppm
        self._start, k = start, 0
        say("ready", **({"address": self.line.name} if self.settings.serial else {}))
        while not self.stop:
            jitter = self._random.normal(0.0, 1e3 * self.settings.jitter_us)
            late = sleep_until(start + round(k * TICK_NS / rate + min(max(jitter, -2e5), 2e5)))
            self._receive()
            self._watch()
            for _ in range(min(late // TICK_NS, 1000)):  # physics do not wait; these samples were not taken
                self._step()
                k += 1
            acquired = self._clock()
            self._step()
            if self._key and not self._is_dead():
                self._measure(k, acquired)
            k += 1

    def _clock(self) -> int:
        """The rig's clock [ns]."""
        since = time.monotonic_ns() - self._start
        return self._zero + self._jump + since + round(1e-6 * self.settings.drift_ppm * since)

    def _is_dead(self) -> bool:
        return time.monotonic_ns() < self._dead_until

    def _step(self) -> None:
        """A tick of the physics."""
        command = self._wiring.command(np.zeros_like(self._command) if self._safe else self._command)
        self._applied[MIRROR] = self._mirror.step(command[MIRROR] * (self._fault() != "stuck"))
        forces = command[FORCES].tolist()
        inside = [_clip(force, self._force) for force in forces]
        self._applied[FORCES] = inside
        limited = self._mirror.limited or inside != forces
        self._flags = (self._flags & RESTARTED) | SAFE * self._safe | LIMITED * limited
        self._plant.step(self._applied, self._measurement, self._truth)
        self._measurement[:] = self._wiring.measurement(self._measurement)

    def _measure(self, k: int, acquired: int) -> None:
        """Send what was acquired in this tick, and frames that were read out."""
        settings, fault = self.settings, self._fault()
        values = self._measurement[FAST_COLUMNS]
        if fault == "frozen":
            self._frozen = values if self._frozen is None else self._frozen
            values = self._frozen
        if fault == "not_finite":
            values[0] = np.nan
        if np.isfinite(self._measurement[CAMERA]).all() and fault != "camera_silent":
            self._waiting.append((k + settings.read_out, acquired, self._measurement[CAMERA].copy()))
        sleep_until(time.monotonic_ns() + round(1e3 * settings.latency_us))
        while self._waiting and self._waiting[0][0] <= k:
            _, then, frame = self._waiting.popleft()
            self._send(self._packet(Kind.FRAME, then, frame))
        if settings.truth:
            values = np.concatenate([values, self._truth])
        self._send(self._packet(Kind.FAST, acquired, values))

    def _packet(self, kind: Kind, time_ns: int, values: FloatArray) -> bytes:
        self._sequence += 1
        return encode(kind, self._sequence, time_ns, values, self._key, self._flags)

    def _fault(self) -> str:
        """Active fault."""
        since = self._since_fault_ns()
        over = self.settings.fault == "outage" and since > 1e9 * OUTAGE_S
        return self.settings.fault if since > 0 and not over else ""

    def _since_fault_ns(self) -> float:
        """Time since the fault began; not above zero before."""
        return time.monotonic_ns() - self._first_ns - 1e9 * self.settings.fault_at if self._first_ns else 0.0

    def _send(self, data: bytes) -> None:
        fault = self._fault()
        if fault in ("silent", "outage") or self._random.random() < self.settings.loss:
            return
        if fault == "corrupt":
            data = data[:-5] + bytes([data[-5] ^ 1]) + data[-4:]
        if self._held_back is None and self._random.random() < self.settings.reorder:
            self._held_back = data
            return
        late, self._held_back = self._held_back, None
        for one in (data, data if fault == "repeated" else None, late):
            if one is not None:
                with contextlib.suppress(OSError):  # the host is gone: the watchdog sees it
                    self.line.send_to(one, self._peer)

    def _receive(self) -> None:
        try:
            arrived = self.line.receive_from()
        except OSError:  # the other end is closed
            return
        for data, arrived_ns, peer in arrived:
            if self._is_dead() or self._fault() in ("outage", "deaf"):
                continue
            packet = self._reader.read(data) if self._key else None
            if packet is not None and peer == self._peer:
                self._obey(packet, arrived_ns)
            elif packet is None and (opening := Reader(self._secret).read(data)) is not None:
                self._open(opening, peer)

    def _open(self, packet: Packet, peer: Any) -> None:
        """A host opens the rig: from now on packets with its key count, until it closes or the rig is started again."""
        if (key := key_of(packet)) is None:
            return
        now = time.monotonic_ns()
        left = self._safe and now - self._heard_ns > LEFT_NS
        if self._key and key != self._key and not left:
            return  # it belongs to another run
        if key != self._key:
            self._key, self._reader, self._peer, self._newest, self._first_ns = key, Reader(key), peer, -1, 0
            say("opened")
        if peer == self._peer:
            self._heard_ns = now
            self._send(self._packet(Kind.OPENED, self._clock(), self._physics))

    def _obey(self, packet: Packet, arrived_ns: int) -> None:
        now = self._heard_ns = time.monotonic_ns()
        if packet.kind == Kind.SYNC and len(packet.values) == 2:
            values = np.append(packet.values, now - arrived_ns)
            self._send(self._packet(Kind.SYNC_REPLY, self._clock(), values))
        elif (
            packet.kind == Kind.COMMAND
            and len(packet.values) == len(self._command)
            and np.isfinite(packet.values).all()
        ):
            if packet.sequence > self._newest:
                self._newest = packet.sequence
                self._command[:] = packet.values
                self._commanded_ns = now
                if self._safe:
                    self._safe, self._first_ns = False, self._first_ns or now
                    say("active")
        elif packet.kind in (Kind.SAFE, Kind.CLOSE):
            self._become_safe("asked")
            if packet.kind == Kind.CLOSE:
                self._key = b""
                say("closed", applied=float(np.abs(self._applied).max()))

    def _watch(self) -> None:
        """Watchdog and faults of the rig itself."""
        if not self._safe and time.monotonic_ns() - self._commanded_ns > self.settings.watchdog * TICK_NS:
            self._become_safe("watchdog")
        fault = self._fault()
        if fault == "brown_out" and not self._flags & RESTARTED:
            self._dead_until = time.monotonic_ns() + round(1e9 * BROWN_OUT_S)
            self._become_safe("brown_out")
            self._key, self._flags = b"", self._flags | RESTARTED
        elif fault == "clock_jump" and not self._jump:
            self._jump = 1_000_000_000
            say("clock_jump")

    def _become_safe(self, why: str) -> None:
        """Mirror and forces at zero."""
        if self._safe:
            return
        since = (time.monotonic_ns() - self._commanded_ns) / 1e6
        before = float(np.abs(self._applied).max())
        self._safe = True
        self._command[:] = 0.0
        self._applied[:] = 0.0
        self._mirror.stop()
        ill = {"fault_ms": round(self._since_fault_ns() / 1e6, 3)} if self.settings.fault else {}
        say("safe", why=why, after_ms=round(since, 3), before=before, **ill)


def key_of(packet: Packet) -> bytes | None:
    """Key (8,) that a packet opens a rig with; None where it is no such packet. Anyone can send one."""
    words = packet.values.tolist()
    if packet.kind != Kind.OPEN or len(words) != 2 or not all(0.0 <= word < SPLIT for word in words):
        return None
    return struct.pack("<II", *map(int, words))


def _name_of(plant: Any) -> float:
    """Name of the values of a telescope, 12 hexadecimal digits, as a number; 0 for a plant of another kind."""
    name = str(getattr(plant, "parameters_hash", ""))
    return float(int(name, 16)) if re.fullmatch("[0-9a-f]{12}", name) else 0.0


def sleep_until(deadline_ns: int) -> int:
    """Sleep until a time of the steady clock [ns]; the lateness [ns].

    Nothing polls: at its priority that would take a tenth of a processor from the loop under test, and the wake-up is
    part of the rig's jitter.
    """
    rest = deadline_ns - time.monotonic_ns()
    if rest > 0:
        time.sleep(rest * 1e-9)
    return time.monotonic_ns() - deadline_ns


def say(event: str, **content: Any) -> None:
    """Print an event as a line of JSON."""
    sys.stdout.write(json.dumps({"event": event, **content}) + "\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the emulator until SIGINT or SIGTERM; returns the exit code."""
    parser = argparse.ArgumentParser("los_testbed.rig.emulator", description="Emulator of a rig; never hardware.")
    parser.add_argument("--config", default="{}", help="settings of a run, as a JSON object")
    for name, setting in RigSettings.__dataclass_fields__.items():
        option = "--" + name.replace("_", "-")
        if setting.type == "bool":
            parser.add_argument(option, action=argparse.BooleanOptionalAction, default=setting.default)
        else:
            kind = {"float": float, "int": int}.get(str(setting.type), str)
            choices = ("", *FAULTS) if name == "fault" else None
            parser.add_argument(option, type=kind, default=setting.default, choices=choices)
    parser.add_argument("--priority", action="store_true", help="ask for real-time scheduling")
    options = vars(parser.parse_args(arguments))
    try:
        priority = options.pop("priority")
        config = RunConfig.from_mapping({"start": "rest", **json.loads(options.pop("config"))}).emulated()
        rig = Emulator(config, RigSettings(**options))
    except (ValueError, OSError) as error:
        sys.stderr.write(f"emulator: {error}\n")
        return 2

    def end(number: int, frame: Any) -> None:
        rig.stop = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    sharpen_timers()
    if priority:
        become_real_time(PRIORITY)  # where it is not permitted, the emulator is a rig of more jitter
    rig.serve()
    return 0


if __name__ == "__main__":
    sys.exit(main())
