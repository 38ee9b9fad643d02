"""Files in memory: they have a path as long as their process or one that inherited them lives, and leave nothing."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass

_IN_MEMORY = hasattr(os, "memfd_create")
"""Linux has such files; elsewhere it is one of the temporary folder, without a name."""


@dataclass(frozen=True)
class MemoryFile:
    """A file without a place on the disk.

    Attributes
    ----------
    descriptor : to be inherited by child processes that are to read it (``pass_fds``)
    """

    descriptor: int

    @property
    def path(self) -> str:
        """Path in this process, and in children that inherited the descriptor."""
        return f"{'/proc/self/fd' if _IN_MEMORY else '/dev/fd'}/{self.descriptor}"


@contextlib.contextmanager
def memory_file(data: bytes, name: str) -> Iterator[MemoryFile]:
    """A file with this content; it vanishes with the block, or with the process however it ends.

    Examples
    --------
    >>> with memory_file(b"content", "example") as file, open(file.path, "rb") as stream:
    ...     stream.read()
    b'content'
    """
    if _IN_MEMORY:
        descriptor = os.memfd_create(name)
    else:
        with tempfile.TemporaryFile() as unnamed:
            descriptor = os.dup(unnamed.fileno())
    try:
        with open(descriptor, "wb", closefd=False) as stream:
            stream.write(data)
        os.lseek(descriptor, 0, os.SEEK_SET)  # /dev/fd of macOS opens the file where it stands
        yield MemoryFile(descriptor)
    finally:
        os.close(descriptor)
