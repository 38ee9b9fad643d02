"""Manifest of a chunk: its records with a checksum of each, so that what is whole in a damaged chunk can be used.

The recorder writes it before the chunk as a record of type `OP_MANIFEST`, which the format leaves to applications and
other readers skip. Layout, little-endian: CRC-32 of the rest; CRC-32 and size [byte] (8) of the chunk's content;
version (4); BLAKE2b digest (16) of the content; length and rows of the runs of records of equal length (`RUN`); length
and CRC-32 of each record, head included. The digest is there because the CRC-32 of the whole follows from those of its
parts and would confirm any change that agrees with them.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pointing_analysis.arrays import BoolArray, IntArray

VERSION = 1
_HEAD = struct.Struct("<IIQI16s")
RUN = np.dtype(
    [
        ("channel", "<u2"),  # 0: records that are no messages
        ("count", "<u4"),
        ("length", "<u4"),  # of each record [byte], head included
        ("sequence", "<u4"),  # of the first message
        ("first", "<u8"),  # log times [ns]
        ("last", "<u8"),
    ]
)
BURST = 4
"""Longest damage within one record that its checksum can undo [byte]."""
MAX_LENGTH, MAX_WORK = 100_000, 2_000_000_000
"""Damage is undone in records of this length at most [byte], by trials that read so many bytes of the chunk."""


@dataclass(frozen=True)
class Manifest:
    """Required content of a chunk.

    Attributes
    ----------
    checksum, digest, size : CRC-32, BLAKE2b digest and length [byte] of its content
    runs : (k,) of `RUN`, in the order of the content
    checksums : (n,) CRC-32 of each record
    damaged : whether something in it was wrong when it was read
    verified : whether its own checksum agrees now; if not, it serves to find whole records, but proves no loss
    """

    checksum: int
    digest: bytes
    size: int
    runs: NDArray[np.void]
    checksums: NDArray[np.uint32]
    damaged: bool = False
    verified: bool = True

    @property
    def offsets(self) -> IntArray:
        """(n + 1,) where each record begins, and where the last one ends."""
        lengths = np.repeat(self.runs["length"].astype(np.int64), self.runs["count"])
        return np.append(0, np.cumsum(lengths))

    def names(self, digest: bytes) -> bool:
        """Whether it is whole and of the content with this digest."""
        return self.verified and self.digest == digest


def content_digest(content: bytes | bytearray) -> bytes:
    """BLAKE2b digest (16 bytes) of the content of a chunk."""
    return hashlib.blake2b(content, digest_size=16).digest()


def encode_manifest(content: bytes, runs: Sequence[tuple[int, ...]], checksum: int | None = None) -> bytes:
    """Body of the manifest record of a chunk whose content consists of these runs of records.

    `checksum` is the CRC-32 of the content, where it is known.
    """
    rows = np.array([tuple(run) for run in runs], RUN)
    checksums: list[int] = []
    at = 0
    for count, length in zip(rows["count"].tolist(), rows["length"].tolist()):
        if count and length:
            records: list[bytes] = np.frombuffer(content, f"V{length}", count, at).tolist()
            checksums += map(zlib.crc32, records)
        at += count * length
    crcs = np.array(checksums, "<u4").tobytes()
    checksum = zlib.crc32(content) if checksum is None else checksum
    rest = _HEAD.pack(0, checksum, len(content), VERSION, content_digest(content))[4:]
    rest += struct.pack("<I", rows.nbytes) + rows.tobytes()
    rest += struct.pack("<I", len(crcs)) + crcs
    return struct.pack("<I", zlib.crc32(rest)) + rest


def decode_manifest(body: bytes) -> Manifest | None:
    """Read a manifest record; one wrong bit in it is undone. None if it is of another version or its sizes disagree."""
    if len(body) < _HEAD.size + 8:
        return None
    read = body
    body, verified = _one_bit_undone(read)
    _, checksum, size, version, digest = _HEAD.unpack_from(body)
    (length,) = struct.unpack_from("<I", body, _HEAD.size)
    at = _HEAD.size + 4 + length
    if version != VERSION or length % RUN.itemsize or at + 4 > len(body):
        return None
    runs = np.frombuffer(body, RUN, length // RUN.itemsize, _HEAD.size + 4)
    checksums = np.frombuffer(body[at + 4 :], "<u4") if (len(body) - at) % 4 == 0 else np.empty(0, "<u4")
    counts = runs["count"].astype(np.int64)
    if checksums.size != counts.sum() or (counts * runs["length"]).sum() != size:
        return None
    return Manifest(checksum, digest, size, runs, checksums, not verified or body != read, verified)


def _one_bit_undone(body: bytes) -> tuple[bytes, bool]:
    """The body of a manifest, with one wrong bit undone where its checksum tells which; whether the checksum agrees.

    No two single bits of less than 2^32 give the same difference of CRC-32.
    """
    (checksum,) = struct.unpack_from("<I", body)
    syndrome = zlib.crc32(body[4:]) ^ checksum
    if syndrome.bit_count() <= 1:  # all agrees, or the bit is in the checksum itself
        return struct.pack("<I", checksum ^ syndrome) + body[4:], True
    if len(body) > MAX_LENGTH:
        return body, False
    for at, pattern in _bursts(syndrome, len(body) - 4):
        bits = int.from_bytes(pattern, "little")
        if bits.bit_count() == 1:
            right = bytearray(body)
            _add(pattern, right, 4 + at)
            return bytes(right), True
    return body, False


def salvage(content: bytes, manifest: Manifest) -> tuple[bytes, BoolArray]:
    """Find the whole records of a damaged chunk, and undo short damage where the chunk's digest proves it right.

    Parameters
    ----------
    content : what could be unpacked of the chunk; shorter than it should be, if it broke off
    manifest : of the chunk

    Returns
    -------
    content : with the damage undone, or as it was
    whole : (n,) the records whose checksum agrees
    """
    offsets, view = manifest.offsets, memoryview(content)
    there = offsets[1:] <= len(content)
    whole = np.zeros(len(there), bool)
    pairs = zip(offsets[:-1].tolist(), offsets[1:].tolist(), manifest.checksums.tolist(), there.tolist())
    for i, (begin, end, checksum, inside) in enumerate(pairs):
        whole[i] = inside and zlib.crc32(view[begin:end]) == checksum
    wrong = np.flatnonzero(~whole)
    if len(content) == manifest.size and 0 < wrong.size <= 1000:
        mended = _mended(bytearray(content), manifest, wrong.tolist())
        if mended is not None:
            return mended, np.ones_like(whole)
    return content, whole


def _mended(content: bytearray, manifest: Manifest, wrong: Sequence[int]) -> bytes | None:
    """The content with damage of at most `BURST` bytes in each wrong record undone; None unless the whole agrees."""
    offsets = manifest.offsets
    choices = []
    for i in wrong:
        begin, end = int(offsets[i]), int(offsets[i + 1])
        if end - begin > MAX_LENGTH:
            return None
        bursts = _bursts(zlib.crc32(content[begin:end]) ^ int(manifest.checksums[i]), end - begin)
        if not bursts:
            return None
        choices.append([(begin + at, pattern) for at, pattern in bursts])
    # Fewest damaged bytes first. With one wrong record the chunk's digest chooses among all.
    trials = choices[0] if len(choices) == 1 else [None]
    for trial in trials[: max(MAX_WORK // max(len(content), 1), 1)]:
        changed = bytearray(content)
        for at, pattern in [trial] if trial is not None else [options[0] for options in choices]:
            _add(pattern, changed, at)
        if content_digest(changed) == manifest.digest:
            return bytes(changed)
    return None


def _add(pattern: bytes, content: bytearray, at: int) -> None:
    """Add a difference of `BURST` bytes to the content, modulo 2."""
    content[at : at + BURST] = bytes(a ^ b for a, b in zip(content[at : at + BURST], pattern))


_TABLE = [zlib.crc32(bytes([i])) ^ zlib.crc32(b"\0") for i in range(256)]
_BACK = {entry >> 24: (i, entry) for i, entry in enumerate(_TABLE)}


def _bursts(syndrome: int, length: int) -> list[tuple[int, bytes]]:
    """Differences of up to `BURST` bytes that change the CRC-32 of a record by `syndrome`: offset, bytes.

    The CRC is linear: the difference of two records of equal length gives the difference of their checksums, and a zero
    byte at the end of the record can be taken off again.
    """
    bursts = []
    for behind in range(length):
        index, entry = _BACK[syndrome >> 24]
        syndrome = (((syndrome ^ entry) << 8) & 0xFFFFFFFF) | index
        at = length - behind - 1
        if at <= length - BURST:
            bursts.append((at, syndrome.to_bytes(BURST, "little")))
    return sorted(bursts, key=lambda row: BURST - row[1].count(0))
