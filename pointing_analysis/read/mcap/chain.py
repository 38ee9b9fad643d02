"""Hash chain of a file: every manifest, metadata record and attachment is bound to all of them before it.

The digest of the chain behind a record is the BLAKE2b digest of the digest before it, the type of the record and its
content. A manifest holds number and digest in its last row of runs, which belongs to no record, so that readers of
older versions read it as before; they count as zeros in the content. The last record of a whole file, `SEAL`, holds the
digest at the end. Chunks are bound by the digests in their manifests; indexes and the summary are not bound.

Whoever can write the file can write another chain: only a signature of its digest tells who wrote it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

SEAL = "los_testbed_chain"
"""Name of the metadata record with the digest at the end."""
DIGEST_SIZE = 16
NOTHING = bytes(DIGEST_SIZE)
"""Digest before the first record."""


def next_digest(before: bytes, op: int, body: bytes) -> bytes:
    """Digest of the chain behind a record of this type and content."""
    return hashlib.blake2b(before + bytes([op]) + body, digest_size=DIGEST_SIZE).digest()


@dataclass(frozen=True)
class Link:
    """Place of a manifest in the chain: its number from 1, the digest it holds, what its digest is computed of.

    Number 0: it has no place, as in bags of older versions.
    """

    number: int
    digest: bytes
    content: bytes


NO_LINK = Link(0, NOTHING, b"")
"""Of a manifest that was not read."""


@dataclass
class Chain:
    """The chain of a file as far as it was written or read.

    Attributes
    ----------
    digest : behind the last record
    manifests : in it
    linked : whether a manifest has held its place in the chain
    sealed : whether the record with the digest at the end was there
    unchecked : places where damage left open whether the chain was right
    broken : what contradicted it
    open : whether damage leaves the chain before the next manifest unknown
    """

    digest: bytes = NOTHING
    manifests: int = 0
    linked: bool = False
    sealed: bool = False
    unchecked: int = 0
    broken: list[str] = field(default_factory=list)
    open: bool = False

    def add(self, op: int, body: bytes) -> None:
        """Take a record into the chain."""
        self.digest = next_digest(self.digest, op, body)

    def lose(self) -> None:
        """A record is damaged: up to the next manifest nothing can be checked."""
        self.open = True

    def follow(self, op: int, link: Link) -> str:
        """Take a manifest into the chain; what contradicts the chain, else empty."""
        expected, number = next_digest(self.digest, op, link.content), self.manifests + 1
        if not link.number:
            self.digest, self.manifests = expected, number
            return self._break("a manifest is not in the chain of the others") if self.linked else ""
        right = expected == link.digest and number == link.number
        self.linked, self.digest, self.manifests = True, link.digest, link.number
        if right:
            self.open = False
            return ""
        return self._break(f"manifest {link.number} does not continue the chain before it")

    def seal(self) -> dict[str, str]:
        """Content of the record at the end."""
        return {"manifests": str(self.manifests), "digest": self.digest.hex()}

    def check_seal(self, table: Mapping[str, str]) -> str:
        """Compare with the record at the end; what contradicts the chain, else empty."""
        self.sealed = True
        same = dict(table) == self.seal()
        self.open &= not same
        return "" if same else self._break("the end of the chain does not match the chain before it")

    def check_end(self) -> str:
        """End of a complete file."""
        missing = self.linked and not self.sealed
        return self._break("the record with the end of the chain is missing") if missing else ""

    def check_after(self) -> str:
        """At a record that the chain binds, or a chunk."""
        return self._break("a record follows the end of the chain") if self.sealed else ""

    def _break(self, what: str) -> str:
        if self.open:
            self.open = False
            self.unchecked += 1
            return ""
        self.broken.append(what)
        return what
