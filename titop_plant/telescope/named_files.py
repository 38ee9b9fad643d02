"""Names of files in a parameter file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from titop_plant.telescope.load import FOLDER

FILE_KEYS = frozenset({"modal_data", "pupil", "noise_curve", "file"})
"""Keys of a parameter file whose values are names of files: of bodies, optics, camera and disturbances."""


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
