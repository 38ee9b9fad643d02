"""Text of files that a user names: only ordinary files of a limited size are read."""

from __future__ import annotations

import errno
import os
from pathlib import Path

MAX_SIZE = 64_000_000
"""Largest file [byte]."""


def read_ordinary_file(path: str | os.PathLike[str]) -> str:
    """Text of an ordinary file in UTF-8.

    A pipe would let the program wait for ever, and a device such as ``/dev/zero`` never ends: they are refused before
    they are opened.

    Raises
    ------
    OSError
        The file cannot be read, is a device, a pipe or a socket, or is larger than `MAX_SIZE`.
    UnicodeDecodeError
        The text is not UTF-8.

    Examples
    --------
    >>> read_ordinary_file("/dev/zero")
    Traceback (most recent call last):
    ...
    OSError: [Errno 22] not an ordinary file: '/dev/zero'
    """
    file = Path(path)
    if file.exists() and not (file.is_file() or file.is_dir()):
        raise OSError(errno.EINVAL, "not an ordinary file", str(path))
    if file.is_file() and file.stat().st_size > MAX_SIZE:
        raise OSError(errno.EFBIG, f"larger than {MAX_SIZE / 1e6:g} MB", str(path))
    return file.read_text("utf-8")
