"""Files that a telescope is read from: which they are, and copies of them beside a copy of the parameter file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import PICTURE
from pointing_analysis.files.structured_text import load_toml, read_text
from titop_plant.telescope.load import FOLDER

FILE_KEYS = frozenset({"modal_data", "pupil", "noise_curve", "file"})
"""Keys of a parameter file whose values are names of files: of bodies, optics, camera and disturbances."""

BESIDE = "telescope_files"
"""Folder of copies of these files beside a copy of the parameter file."""


def map_files(value: Any, change: Callable[[Path], Any], folder: Path = Path()) -> Any:
    """A value of a parameter file with each file name replaced.

    Parameters
    ----------
    value : mapping, list or value
        Of a user's file, or of the whole telescope (:func:`titop_plant.telescope.load.load_telescope`).
    change : callable
        Gives the other value for the path of a file.
    folder : Path
        Of the user's file; of a table with an entry ``folder`` it is that one, and the entry is left out.

    Examples
    --------
    >>> map_files({"payload": {"modal_data": "p.toml", "modes": 6}, "body": {"modal_data": ""}}, str, Path("/there"))
    {'payload': {'modal_data': '/there/p.toml', 'modes': 6}, 'body': {'modal_data': ''}}
    """
    if isinstance(value, Mapping):
        folder = Path(value.get(FOLDER, folder))
        return {
            key: change(folder / entry)
            if key in FILE_KEYS and isinstance(entry, str) and entry
            else map_files(entry, change, folder)
            for key, entry in value.items()
            if key != FOLDER
        }
    if isinstance(value, (list, tuple)):
        return [map_files(entry, change, folder) for entry in value]
    return value


def with_files_beside(path: Path) -> tuple[str, dict[str, bytes]]:
    """Text of a parameter file, and the content of the files that it names, by names below its folder.

    The names in the text are those; it is as the user wrote it where it names none. Written together into any folder
    they are the same telescope.

    Raises
    ------
    ValueError
        A file that cannot be read, or one that is not TOML.
    """
    import tomli_w

    text, contents = read_text(path), dict[str, bytes]()

    def placed(file: Path) -> str:
        content = content_of(file)
        names = (f"{BESIDE}/{number}{file.name}" for number in chain([""], map("{}-".format, count(2))))
        name = next(name for name in names if contents.get(name, content) == content)
        contents[name] = content
        return name

    moved = map_files(load_toml(text, path), placed, path.parent)
    return (tomli_w.dumps(moved) if contents else text), contents


def content_of(path: Path) -> bytes:
    """Content of a file; ValueError: it cannot be read."""
    try:
        return read_bytes(path, PICTURE)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
