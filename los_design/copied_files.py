"""Files that a telescope is read from: which they are, and copies of them beside a copy of the parameter file."""

from __future__ import annotations

from itertools import chain, count
from pathlib import Path

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import PICTURE
from pointing_analysis.files.structured_text import load_toml, read_text
from titop_plant.telescope.named_files import map_files
from titop_plant.telescope.tables.parameter_check import BASE, REFERENCE_NAME

BESIDE = "telescope_files"
"""Folder of copies of these files beside a copy of the parameter file."""


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
    tables = load_toml(text, path)

    def placed(file: str, content: bytes) -> str:
        names = (f"{BESIDE}/{number}{file}" for number in chain([""], map("{}-".format, count(2))))
        name = next(name for name in names if contents.get(name, content) == content)
        contents[name] = content
        return name

    moved = map_files(tables, lambda file: placed(file.name, content_of(file)), path.parent)
    if (base := tables.get(BASE, REFERENCE_NAME)) != REFERENCE_NAME:
        of_base, below = with_files_beside(path.parent / base)
        moved[BASE] = placed(Path(base).name, of_base.encode())
        contents |= {f"{BESIDE}/{name}": content for name, content in below.items()}
    return (tomli_w.dumps(moved) if contents else text), contents


def content_of(path: Path) -> bytes:
    """Content of a file; ValueError: it cannot be read."""
    try:
        return read_bytes(path, PICTURE)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
