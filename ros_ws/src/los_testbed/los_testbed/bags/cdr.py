"""Messages of the loop's topics as bytes, without message objects: :class:`Codec` writes and reads at fixed offsets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.config.topics import TopicDefinition
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.cdr import ENCAPSULATION, NS_PER_S, STAMP, STAMP_OFFSET, Encoder, layout
from pointing_analysis.read.messages.message_types import JOINT_NAMES, JOINT_STATE

_FRAME_OFFSET = STAMP_OFFSET + STAMP.size
_LITTLE_ENDIAN = ENCAPSULATION[:2]


class CodecError(InputError):
    """A message that does not have the type of its topic; `reason` is ``encoding`` or ``size``."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Codec(Encoder):
    """Bytes of one topic's messages: those of :class:`~pointing_analysis.read.messages.cdr.Encoder`, and back.

    Messages with another frame or other joint names are read as well, at the offsets that they have.

    Examples
    --------
    >>> codec = Codec("geometry_msgs/msg/Vector3Stamped", 2, "fsm")
    >>> data = codec.encode(1_002_000_000, np.array([1e-6, -2e-6]))
    >>> out = np.zeros(2)
    >>> codec.decode(bytes(data), out), out.tolist()
    (1002000000, [1e-06, -2e-06])
    """

    def __init__(self, type_name: str, size: int, frame_id: str, names: Sequence[str] = JOINT_NAMES) -> None:
        super().__init__(type_name, size, frame_id, names)
        self._fixed = bytes(self._buffer[_FRAME_OFFSET : self._offset])

    def decode(self, data: bytes, out: FloatArray) -> int:
        """Read the numbers into `out` (size,) and return the stamp [ns].

        Raises
        ------
        CodecError
            Not little-endian CDR, truncated, or another number of efforts.
        """
        fixed = data[_FRAME_OFFSET : self._offset] == self._fixed
        if fixed and len(data) == len(self._buffer) and data[:2] == _LITTLE_ENDIAN:
            out[:] = np.frombuffer(data, self.number, self.size, self._offset)
        else:
            out[:] = np.frombuffer(data, self.number, self.size, self._find(data))
        seconds, rest = STAMP.unpack_from(data, STAMP_OFFSET)
        return int(seconds) * NS_PER_S + int(rest)

    def _find(self, data: bytes) -> int:
        """Offset of the numbers in a message with another frame or other joint names."""
        if data[:2] != _LITTLE_ENDIAN:
            raise CodecError("encoding", f"message must be little-endian CDR, got one that starts {data[:4].hex()}")
        try:
            place = layout(self.type_name, data)
        except BagError as error:
            raise CodecError("size", str(error)) from None
        if self.type_name == JOINT_STATE and place.count != self.size:
            raise CodecError("size", f"message must hold {self.size} efforts, got {place.count}")
        return place.values


def stamp_of(data: bytes | bytearray) -> int:
    """Stamp [ns] of any message that begins with a header."""
    seconds, rest = STAMP.unpack_from(data, STAMP_OFFSET)
    return int(seconds) * NS_PER_S + int(rest)


def with_stamp(data: bytes, stamp: int) -> bytes:
    """A message that begins with a header, with another stamp [ns].

    Examples
    --------
    >>> stamp_of(with_stamp(bytes(12), 1_002_000_000))
    1002000000
    """
    changed = bytearray(data)
    STAMP.pack_into(changed, STAMP_OFFSET, *divmod(stamp, NS_PER_S))
    return bytes(changed)


def codec_for(topic: TopicDefinition) -> Codec:
    """Codec of a row of the table of topics."""
    return Codec(topic.type_name, topic.size, topic.frame_id)
