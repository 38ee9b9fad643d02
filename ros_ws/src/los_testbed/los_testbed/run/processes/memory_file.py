"""Files in memory: they have a path as long as their process or one that inherited them lives, and leave nothing."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass


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
        return f"/proc/self/fd/{self.descriptor}"


@contextlib.contextmanager
def memory_file(data: bytes, name: str) -> Iterator[MemoryFile]:
    """A file with this content; it vanishes with the block, or with the process however it ends.

    Examples
    --------
    >>> with memory_file(b"content", "example") as file, open(file.path, "rb") as stream:
    ...     stream.read()
    b'content'
    """
    descriptor = os.memfd_create(name)
    try:
        with open(descriptor, "wb", closefd=False) as stream:
            stream.write(data)
        yield MemoryFile(descriptor)
    finally:
        os.close(descriptor)
