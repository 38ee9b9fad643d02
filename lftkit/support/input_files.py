"""The one reader of files that a user or another file names: ordinary files of a limited size.

A pipe would let the program wait for ever, a device such as ``/dev/zero`` never ends, and opening one may do
something. They are refused before they are opened, and the opened file is looked at once more: another one may have got
the name meanwhile. A file that grows while it is read is read up to its limit.
"""

from __future__ import annotations

import errno
import os
import stat

from lftkit.errors import InputError
from lftkit.support.input_limits import TEXT

_PIECE = 1 << 20


class InputFileError(OSError, InputError):
    """A file that is not read: no ordinary one, or too large. It is a mistake of who named it."""

    def __str__(self) -> str:
        """The path, and why."""
        return f"cannot read {self.filename}: {self.strerror}"


def check_file(path: str | os.PathLike[str], limit: int) -> int:
    """Refuse what is no ordinary file of at most `limit` bytes; returns its size [byte].

    For readers of others that open a file by its name.

    Raises
    ------
    InputFileError
        A device, a pipe or a socket, a larger file, or a name that no file can have.
    OSError
        No such file, or a folder.
    """
    if "\0" in os.fsdecode(path):
        raise InputFileError(errno.EINVAL, "a name must have no null byte", repr(os.fsdecode(path)))
    return _checked(os.stat(os.fspath(path)), path, limit)  # a number would be a file that is open


def _checked(status: os.stat_result, path: str | os.PathLike[str], limit: int) -> int:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
    if not stat.S_ISREG(status.st_mode):
        raise InputFileError(errno.EINVAL, "not an ordinary file", os.fspath(path))
    if status.st_size > limit:
        raise _too_large(path, limit)
    return status.st_size


def _too_large(path: str | os.PathLike[str], limit: int) -> InputFileError:
    return InputFileError(errno.EFBIG, f"larger than {limit / 1e6:g} MB", os.fspath(path))


def read_bytes(path: str | os.PathLike[str], limit: int = TEXT) -> bytes:
    """Content of an ordinary file.

    Parameters
    ----------
    path : str or path
    limit : int
        Largest size [byte], see :mod:`lftkit.support.input_limits`.

    Raises
    ------
    InputFileError
        It is a device, a pipe or a socket, or larger than `limit`.
    OSError
        It cannot be read.

    Examples
    --------
    >>> read_bytes("/dev/zero")
    Traceback (most recent call last):
    ...
    lftkit.support.input_files.InputFileError: cannot read /dev/zero: not an ordinary file
    """
    check_file(path, limit)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    with open(descriptor, "rb", buffering=0) as file:
        size = _checked(os.fstat(descriptor), path, limit)
        content = bytearray()
        # files of the kernel in /proc have the size 0; one read of the whole and one of nothing for others
        while piece := file.read(max(size - len(content), _PIECE)):
            content += piece
            if len(content) > limit:
                raise _too_large(path, limit)
    return bytes(content)


def read_text(path: str | os.PathLike[str], limit: int = TEXT) -> str:
    """Text of an ordinary file in UTF-8, line ends as in Python's text files; raises as :func:`read_bytes`.

    Raises
    ------
    UnicodeDecodeError
        The text is not UTF-8.
    """
    text = read_bytes(path, limit).decode("utf-8")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
