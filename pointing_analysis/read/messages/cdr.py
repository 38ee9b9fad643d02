"""CDR messages with a fixed layout: encoding in place, and decoding of many at once.

A stamped ROS message differs from one sample to the next only in numbers, not in shape: the frame name and the joint
names keep their lengths. An :class:`Encoder` writes stamp and values into one buffer at fixed offsets. For reading,
:func:`layout` derives the offsets from the first message; all messages of the same size are decoded by one numpy
view, each is checked against the layout, and those that differ are decoded one by one.

Messages are written as plain little-endian CDR (first bytes ``00 01 00 00``), alignment counted from the fifth byte.
Times are nanoseconds since the epoch of the run's clock.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError
from pointing_analysis.arrays import BoolArray, FloatArray, IntArray
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.message_types import (
    ACCEL,
    COLUMNS,
    HEADER,
    IMAGE,
    IMAGE_ENCODING,
    JOINT_NAMES,
    JOINT_STATE,
    VECTOR3,
)

ENCAPSULATION = b"\x00\x01\x00\x00"
PLAIN_CDR = {0: ">", 1: "<"}
"""Encapsulations that are read, with the order of their bytes."""
OTHER_ENCAPSULATIONS = {
    2: "PL_CDR (parameter list, big-endian)",
    3: "PL_CDR (parameter list, little-endian)",
    4: "XML",
    6: "XCDR2 (plain, big-endian)",
    7: "XCDR2 (plain, little-endian)",
    8: "XCDR2 (delimited, big-endian)",
    9: "XCDR2 (delimited, little-endian)",
    10: "XCDR2 (parameter list, big-endian)",
    11: "XCDR2 (parameter list, little-endian)",
}
"""Names of those that are not, for messages (OMG DDS-XTypes 1.3, 7.6.3.1.2)."""
STAMP = struct.Struct("<iI")
"""Seconds and nanoseconds of a stamp; it follows the encapsulation header."""
STAMP_OFFSET = len(ENCAPSULATION)
NS_PER_S = 1_000_000_000
_LENGTH = struct.Struct("<I")
_FIXED = {ACCEL: 6, VECTOR3: 3, HEADER: 0}
_NO_VALUES: FloatArray = np.empty(0)


def _aligned(offset: int, size: int) -> int:
    """Next multiple of `size`, counted from the end of the encapsulation header."""
    return offset + (-(offset - STAMP_OFFSET)) % size


def _padded(data: bytes, size: int) -> bytes:
    return data + bytes(_aligned(len(data), size) - len(data))


def _string(text: str) -> bytes:
    raw = text.encode() + b"\x00"
    return _LENGTH.pack(len(raw)) + raw


def _template(type_name: str, size: int, frame_id: str, names: Sequence[str]) -> tuple[bytes, int]:
    """Message of zeros, and the offset of its values."""
    data = ENCAPSULATION + bytes(STAMP.size) + _string(frame_id)
    if type_name == HEADER:
        return data, len(data)
    if type_name == IMAGE:
        side = math.isqrt(size)
        data = _padded(data, 4) + 2 * _LENGTH.pack(side) + _string(IMAGE_ENCODING) + b"\x00"  # little-endian
        data = _padded(data, 4) + _LENGTH.pack(2 * side) + _LENGTH.pack(2 * size)
        return _padded(data + bytes(2 * size), 4), len(data)  # the middleware fills up to four bytes
    if type_name == JOINT_STATE:
        data = _padded(data, 4) + _LENGTH.pack(size)
        for i in range(size):
            data = _padded(data, 4) + _string(names[i] if i < len(names) else f"joint_{i + 1}")
        data = _padded(data, 4) + bytes(2 * _LENGTH.size) + _LENGTH.pack(size)  # no positions, no velocities
    data = _padded(data, 8)
    return data + bytes(8 * _FIXED.get(type_name, size)), len(data)


class Encoder:
    """Messages of one topic as bytes; stamp and values are written in place into one buffer.

    Parameters
    ----------
    type_name : str
        AccelStamped, Vector3Stamped, JointState (efforts), Image (square, 16 bit) or Header.
    size : int
        Number of values: 6 (acceleration: linear then angular), 2 or 3 (a vector; what is left out is sent as 0), any
        number of efforts, the square of a whole number (pixels, row by row), 0 (header).
    frame_id : str
        Frame in the header.
    names : sequence of str
        What the efforts of a JointState belong to.

    Raises
    ------
    ValueError
        Another type, or a number of values that it does not have.

    Examples
    --------
    >>> message = Encoder(VECTOR3, 2, "fsm").encode(1_002_000_000, np.array([1e-6, -2e-6]))
    >>> message.hex(" ", 4)[:26], len(message)
    ('00010000 01000000 80841e00', 44)
    """

    def __init__(self, type_name: str, size: int, frame_id: str, names: Sequence[str] = JOINT_NAMES) -> None:
        if type_name not in (*_FIXED, JOINT_STATE, IMAGE):
            raise InputError(f"type_name must be one of {', '.join((*_FIXED, JOINT_STATE, IMAGE))}, got {type_name!r}")
        if not 0 <= size <= _FIXED.get(type_name, size):
            raise InputError(f"size must be 0 to {_FIXED.get(type_name)} for {type_name}, got {size}")
        if type_name == IMAGE and math.isqrt(size) ** 2 != size:
            raise InputError(f"size must be the square of a whole number for {type_name}, got {size}")
        self.type_name = type_name
        self.size = size
        self.frame_id = frame_id
        template, self._offset = _template(type_name, size, frame_id, names)
        self._buffer = bytearray(template)
        self.number = np.dtype("<u2" if type_name == IMAGE else "<f8")
        self._values = np.frombuffer(self._buffer, self.number, size, self._offset) if size else _NO_VALUES
        self._template = np.frombuffer(template, np.uint8)

    @property
    def length(self) -> int:
        """Bytes of a message."""
        return len(self._buffer)

    @property
    def message(self) -> bytearray:
        """The message that was encoded last."""
        return self._buffer

    def encode(self, stamp_ns: int, values: FloatArray = _NO_VALUES) -> bytearray:
        """Message with this stamp [ns] and `values` (size,); the next call uses the same buffer."""
        STAMP.pack_into(self._buffer, STAMP_OFFSET, *divmod(stamp_ns, NS_PER_S))
        self._values[:] = values
        return self._buffer

    def encode_many(self, stamps_ns: IntArray, values: FloatArray) -> NDArray[np.uint8]:
        """Messages (n, length) of many ticks at once: the bytes that `encode` gives for each."""
        out = np.tile(self._template, (len(stamps_ns), 1))
        seconds, rest = np.divmod(stamps_ns, NS_PER_S)
        out[:, 4:8] = seconds.astype("<i4")[:, None].view(np.uint8)
        out[:, 8:12] = rest.astype("<u4")[:, None].view(np.uint8)
        stop = self._offset + self.number.itemsize * self.size
        out[:, self._offset : stop] = np.ascontiguousarray(values, self.number).view(np.uint8)
        return out


@dataclass(frozen=True)
class Layout:
    """Offsets of the parts of a payload.

    Attributes
    ----------
    values : offset of the first float64
    count : number of float64 values
    lengths : offset and value of every length field; a message with others has another layout
    order : ``<`` or ``>``
    """

    values: int
    count: int
    lengths: tuple[tuple[int, int], ...]
    order: str


def byte_order(schema: str, payload: bytes) -> str:
    """Order of the bytes of a message by its encapsulation header, ``<`` or ``>``.

    Raises
    ------
    BagError
        Another encapsulation than plain CDR, or a message of less than four bytes.
    """
    if len(payload) < len(ENCAPSULATION):
        raise BagError(f"{schema} must be plain CDR, got {len(payload)} bytes")
    kind = int.from_bytes(payload[:2], "big")
    if kind not in PLAIN_CDR:
        name = OTHER_ENCAPSULATIONS.get(kind, "an unknown encapsulation")
        raise BagError(f"{schema} must be plain CDR, got {name} (first bytes {payload[:2].hex()})")
    return PLAIN_CDR[kind]


class Cursor:
    """Reads length fields while keeping CDR's alignment, which counts from the end of the encapsulation header."""

    def __init__(self, payload: bytes, order: str) -> None:
        self.payload, self.order, self.at = payload, order, STAMP_OFFSET
        self.lengths: list[tuple[int, int]] = []

    def align(self, size: int) -> None:
        """Go on to the next multiple of a size."""
        self.at = _aligned(self.at, size)

    def length(self) -> int:
        """Number of elements or bytes that follow."""
        self.align(4)
        (n,) = struct.unpack_from(self.order + "I", self.payload, self.at)
        self.lengths.append((self.at, n))
        self.at += 4
        if n > len(self.payload):
            raise struct.error("length beyond the end of the message")
        return int(n)

    def string(self) -> None:
        """Go behind a string."""
        n = self.length()
        self.at += n

    def doubles(self) -> tuple[int, int]:
        """Offset and number of the float64 values of a sequence, behind which it goes."""
        n = self.length()
        if n:
            self.align(8)
        start = self.at
        self.at += 8 * n
        return start, n


def layout(schema: str, payload: bytes) -> Layout:
    """Derive the layout of a message type from one of its messages.

    Raises
    ------
    BagError
        The type is not one of `COLUMNS`, the encoding is not plain CDR, or the payload is too short.
    """
    if schema not in COLUMNS:
        raise BagError(f"message type must be one of {', '.join(COLUMNS)}, got {schema!r}")
    cursor = Cursor(payload, byte_order(schema, payload))
    try:
        cursor.at = STAMP_OFFSET + STAMP.size
        cursor.string()
        if schema in _FIXED:
            cursor.align(8)
            start, count = cursor.at, _FIXED[schema]
        else:
            for _ in range(cursor.length()):
                cursor.string()
            cursor.doubles()
            cursor.doubles()
            start, count = cursor.doubles()
    except struct.error:
        start, count = len(payload), 1
    if start + 8 * count > len(payload):
        raise BagError(f"{schema}: the payload of {len(payload)} bytes is truncated")
    return Layout(start, count, tuple(cursor.lengths), cursor.order)


def same_order(rows: NDArray[np.uint8], order: str) -> BoolArray:
    """Which messages (m, size) are plain CDR in this order of bytes."""
    return np.asarray((rows[:, 0] == 0) & (rows[:, 1] == (order == "<")))


def column(rows: NDArray[np.uint8], at: int, kind: str, n: int = 1) -> NDArray[np.generic]:
    """Numbers (m, n) of a numpy type at an offset of messages (m, size)."""
    width = np.dtype(kind).itemsize * n
    view: NDArray[np.generic] = np.ascontiguousarray(rows[:, at : at + width]).view(kind)
    return view


def stamps_of(rows: NDArray[np.uint8], order: str) -> IntArray:
    """Header stamps [ns] of messages (m, size) that begin with a header."""
    seconds = column(rows, STAMP_OFFSET, order + "i4")[:, 0].astype(np.int64)
    rest = column(rows, STAMP_OFFSET + 4, order + "u4")[:, 0].astype(np.int64)
    return np.asarray(seconds * NS_PER_S + rest)


def decode(rows: NDArray[np.uint8], plan: Layout) -> tuple[IntArray, FloatArray, BoolArray]:
    """Decode payloads of equal length.

    Parameters
    ----------
    rows : (m, size) payload bytes
    plan : layout of their first message

    Returns
    -------
    stamp : (m,) header stamp [ns]
    values : (m, count)
    fits : (m,) False where a length field differs from the layout (the values of that row are meaningless)
    """
    fits = same_order(rows, plan.order)
    for at, value in plan.lengths:
        fits &= column(rows, at, plan.order + "u4")[:, 0] == value
    values = column(rows, plan.values, plan.order + "f8", plan.count).astype(np.float64, copy=False)
    return stamps_of(rows, plan.order), values, fits
