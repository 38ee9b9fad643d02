"""Reference driver: a rig that speaks the wire format, over a line of any kind."""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import SECRET
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import TRUTH_PORT, RigReport, Sample
from los_testbed.rig.clock_map import ClockMap
from los_testbed.rig.supervisor import EVERY_TICK
from los_testbed.rig.wire import KEY_BYTES, LIMITED, RESTARTED, SAFE, Kind, Packet, Reader, encode
from titop_plant.interface import COLUMNS, FRAMED, TICK_NS


def _layout(*ports: str) -> tuple[tuple[str, slice], ...]:
    """Parts of a packet."""
    ends = np.cumsum([COLUMNS[port].stop - COLUMNS[port].start for port in ports]).tolist()
    return tuple((port, slice(first, last)) for port, first, last in zip(ports, [0, *ends], ends))


LAYOUTS = {
    (kind, parts[-1][1].stop): parts
    for kind, parts in (
        (Kind.FAST, _layout(*EVERY_TICK)),
        (Kind.FAST, _layout(*EVERY_TICK, TRUTH_PORT)),
        (Kind.FRAME, _layout(*FRAMED[:1])),
    )
}
"""Parts of the packets with samples, by kind and number of values: the true line of sight may be behind the others."""

OPEN_S = 5.0
SYNC_PERIOD_NS, RETRY_NS = 50_000_000, 10_000_000
"""Time from an answer of the rig's clock to the next request, and from a request without an answer to the next one."""
FIRST_SYNCS = 20
SET_BACK_NS = 1_000_000_000
SPLIT = 2.0**32


class RigSilentError(RuntimeError):
    """The rig did not respond."""


class PacketLine(Protocol):
    """Transport of packets to and from a rig. A packet may be lost, but is never split."""

    name: str

    def send(self, data: bytes) -> None:
        """Send a packet; OSError where it cannot be sent at the moment."""

    def receive(self) -> list[tuple[bytes, int]]:
        """Received packets, without waiting, with their arrival times on the steady clock of this host [ns]."""

    def close(self) -> None:
        """Close the line."""


def secret_of(config: RunConfig, needed: str = "") -> bytes:
    """Key that the rig is opened with, (8,), from the file of the configuration; zeros for a rig on this machine.

    Parameters
    ----------
    config : RunConfig
    needed : str
        Name of another machine, for which there must be a key.

    Raises
    ------
    ValueError
        None was given for another machine.
    """
    if config.device_key is not None:
        try:
            text = read_bytes(config.device_key, SECRET).strip()
        except OSError as error:
            raise InputError(f"device_key must be a file, got {config.device_key}: {error.strerror}") from None
        if len(text) < 16:
            raise InputError(f"device_key must be a file with 16 characters or more, got {len(text)}")
        return struct.pack("<II", zlib.crc32(text), zlib.crc32(text[::-1]))
    if needed:
        raise InputError(f"device_key must be given for a rig on another machine, got none for {needed}")
    return bytes(KEY_BYTES)


def _are_counts(values: FloatArray) -> bool:
    """Whether values are valid counts below 2^32: a line may deliver anything."""
    return bool(np.all((values >= 0.0) & (values < SPLIT)))


class PacketRig:
    """Driver of a rig that speaks the wire format (:mod:`los_testbed.rig.wire`); its line is a subclass's.

    The key of a run is made here and sent once, when the rig is opened. The rig's clock is mapped to that of this host
    by requests that it answers: offset and drift are in the notes.
    """

    def __init__(self) -> None:
        self.clock = ClockMap()
        self.counts: Counter[str] = Counter()
        self.emulates = ""
        self.key = os.urandom(KEY_BYTES)
        self._line: PacketLine | None = None
        self._reader = Reader(self.key)
        self._sequence = 0
        self._next_sync = 0
        self._unanswered = False
        self._report: RigReport | None = None

    def settings(self, config: RunConfig) -> tuple[Any, bytes]:
        """Address of the rig, and the key that opens it; ValueError: no such ones."""
        raise NotImplementedError

    def connect(self, address: Any) -> PacketLine:
        """The line to the rig."""
        raise NotImplementedError

    def check(self, config: RunConfig) -> None:
        """Refuse an address or a key that cannot be one."""
        self.settings(config)

    def open(self, config: RunConfig) -> None:
        """Connect, agree on the key, learn the rig's clock."""
        address, secret = self.settings(config)
        self._line = self.connect(address)
        name = self._line.name
        words = np.array(struct.unpack("<II", self.key), float)
        end = time.monotonic() + OPEN_S
        while not any(self._opened(packet) for packet, _ in self._take()):
            if time.monotonic() > end:
                self.close()
                raise RigSilentError(f"no answer from {name} within {OPEN_S:g} s")
            self._send(encode(Kind.OPEN, self._number(), time.monotonic_ns(), words, secret))
            time.sleep(0.02)
        end = time.monotonic() + OPEN_S
        for number in range(100 * FIRST_SYNCS):
            self._sync(time.monotonic_ns())
            time.sleep(0.002)
            self.read(time.monotonic_ns())
            if (number >= FIRST_SYNCS and self.clock.known) or time.monotonic() > end:
                break
        if not self.clock.known:
            self.close()
            raise RigSilentError(f"{name} does not respond to clock requests")

    def _opened(self, packet: Packet) -> bool:
        """Whether the rig is open; an emulator says which plant it simulates."""
        if packet.kind == Kind.OPENED and len(packet.values) == 1 and 0 < (number := packet.values[0]) < 2.0**48:
            self.emulates = f"{int(number):012x}"
        return packet.kind == Kind.OPENED

    def read(self, now_ns: int) -> Sequence[Sample]:
        """Samples that have come, oldest first."""
        samples: list[Sample] = []
        for packet, received in self._take():
            if packet.kind == Kind.SYNC_REPLY and len(packet.values) in (2, 3) and _are_counts(packet.values):
                sent = int(packet.values[0] * SPLIT + packet.values[1]) + int(packet.values[2:].sum())
                self.clock.answer(sent, packet.time_ns, received)
                self._unanswered, self._next_sync = False, received + SYNC_PERIOD_NS
            else:
                samples += self._samples(packet, received)
        samples.sort(key=lambda sample: sample.acquired_ns)
        if now_ns >= self._next_sync or (samples and self._was_set(samples[-1])):
            self._sync(now_ns)
        return samples

    def _was_set(self, newest: Sample) -> bool:
        """Whether the rig's clock was stepped: it is queried immediately, since no sample is usable until then."""
        return not -SET_BACK_NS < newest.acquired_ns - time.monotonic_ns() <= TICK_NS

    def report(self) -> RigReport | None:
        """What the flags of the last packet of every tick say, and whether a request to the clock is unanswered."""
        return None if self._report is None else replace(self._report, unanswered=self._unanswered)

    def _samples(self, packet: Packet, received: int) -> list[Sample]:
        if packet.kind == Kind.FAST:
            self._report = RigReport(received, bool(packet.flags & SAFE), bool(packet.flags & LIMITED))
        if packet.flags:
            for flag, name in ((SAFE, "safe"), (LIMITED, "limited"), (RESTARTED, "restarted")):
                self.counts[f"rig_{name}"] += bool(packet.flags & flag)
        parts = LAYOUTS.get((packet.kind, len(packet.values)))
        if parts is None:
            self.counts["rig_other_packets"] += 1
            return []
        acquired = self.clock.to_host(packet.time_ns)
        return [Sample(port, acquired, packet.values[part]) for port, part in parts]

    def begin_counts(self) -> None:
        """A run begins: lost, reordered and refused packets, flags of the rig and jumps of its clock count from now."""
        self.counts.clear()
        self.clock.jumps = 0
        self._reader.begin_counts()

    def write(self, command: FloatArray, now_ns: int) -> None:
        """Send a command; the rig has its own watchdog."""
        self._send(encode(Kind.COMMAND, self._number(), now_ns, command, self.key))

    def safe(self) -> None:
        """Ask the rig for its safe state, three times: a packet may be lost.

        Raises
        ------
        OSError
            The line takes none of the packets.
        """
        before = self.counts["send_failed"]
        for _ in range(3):
            self._send(encode(Kind.SAFE, self._number(), time.monotonic_ns(), np.zeros(0), self.key))
        if self._line is None or self.counts["send_failed"] == before + 3:
            raise OSError("no packet could be sent")

    def close(self) -> None:
        """Close the rig."""
        if self._line is not None:
            for _ in range(3):
                self._send(encode(Kind.CLOSE, self._number(), time.monotonic_ns(), np.zeros(0), self.key))
            self._line.close()
            self._line = None

    def notes(self) -> dict[str, str]:
        """Clock of the rig and counts."""
        return {
            "clock_offset_ms": f"{self.clock.offset_ms:.3f}",
            "clock_drift_ppm": f"{self.clock.drift_ppm:.2f}",
            "clock_way_us": f"{self.clock.way_us:.1f}",
            **({"emulates": self.emulates} if self.emulates else {}),
            **({"clock_jumps": str(self.clock.jumps)} if self.clock.jumps else {}),
            **self._reader.statistics(),
            **{name: str(count) for name, count in sorted(self.counts.items()) if count},
        }

    def _sync(self, now_ns: int) -> None:
        self._unanswered, self._next_sync = True, now_ns + RETRY_NS
        sent = time.monotonic_ns()
        parts = np.array([sent // 2**32, sent % 2**32], float)
        self._send(encode(Kind.SYNC, self._number(), sent, parts, self.key))

    def _number(self) -> int:
        self._sequence += 1
        return self._sequence

    def _send(self, data: bytes) -> None:
        if self._line is not None:
            try:
                self._line.send(data)
            except OSError:  # no receiver at the moment: the watchdog measures for how long
                self.counts["send_failed"] += 1

    def _take(self) -> list[tuple[Packet, int]]:
        """Packets that have come, with their times of arrival."""
        if self._line is None:
            return []
        try:
            arrived = self._line.receive()
        except OSError:
            self.counts["receive_failed"] += 1
            return []
        packets = ((self._reader.read(data), time_ns) for data, time_ns in arrived)
        return [(packet, time_ns) for packet, time_ns in packets if packet is not None]
