"""Files that a telescope and a run are read from, beside the controllers: which they are, and a digest of them all.

:attr:`titop_plant.telescope.telescope.Telescope.parameters_hash` names a telescope for its designs: it leaves out
what no design depends on. The rows of a campaign, the runs of `stages` and those of a trade depend on all of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import PICTURE
from los_testbed.config.plugins import source_hashes
from los_testbed.config.run_config import RunConfig
from pointing_analysis.files.structured_text import load_toml, read_text
from titop_plant.telescope.load import FOLDER, load_telescope
from titop_plant.telescope.telescope import Telescope

FILE_KEYS = frozenset({"modal_data", "pupil", "noise_curve", "file"})
"""Keys of a parameter file whose values are names of files: of bodies, optics, camera and disturbances."""

BESIDE = "telescope_files"
"""Folder of copies of these files beside a copy of the parameter file."""

DIGITS = 16
"""Hexadecimal digits of a digest that is compared and shown."""


def map_files(value: Any, change: Callable[[Path], Any], folder: Path = Path()) -> Any:
    """A value of a parameter file with another value in place of the name of each file.

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

    text, found = read_text(path), dict[str, bytes]()

    def placed(file: Path) -> str:
        content = _content(file)
        names = (f"{BESIDE}/{number}{file.name}" for number in chain([""], map("{}-".format, count(2))))
        name = next(name for name in names if found.get(name, content) == content)
        found[name] = content
        return name

    moved = map_files(load_toml(text, path), placed, path.parent)
    return (tomli_w.dumps(moved) if found else text), found


def _content(path: Path) -> bytes:
    """Content of a file; ValueError: it cannot be read."""
    try:
        return read_bytes(path, PICTURE)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None


def telescope_digest(telescope: Telescope) -> str:
    """SHA-256 of all values of a telescope and of the content of the files that it names, wherever they are.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    content = map_files(telescope.named_values(), content_digest)
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=repr).encode()).hexdigest()


def content_digest(path: Path) -> str:
    """SHA-256 of the content of a file; ValueError: it cannot be read."""
    return hashlib.sha256(_content(path)).hexdigest()


def input_digests(config: RunConfig) -> dict[str, str]:
    """Digests of what a run is made of beside its settings and the numbers of its controllers; of the reference none.

    ``telescope`` of the parameter file and all that it names, ``disturbances`` of further files of sources,
    ``profile`` of the file of a ramp, and of the source files of code of the user by the name of the setting.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    from titop_plant.telescope.motion_profiles import PROFILES

    found = {}
    if config.parameters:
        found["telescope"] = telescope_digest(load_telescope(config.parameters))
    if config.files_of_disturbance:
        from los_testbed.parts.disturbance_files import digest, entries_of

        found["disturbances"] = digest(entries_of(config.files_of_disturbance))
    if config.profile not in PROFILES:
        found["profile"] = content_digest(Path(config.profile))
    return {name: text[:DIGITS] for name, text in (found | source_hashes(config.code_of_user)).items()}
