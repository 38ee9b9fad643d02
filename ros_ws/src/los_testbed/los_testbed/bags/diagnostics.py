"""Reading of ``diagnostic_msgs/DiagnosticArray`` from bytes, with checks; bytes of any kind are read or refused."""

from __future__ import annotations

import struct

from los_testbed.bags.cdr import CodecError
from pointing_analysis.cdr import ENCAPSULATION

_LENGTH = struct.Struct("<I")
_HEADER = len(ENCAPSULATION) + 8


class _Reader:
    """Position in the serialised message; alignment counts from the end of the encapsulation header."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = _HEADER

    def number(self) -> int:
        self.at += -(self.at - len(ENCAPSULATION)) % _LENGTH.size
        if self.at + _LENGTH.size > len(self.data):
            raise CodecError("size", f"message must go on after byte {self.at}, got {len(self.data)} bytes")
        value = int(_LENGTH.unpack_from(self.data, self.at)[0])
        self.at += _LENGTH.size
        return value

    def text(self) -> str:
        length = self.number()
        raw = self.data[self.at : self.at + length]
        if len(raw) < length or not raw.endswith(b"\0"):
            raise CodecError("size", f"text at byte {self.at} must have {length} bytes that end with 0, got {len(raw)}")
        self.at += length
        try:
            return raw[:-1].decode()
        except UnicodeDecodeError:
            raise CodecError(
                "encoding", f"text at byte {self.at - length} must be UTF-8, got {raw[:8].hex()}"
            ) from None

    def byte(self) -> None:
        self.at += 1


def read_diagnostics(data: bytes) -> tuple[str, list[tuple[str, dict[str, str]]]]:
    """Frame of a serialised message, and name and values of each status.

    Raises
    ------
    CodecError
        Not little-endian CDR, cut short, or texts that are none.
    """
    if data[:2] != ENCAPSULATION[:2]:
        raise CodecError("encoding", f"message must be little-endian CDR, got one that starts {data[:4].hex()}")
    reader = _Reader(data)
    frame, found = reader.text(), []
    for _ in range(reader.number()):
        reader.byte()
        name = reader.text()
        reader.text(), reader.text()
        found.append((name, {reader.text(): reader.text() for _ in range(reader.number())}))
    return frame, found
