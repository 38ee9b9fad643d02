"""Packets between host and rig: the wire format of the reference driver (little endian).

======== ===== =====================================================================================================
field    bytes content
======== ===== =====================================================================================================
magic    4     ``LOSR``
version  1     1
kind     1     `Kind`
flags    2     of a rig: bit 0 it is safe, bit 1 it has limited a command, bit 2 it was started again
sequence 4     one more at each packet of a sender, after 2^32 - 1 comes 0
time     8     of acquisition, of a command its deadline: clock of the sender [ns]
n        2     number of values
reserved 2     zero
values   8 n   64-bit floating point, SI
check    4     CRC-32 of all that and of the key of the run (8 bytes), which is in no packet but the one that opens
======== ===== =====================================================================================================

Anything else is rejected. The check excludes stray packets and former runs, not an attacker on the line: a rig beyond
this machine needs a dedicated line.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from lftkit.arrays import FloatArray

MAGIC, VERSION = b"LOSR", 1
HEAD = struct.Struct("<4sBBHIqHH")
CHECK = struct.Struct("<I")
KEY_BYTES, MOST_VALUES = 8, 64
WRAP = 2**32
"""Packets after which the sequence number of a sender wraps: 46 days at 1080 per second."""
SAFE, LIMITED, RESTARTED = 1, 2, 4


class Kind(IntEnum):
    """Type of a packet. Host to rig: open, command, safe, close, sync; rig to host: opened, the others.

    Sync has two values, which the reply sends back; a third one there is the time from the arrival of the question to
    the reply [ns]. With `OPENED` an emulator sends one value: the name of the values of the telescope that it
    simulates, 12 hexadecimal digits as a number.
    """

    OPEN = 1
    OPENED = 2
    FAST = 3
    FRAME = 4
    COMMAND = 5
    SAFE = 6
    CLOSE = 7
    SYNC = 8
    SYNC_REPLY = 9


@dataclass(frozen=True)
class Packet:
    """A packet that was read.

    Attributes
    ----------
    kind, flags : as in the table above
    sequence : number of the packet; a :class:`Reader` unwraps the 32 bits of the wire
    time_ns : clock of the sender
    values : (n,)
    """

    kind: Kind
    flags: int
    sequence: int
    time_ns: int
    values: FloatArray


def encode(kind: Kind, sequence: int, time_ns: int, values: FloatArray, key: bytes, flags: int = 0) -> bytes:
    """Bytes of a packet.

    Examples
    --------
    >>> reader = Reader(b"12345678")
    >>> data = encode(Kind.FRAME, 1, 5, np.array([1e-6, 2e-6]), b"12345678")
    >>> len(data), reader.read(data).values.tolist()
    (44, [1e-06, 2e-06])
    >>> reader.read(data), reader.read(data[:-1] + b"!"), dict(reader.refused)
    (None, None, {'repeated': 1, 'check': 1})
    """
    data = HEAD.pack(MAGIC, VERSION, kind, flags, sequence % WRAP, time_ns, len(values), 0)
    data += np.asarray(values, "<f8").tobytes()
    return data + CHECK.pack(zlib.crc32(key, zlib.crc32(data)))


def fits(data: bytes, key: bytes) -> bool:
    """Whether the check at the end of the data is that of a packet of the run with this key."""
    return bool(CHECK.unpack_from(data, len(data) - CHECK.size)[0] == zlib.crc32(key, zlib.crc32(data[: -CHECK.size])))


@dataclass
class Reader:
    """Reads the packets of one sender; others are rejected and counted by reason.

    Parameters
    ----------
    key : bytes
        Key of the run (8,).
    """

    key: bytes
    refused: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    reordered: int = 0
    _newest: int = -1
    _before: int = -1
    _seen: set[int] = field(default_factory=set)

    def read(self, data: bytes) -> Packet | None:
        """The packet, or None. A packet that comes after a later one is returned; one that was read already is not."""
        packet = self._parse(data)
        if packet is None:
            return None
        number = self._unwrapped(packet.sequence)
        packet = replace(packet, sequence=number)
        if number in self._seen or number < self._newest - 1000:
            self.refused["repeated"] += 1
            return None
        self._seen.add(number)
        if number < self._newest:
            if number > self._before:
                self.reordered += 1
                self.lost -= 1
        elif self._newest >= 0:
            self.lost += number - self._newest - 1
        self._newest = max(self._newest, number)
        if len(self._seen) > 4000:
            self._seen = {old for old in self._seen if old > self._newest - 1000}
        return packet

    def _unwrapped(self, sequence: int) -> int:
        """The number with these 32 bits nearest to the newest one, since the counter of a sender wraps."""
        if self._newest < 0:
            return sequence
        return self._newest + (sequence - self._newest + WRAP // 2) % WRAP - WRAP // 2

    def begin_counts(self) -> None:
        """Count from now on; packets that were sent before the newest one and come late are in no count."""
        self.lost = self.reordered = 0
        self.refused.clear()
        self._before = self._newest

    def _parse(self, data: bytes) -> Packet | None:
        if len(data) < HEAD.size + CHECK.size:
            self.refused["size"] += 1
            return None
        magic, version, kind, flags, sequence, time_ns, n, reserved = HEAD.unpack_from(data)
        if magic != MAGIC or version != VERSION or reserved:
            self.refused["format"] += 1
        elif n > MOST_VALUES or len(data) != HEAD.size + 8 * n + CHECK.size:
            self.refused["size"] += 1
        elif not fits(data, self.key):
            self.refused["check"] += 1
        elif kind not in Kind._value2member_map_:
            self.refused["kind"] += 1
        else:
            return Packet(Kind(kind), flags, sequence, time_ns, np.frombuffer(data, "<f8", n, HEAD.size).copy())
        return None

    def statistics(self) -> dict[str, str]:
        """Counts that are not zero."""
        counts = {"packets_lost": self.lost, "packets_reordered": self.reordered}
        counts |= {f"refused_{reason}": count for reason, count in sorted(self.refused.items())}
        return {name: str(count) for name, count in counts.items() if count}
