"""Publishers of a run as its own nodes list them, in a file that only processes of the runner have open.

A node lists a publisher before it sends anything: whoever sends on a topic and is not in the list, while the topic's
node is, is not of the run, whatever its name. The file is in memory and inherited; another user cannot write to it.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os

MEMBERS_VARIABLE = "LOS_TESTBED_MEMBERS"
"""Path of the list, if a runner started this node."""

OWN, OTHER, PENDING, OPEN = "own", "other", "pending", "open"
"""What the list says of a publisher: of the run; not of it; the topic's node has not listed all of its own yet; the
list says nothing about the topic (there is none, or something else stands between the node and the topic)."""


class Members:
    """The list, as a node writes and reads it.

    Parameters
    ----------
    path : str
        The file; empty for a node that no runner started.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.NamedTemporaryFile() as file:
    ...     members = Members(file.name)
    ...     before = members.standing("/telescope/truth/los", "/telescope/plant", b"1")
    ...     members.add("/telescope/truth/los", b"1")
    ...     members.complete("/telescope/plant")
    ...     [before, *(members.standing("/telescope/truth/los", "/telescope/plant", gid) for gid in (b"1", b"2"))]
    ['pending', 'own', 'other']
    """

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_APPEND) if path else -1
        self._size = 0
        self._rest = b""
        self._own: dict[str, set[bytes]] = {}
        self._complete: set[str] = set()

    def add(self, topic: str, gid: bytes) -> None:
        """List a publisher of this node; nothing without a list."""
        self._write(json.dumps({"topic": topic, "gid": gid.hex()}) + "\n")

    def complete(self, node: str) -> None:
        """All publishers of a node are listed; nothing without a list."""
        self._write(complete_line(node))

    def _write(self, line: str) -> None:
        if self._file >= 0:
            os.write(self._file, line.encode())

    def _read(self) -> None:
        """Read what was added."""
        if self._file < 0 or os.fstat(self._file).st_size == self._size:
            return
        data = os.pread(self._file, 1 << 20, self._size)
        self._size += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            with contextlib.suppress(ValueError, KeyError):
                row = json.loads(line)
                if "node" in row:
                    self._complete.add(row["node"])
                else:
                    self._own.setdefault(row["topic"], set()).add(bytes.fromhex(row["gid"]))

    def standing(self, topic: str, node: str, gid: bytes) -> str:
        """:data:`OWN`, :data:`OTHER`, :data:`PENDING` or :data:`OPEN`.

        Parameters
        ----------
        topic : str
            Where a message came.
        node : str
            Full name of the node that should send there.
        gid : bytes
            Identifier of the publisher that did.
        """
        if self._file < 0:
            return OPEN
        self._read()
        if own := self._own.get(topic):
            return OWN if gid in own else OTHER
        return OPEN if node in self._complete else PENDING

    def of_process(self, gid: bytes, length: int) -> bool:
        """Whether a publisher of the run has an identifier that begins as this one does."""
        self._read()
        return any(own[:length] == gid[:length] for gids in self._own.values() for own in gids)


def complete_line(node: str) -> str:
    """Line of the list: a node has listed all of its publishers, or never will."""
    return json.dumps({"node": node}) + "\n"


@functools.cache
def members() -> Members:
    """The list of this process."""
    return Members(os.environ.get(MEMBERS_VARIABLE, ""))
