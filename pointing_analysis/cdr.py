"""Bulk decoding of CDR messages with a fixed layout.

A stamped ROS message differs from one sample to the next only in numbers, not in shape: the frame name and the joint
names keep their lengths. So the layout is derived once from the first message, and all messages of the same size are
decoded by one numpy view; each is checked against the layout, and the rare odd one is decoded alone.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointing_analysis.mcap_records import BagError

#: message type -> (names of the values, unit of the values)
SUPPORTED = {
    "geometry_msgs/msg/AccelStamped": ("linear.x linear.y linear.z angular.x angular.y angular.z", "m/s2, rad/s2"),
    "geometry_msgs/msg/Vector3Stamped": ("vector.x vector.y vector.z", "rad"),
    "sensor_msgs/msg/JointState": ("effort", "N"),
}
_FIXED = {"geometry_msgs/msg/AccelStamped": 6, "geometry_msgs/msg/Vector3Stamped": 3}
_STAMP = 4  # the stamp follows the 4-byte encapsulation header


@dataclass(frozen=True)
class Layout:
    """Where things lie in a payload.

    Attributes
    ----------
    size : length of the payload [byte], encapsulation header included
    values : offset of the first float64
    count : number of float64 values
    lengths : offset and value of every length field; a message with others has another layout
    order : ``<`` or ``>``
    """

    size: int
    values: int
    count: int
    lengths: tuple[tuple[int, int], ...]
    order: str


class _Cursor:
    """Reads length fields while keeping CDR's alignment, which counts from the end of the encapsulation header."""

    def __init__(self, payload: bytes, order: str) -> None:
        self.payload, self.order, self.at = payload, order, 4
        self.lengths: list[tuple[int, int]] = []

    def align(self, size: int) -> None:
        self.at += -(self.at - 4) % size

    def length(self) -> int:
        self.align(4)
        (n,) = struct.unpack_from(self.order + "I", self.payload, self.at)
        self.lengths.append((self.at, n))
        self.at += 4
        return int(n)

    def string(self) -> None:
        n = self.length()
        self.at += n

    def doubles(self) -> tuple[int, int]:
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
        The type is not one of `SUPPORTED`, the encoding is not plain CDR, or the payload is too short.
    """
    if schema not in SUPPORTED:
        raise BagError(f"expected one of {', '.join(SUPPORTED)}; got {schema!r}")
    if len(payload) < 16 or payload[0] != 0 or payload[1] not in (0, 1):
        raise BagError(
            f"{schema}: expected a plain CDR payload; got {len(payload)} bytes beginning {payload[:4].hex()}"
        )
    cursor = _Cursor(payload, "<" if payload[1] else ">")
    try:
        cursor.at = _STAMP + 8
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
        raise BagError(f"{schema}: the payload of {len(payload)} bytes is too short for its contents")
    return Layout(len(payload), start, count, tuple(cursor.lengths), cursor.order)


def decode(rows: NDArray[np.uint8], plan: Layout) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Decode payloads of equal length.

    Parameters
    ----------
    rows : (m, size) payload bytes
    plan : layout of their first message

    Returns
    -------
    stamp : (m,) header stamp [ns]
    values : (m, count)
    fits : (m,) False where a length field differs from the layout (that row's values mean nothing)
    """

    def column(at: int, kind: str, n: int = 1) -> NDArray[np.generic]:
        width = np.dtype(kind).itemsize * n
        view: NDArray[np.generic] = np.ascontiguousarray(rows[:, at : at + width]).view(plan.order + kind)
        return view

    fits = rows[:, 1] == (plan.order == "<")
    for at, value in plan.lengths:
        fits &= column(at, "u4")[:, 0] == value
    seconds = column(_STAMP, "i4")[:, 0].astype(np.int64)
    stamp = seconds * 1_000_000_000 + column(_STAMP + 4, "u4")[:, 0].astype(np.int64)
    return stamp, column(plan.values, "f8", plan.count).astype(np.float64, copy=False), fits


def decode_any(schema: str, payloads: Sequence[bytes]) -> tuple[NDArray[np.int64], list[NDArray[np.float64]]]:
    """Decode payloads of any lengths, one by one."""
    stamps, values = [], []
    for payload in payloads:
        stamp, row, _ = decode(np.frombuffer(payload, np.uint8)[None, :], layout(schema, payload))
        stamps.append(int(stamp[0]))
        values.append(row[0])
    return np.array(stamps, dtype=np.int64), values
