"""Processes of a run and their published topics, in a list that only processes of the runner can open.

A process lists itself, and each topic, before it creates a publisher there: a publisher on a listed topic that is not
of a listed process is foreign, whatever its name. The list is an inherited file in memory; another user cannot write to
it.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os

MEMBERS_VARIABLE = "LOS_TESTBED_MEMBERS"
"""Path of the list, if a runner started this node."""

PREFIX_BYTES = 12
"""The first bytes of an identifier are the same for everything in a process, and differ between processes."""

OWN, OTHER, PENDING, OPEN = "own", "other", "pending", "open"
"""Standing of a publisher: of the run; foreign; undecided, as the topic's node has not listed all of its topics;
unknown, as there is no list or it does not have the topic (a remap or a filter)."""


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
    ...     members.join("/telescope/plant", b"1")
    ...     members.publishes("/telescope/truth/los")
    ...     members.complete("/telescope/plant")
    ...     [before, *(members.standing("/telescope/truth/los", "/telescope/plant", gid) for gid in (b"1", b"2"))]
    ['pending', 'own', 'other']
    """

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_APPEND) if path else -1
        self._size = 0
        self._rest = b""
        self._processes: dict[str, set[bytes]] = {}
        self._topics: set[str] = set()
        self._complete: set[str] = set()

    def join(self, node: str, gid: bytes) -> None:
        """List the process of a node by the identifier of anything in it; nothing without a list."""
        self._write(json.dumps({"process": gid[:PREFIX_BYTES].hex(), "of": node}) + "\n")

    def publishes(self, topic: str) -> None:
        """List a topic on which this node will send; nothing without a list."""
        self._write(json.dumps({"topic": topic}) + "\n")

    def complete(self, node: str) -> None:
        """All topics of a node are listed; nothing without a list."""
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
            with contextlib.suppress(ValueError, KeyError, TypeError):
                row = json.loads(line)
                if "node" in row:
                    self._complete.add(row["node"])
                elif "topic" in row:
                    self._topics.add(row["topic"])
                else:
                    self._processes.setdefault(row["of"], set()).add(bytes.fromhex(row["process"]))

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
        if gid[:PREFIX_BYTES] in self._processes.get(node, ()):
            return OWN
        if topic in self._topics:
            return OTHER
        return OPEN if node in self._complete else PENDING


def complete_line(node: str) -> str:
    """Line of the list: a node has listed all of its topics, or never will."""
    return json.dumps({"node": node}) + "\n"


@functools.cache
def members() -> Members:
    """The list of this process."""
    return Members(os.environ.get(MEMBERS_VARIABLE, ""))
