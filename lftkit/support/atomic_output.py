"""Files and folders that appear whole or not at all: made under another name beside their place, then renamed.

An exception on the way, KeyboardInterrupt included, removes what was made; the command line turns SIGINT, SIGTERM and
SIGHUP into one.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from lftkit.errors import InputError

MAX_NAME = 255
"""Longest name of a file [byte]."""
RESERVED = 32
"""Bytes of a name that are left for the additions of temporary names and of the files in a bag."""


def check_output(
    path: Path, what: str, *, new: bool = False, folder: bool = False, suffixes: Sequence[str] = ()
) -> None:
    """Refuse, before any work, a path where no output can be written.

    Parameters
    ----------
    path : of the output
    what : its name in messages, for instance ``--output``
    new : refuse an existing one
    folder : it will be a folder, and its parents are made as needed
    suffixes : ends of its name in lower case, one of which it must have; any without them

    Raises
    ------
    ValueError
        Another suffix, another kind of file is there (a folder, a device, a pipe), its folder is missing or may not be
        written to, the name is too long.
    """
    path = Path(path)
    if "\0" in str(path) or not path.name or len(os.fsencode(path.name)) > MAX_NAME - RESERVED:
        raise InputError(f"{what} must have a name of at most {MAX_NAME - RESERVED} bytes, got {str(path)[:80]!r}")
    try:
        if path.exists() or path.is_symlink():
            if new:
                raise InputError(
                    f"{what} must have a new name, got {path}: it exists already, and it is never overwritten"
                )
            if path.is_dir() != folder:
                raise InputError(f"{what} must be a {'folder' if folder else 'file'}, got {path}")
            _check_kind(path, what)
        parent = path.absolute().parent
        while folder and not parent.exists():
            parent = parent.parent
        if not parent.is_dir():
            raise InputError(
                f"the folder of {what} must exist, got {parent}{' is not a folder' if parent.exists() else ''}"
            )
        # permissions do not tell of a file system that takes no files
        with tempfile.TemporaryFile(dir=path if path.is_dir() else parent):
            pass
    except OSError as error:
        raise InputError(f"{what} must be a path that can be written, got {path}: {error.strerror}") from None
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"{what} must end in {' or '.join(suffixes)}, got {path}")


def _check_kind(path: Path, what: str) -> None:
    """Refuse a device, a pipe, a socket: the renaming at the end would put a file in its place."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{what} must be an ordinary file, got {path}: a device, a pipe or a socket")


def check_space(path: Path, size: float, what: str) -> None:
    """Refuse an output that does not fit on its disk.

    Raises
    ------
    ValueError
        Less than `size` bytes are free there.
    """
    parent = path.absolute()
    while not parent.exists():
        parent = parent.parent
    free = shutil.disk_usage(parent).free
    if free < size:
        raise InputError(
            f"{what} must fit on the disk of {parent}: needs about {size / 1e6:.0f} MB, got {free / 1e6:.0f}"
        )


_TEMPORARY = re.compile(r"\A\..+\.[0-9a-f]{8}\Z")


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}")


@contextlib.contextmanager
def named_errors(path: Path, temporary: Path) -> Iterator[None]:
    """Errors of writing name this path: that of a full disk has none, and a temporary name would say nothing."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and not str(error.filename).startswith(str(temporary)):
            raise  # of another file
        raise OSError(error.errno, os.strerror(error.errno or 0), str(path)) from error


def leftovers(folder: Path) -> list[Path]:
    """Temporary files in a folder that a killed process left."""
    return [path for path in folder.glob(".*") if _TEMPORARY.search(path.name) and path.is_file()]


@contextlib.contextmanager
def atomic_file(path: Path, durable: bool = False) -> Iterator[Path]:
    """A path to write to; the file gets its name when the block ends without an exception.

    Parameters
    ----------
    path : Path
    durable : bool
        The content is on the disk before the file gets its name: a loss of power cannot leave a name without content.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with atomic_file(folder / "page.html") as temporary:
    ...     _ = temporary.write_text("whole")
    >>> [file.name for file in folder.iterdir()]
    ['page.html']
    """
    _check_kind(path, "an output")
    temporary = _temporary(path)
    try:
        with named_errors(path, temporary):
            yield temporary
            if durable:
                with temporary.open("rb") as file:
                    os.fsync(file.fileno())
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A folder name to make and fill; it gets its name when the block ends without an exception.

    Raises
    ------
    ValueError
        Something with this name came into being meanwhile.
    """
    path.absolute().parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary(path)
    try:
        with named_errors(path, temporary):
            yield temporary
            if path.exists():
                raise InputError(f"{path} must be a new name, got one that came into being meanwhile")
            os.rename(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_text(path: Path, text: str, durable: bool = False) -> None:
    """Write a whole file, replacing an existing one."""
    write_bytes(path, text.encode("utf-8"), durable)


def write_bytes(path: Path, content: bytes, durable: bool = False) -> None:
    """Write a whole file, replacing an existing one."""
    with atomic_file(path, durable) as temporary:
        temporary.write_bytes(content)
