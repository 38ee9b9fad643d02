"""Digest of a whole MCAP file: of every byte up to its footer, in the last record of its summary.

The record has the type `OP_DIGEST`, which the format leaves to applications and other readers skip; the digest is its
content. Behind it are the footer, whose checksum is of the summary and itself, and the magic number. A recording that
broke off has none: the digests in its manifests are of its chunks alone. Whoever can write the file can write another
digest: only a signature of it tells who wrote it.
"""

from __future__ import annotations

import hashlib
from typing import BinaryIO

SIZE = 32
"""Bytes of a digest."""
OTHER_DIGEST = "the digest at the end is not that of the file"
PIECE = 1 << 20
"""Bytes that are read at once."""


def new_digest() -> hashlib.blake2b:
    """BLAKE2b of the bytes that it is given, one after another."""
    return hashlib.blake2b(digest_size=SIZE)


def digest_before(stream: BinaryIO, end: int) -> bytes:
    """Digest of a file from its beginning to a place."""
    digest, left = new_digest(), end
    stream.seek(0)
    while left and (part := stream.read(min(left, PIECE))):
        digest.update(part)
        left -= len(part)
    return digest.digest()
