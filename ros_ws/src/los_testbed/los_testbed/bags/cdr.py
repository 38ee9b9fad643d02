"""Raw CDR messages at fixed offsets: AccelStamped, Vector3Stamped, JointState (effort).

The hot path never makes a message object. A :class:`Codec` holds one byte buffer whose header and
frame are written once; a tick overwrites the stamp and the numbers in place. The layouts are those of
plain CDR, little endian (first bytes ``00 01 00 00``), with alignment counted from the fifth byte.
Times are nanoseconds since the epoch of the run's clock.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from los_testbed.topics import ACCEL, JOINT_STATE, VECTOR3, Topic

FloatArray = NDArray[np.float64]
ByteArray = NDArray[np.uint8]

ENCAPSULATION = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_NS = 1_000_000_000

JOINT_NAMES = tuple(f"pma_{i}" for i in range(1, 7))
"""Names of the actuators in a JointState. Tools label the efforts by them; PlotJuggler reads past the end of
its memory if there are efforts and no names."""


class CodecError(ValueError):
    """A message that is not what its topic carries; `reason` is ``encoding`` or ``size``."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def _align(offset: int, to: int) -> int:
    """Next multiple of `to`, counted from the end of the 4-byte encapsulation header."""
    return offset + (-(offset - 4)) % to


class Codec:
    """Bytes of one topic's messages.

    Parameters
    ----------
    type_name : str
        One of the three types above.
    size : int
        Numbers of interest: 6 (acceleration: linear then angular), 2 (x and y of a vector; z is sent
        as 0 and not read) or the number of efforts.
    frame_id : str
        Frame in the header of what is sent; messages with other frames are read as well.

    Raises
    ------
    ValueError
        A type that has no codec.

    Examples
    --------
    >>> codec = Codec("geometry_msgs/msg/Vector3Stamped", 2, "fsm")
    >>> data = codec.encode(1_002_000_000, np.array([1e-6, -2e-6]))
    >>> out = np.zeros(2)
    >>> codec.decode(bytes(data), out), out.tolist()
    (1002000000, [1e-06, -2e-06])
    """

    def __init__(self, type_name: str, size: int, frame_id: str) -> None:
        if type_name not in _START:
            raise ValueError(f"expected one of {', '.join(_START)}, got {type_name!r}")
        self.type_name = type_name
        self.size = size
        self.frame_id = frame_id
        frame = frame_id.encode() + b"\x00"
        head = ENCAPSULATION + bytes(8) + _LENGTH.pack(len(frame)) + frame
        body, self._offset = _layout(type_name, size, head)
        self._buffer = bytearray(body)
        self._values = np.frombuffer(self._buffer, "<f8", size, self._offset)
        self._fixed = bytes(body[12 : self._offset])
        self._template = np.frombuffer(bytes(body), np.uint8)

    @property
    def length(self) -> int:
        """Bytes of a message that :meth:`encode` makes."""
        return len(self._buffer)

    def encode(self, stamp_ns: int, values: FloatArray) -> bytearray:
        """Message with this stamp [ns] and `values` (size,); the buffer is used again by the next call."""
        _STAMP.pack_into(self._buffer, 4, *divmod(stamp_ns, _NS))
        self._values[:] = values
        return self._buffer

    def encode_many(self, stamps_ns: NDArray[np.int64], values: FloatArray) -> ByteArray:
        """Messages (n, length) of many ticks at once, the same bytes as `encode` gives one by one."""
        out = np.tile(self._template, (len(stamps_ns), 1))
        seconds, rest = np.divmod(stamps_ns, _NS)
        out[:, 4:8] = seconds.astype("<i4")[:, None].view(np.uint8)
        out[:, 8:12] = rest.astype("<u4")[:, None].view(np.uint8)
        stop = self._offset + 8 * self.size
        out[:, self._offset : stop] = np.ascontiguousarray(values, "<f8").view(np.uint8)
        return out

    def decode(self, data: bytes, out: FloatArray) -> int:
        """Read the numbers into `out` (size,) and return the stamp [ns].

        Raises
        ------
        CodecError
            Not little-endian CDR, cut short, or another number of efforts.
        """
        if len(data) == len(self._buffer) and data[12 : self._offset] == self._fixed and data[:2] == b"\x00\x01":
            out[:] = np.frombuffer(data, "<f8", self.size, self._offset)
        else:
            out[:] = np.frombuffer(data, "<f8", self.size, self._find(data))
        seconds, rest = _STAMP.unpack_from(data, 4)
        return int(seconds) * _NS + int(rest)

    def _find(self, data: bytes) -> int:
        """Offset of the numbers in a message with another frame or with joint names."""
        if data[:2] != ENCAPSULATION[:2]:
            raise CodecError("encoding", f"expected plain little-endian CDR, the message starts {data[:4].hex()}")
        try:
            offset = 16 + _LENGTH.unpack_from(data, 12)[0]
            offset, count = _START[self.type_name](data, offset, self.size)
        except struct.error:
            raise CodecError("size", f"message of {len(data)} bytes is cut short") from None
        if count != self.size:
            raise CodecError("size", f"expected {self.size} numbers, got {count}")
        if offset + 8 * self.size > len(data):
            raise CodecError("size", f"message of {len(data)} bytes is cut short")
        return offset


class HeaderCodec:
    """Bytes of a std_msgs/Header without a frame: a stamp and nothing else."""

    def __init__(self) -> None:
        self._buffer = bytearray(ENCAPSULATION + bytes(8) + _LENGTH.pack(1) + b"\x00")

    def encode(self, stamp_ns: int) -> bytearray:
        """Message with this stamp [ns]; the buffer is used again by the next call."""
        _STAMP.pack_into(self._buffer, 4, *divmod(stamp_ns, _NS))
        return self._buffer


def stamp_of(data: bytes | bytearray) -> int:
    """Stamp [ns] of any message that begins with a header."""
    seconds, rest = _STAMP.unpack_from(data, 4)
    return int(seconds) * _NS + int(rest)


def codec_for(topic: Topic) -> Codec:
    """Codec of a row of the table."""
    return Codec(topic.type_name, topic.size, topic.frame_id)


def _padded(data: bytes, to: int) -> bytes:
    return data + bytes(_align(len(data), to) - len(data))


def _layout(type_name: str, size: int, head: bytes) -> tuple[bytes, int]:
    if type_name == JOINT_STATE:
        body = _padded(head, 4) + _LENGTH.pack(size)
        for i in range(size):
            name = (JOINT_NAMES[i] if i < len(JOINT_NAMES) else f"joint_{i + 1}").encode() + b"\x00"
            body = _padded(body, 4) + _LENGTH.pack(len(name)) + name
        body = _padded(body, 4) + bytes(8) + _LENGTH.pack(size)
        offset = _align(len(body), 8)
        return body + bytes(offset - len(body) + 8 * size), offset
    offset = _align(len(head), 8)
    numbers = {ACCEL: 6, VECTOR3: 3}[type_name]
    return head + bytes(offset - len(head) + 8 * numbers), offset


def _plain(data: bytes, offset: int, size: int) -> tuple[int, int]:
    return _align(offset, 8), size


def _joint_effort(data: bytes, offset: int, size: int) -> tuple[int, int]:
    """Walk over names, positions and velocities."""
    offset = _align(offset, 4)
    (names,) = _LENGTH.unpack_from(data, offset)
    offset += 4
    if names > len(data):
        raise CodecError("size", f"{names} joint names do not fit into {len(data)} bytes")
    for _ in range(names):
        offset = _align(offset, 4)
        offset += 4 + _LENGTH.unpack_from(data, offset)[0]
    for _ in ("position", "velocity"):
        offset = _align(offset, 4)
        (count,) = _LENGTH.unpack_from(data, offset)
        offset = _align(offset + 4, 8) + 8 * count if count else offset + 4
    offset = _align(offset, 4)
    (count,) = _LENGTH.unpack_from(data, offset)
    return _align(offset + 4, 8), count


_START: dict[str, Callable[[bytes, int, int], tuple[int, int]]] = {
    ACCEL: _plain,
    VECTOR3: _plain,
    JOINT_STATE: _joint_effort,
}
