"""Attitudes in messages of tf2: each message has any number of transforms, each with a stamp and frames of its own."""

from __future__ import annotations

import struct

from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.cdr import NS_PER_S, byte_order

TF_MESSAGE = "tf2_msgs/TFMessage"
_SMALLEST = 80
"""Fewest bytes of a transform: stamp, two empty names, seven numbers."""


Transform = tuple[str, int, tuple[float, float, float, float]]
"""Child frame, stamp [ns] and rotation (x, y, z, w)."""


def transforms(payload: bytes) -> list[Transform]:
    """Transforms of a message.

    Raises
    ------
    BagError
        Not plain CDR, or a truncated message.
    """
    order = byte_order(TF_MESSAGE, payload)
    whole, stamp, numbers = (struct.Struct(order + text) for text in ("I", "iI", "7d"))

    def aligned(at: int, size: int) -> int:
        return at + -(at - 4) % size

    def text(at: int) -> tuple[str, int]:
        at = aligned(at, 4)
        (n,) = whole.unpack_from(payload, at)
        end = at + 4 + int(n)
        if end > len(payload):
            raise struct.error("text beyond the end of the message")
        return payload[at + 4 : max(end - 1, at + 4)].decode("utf-8", "replace"), end

    decoded = []
    try:
        (count,) = whole.unpack_from(payload, 4)
        if count > len(payload) // _SMALLEST + 1:
            raise struct.error("more transforms than the message has bytes for")
        at = 8
        for _ in range(count):
            seconds, rest = stamp.unpack_from(payload, at := aligned(at, 4))
            _, at = text(at + stamp.size)
            child, at = text(at)
            at = aligned(at, 8)
            decoded.append((child, seconds * NS_PER_S + rest, numbers.unpack_from(payload, at)[3:]))
            at += numbers.size
    except struct.error:
        raise BagError(f"{TF_MESSAGE}: the payload of {len(payload)} bytes is truncated") from None
    return decoded
