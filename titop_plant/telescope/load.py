"""Reading of a telescope's parameter file."""

from __future__ import annotations

import pickle
import re
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from lftkit.support.input_files import read_text
from lftkit.support.structured_text import parse
from titop_plant.telescope.guide_camera import with_guide_camera
from titop_plant.telescope.layout import APPENDAGES, ARRAYS, MountedBody
from titop_plant.telescope.plant_file import FILE, PLANT, take_plant
from titop_plant.telescope.requirements import take_limits, with_limits
from titop_plant.telescope.tables.parameter_check import BASE, REFERENCE_NAME, ParameterFile
from titop_plant.telescope.tables.uncertain import UNCERTAIN, checked_entries
from titop_plant.telescope.telescope import OWN_BODIES, SOURCES, Telescope

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REFERENCE = Path(__file__).with_name("reference.toml")
FOLDER = "folder"
"""Key of a table ``[[disturbance]]`` for the folder of its file, to which other files in it are relative."""


def load_telescope(path: str | Path | None = None) -> Telescope:
    """Read a parameter file.

    Parameters
    ----------
    path : str or Path, optional
        TOML file; the reference telescope where none is given. With ``base = "reference"``, or the name of another
        parameter file, relative to its folder, a file holds only what differs from that one; without, all that a
        telescope needs. Tables with a name, ``[[payload.equipment]]`` and ``[[requirement]]``, change those of the same
        name and are added to the others; ``replace = ["equipment"]`` in ``[payload]``, or ``replace = ["requirement"]``
        at the head of the file, replaces all of them. Other lists of tables are replaced. A relative
        ``body.modal_data``, ``payload.modal_data``, ``optics.pupil`` or ``camera.noise_curve`` is looked for beside the
        file. Low-pass and noise of a camera that is no vector are those of its table, see
        :mod:`titop_plant.telescope.guide_camera`. Tables ``[[solar_array]]``, ``[[reaction_wheel]]`` and
        ``[[appendage]]`` define the layout, see :mod:`titop_plant.telescope.layout`, ``[[sensor]]`` and
        ``[[actuator]]`` what is beside the loop, :mod:`titop_plant.telescope.devices`, ``[uncertain]`` what varies
        beside the wheels, :mod:`titop_plant.telescope.tables.uncertain`, ``[plant]`` a system from a file in place of
        the assembly, :mod:`titop_plant.telescope.plant_file`. Tables ``[[disturbance]]`` are kept as they are, each
        with the folder of the file.

    Raises
    ------
    ValueError
        File missing or not TOML; a key that is not known, or all that are missing; a value of another kind, length or
        sign; requirements that :func:`titop_plant.telescope.requirements.with_limits` refuses. The message names the
        file, the line and the key.
    """
    return _loaded(Path(path or REFERENCE), ())


def _loaded(path: Path, above: tuple[Path, ...]) -> Telescope:
    """The telescope of a file that these files, resolved, build on."""
    content, text = _read(path)
    if path == REFERENCE:
        return _reference(text)
    from titop_plant.telescope.tables.mounted import (  # loads scipy
        check_modal_file,
        checked_layout,
        note_unknown_keys,
        take_mounted,
    )

    file = ParameterFile(str(path), text)
    base = _base(content, file, (*above, path.resolve()))
    if PLANT in base:
        content.setdefault(PLANT, {FILE: str(Path(base[PLANT][FILE]).absolute())})
    plant = take_plant(content, file, path.parent)
    limits, sources, mounted = take_limits(content, file), content.pop(SOURCES, None), take_mounted(content)
    spreads = content.pop(UNCERTAIN, {})
    if sources is not None and not (isinstance(sources, list) and all(isinstance(table, dict) for table in sources)):
        raise file.error(SOURCES, f"must be tables [[{SOURCES}]], got {sources!r}")
    merged = file.merged(base, content)
    note_unknown_keys(mounted, file)
    file.refuse_unknown()
    file.require_all({**merged, **mounted})
    merged = with_limits(merged, content, limits, file)
    file.check_tables({**merged, **mounted})
    for name, key in (("optics", "pupil"), ("camera", "noise_curve"), *((body, "modal_data") for body in OWN_BODIES)):
        if beside := content.get(name, {}).get(key):
            merged[name] = {**merged[name], key: str(path.parent / beside)}
    merged = with_guide_camera(merged, content, file)
    merged |= checked_layout(mounted, merged, base, file)
    if isinstance(spreads, dict):
        spreads = {**base.get(UNCERTAIN, {}), **spreads}
    if spreads:
        merged[UNCERTAIN] = checked_entries(spreads, file, merged)
    for name in OWN_BODIES:
        if merged[name].get("modal_data"):
            check_modal_file(name, merged[name], file)
    if sources is not None:
        merged[SOURCES] = [{**table, FOLDER: str(path.parent)} for table in sources]
    telescope = Telescope({**merged, **plant})
    for kind, bodies in ((ARRAYS, telescope.solar_arrays), (APPENDAGES, telescope.appendages)):
        for i, body in enumerate(bodies):
            _check_body(body, f"{kind}[{i}]", file)
    if plant:
        try:
            _ = telescope.plant  # read and checked before anything else is done with the telescope
        except ValueError as error:
            raise file.error(PLANT, f"must name a plant that fits: {error}") from None
    return telescope


def _base(content: dict[str, Any], file: ParameterFile, above: tuple[Path, ...]) -> dict[str, Any]:
    """Take the name of what a file builds on out of it: the tables of that; none where the file stands alone."""
    name = content.pop(BASE, None)
    if name is None:
        return {}
    if not isinstance(name, str) or not name:
        raise file.error(BASE, f'must be "{REFERENCE_NAME}" or the name of a parameter file, got {name!r}')
    if name == REFERENCE_NAME:
        return _read(REFERENCE)[0]
    path = Path(file.path).parent / name
    if path.resolve() in above:
        raise file.error(BASE, f"must be a file that does not build on this one, got {name!r}")
    try:
        return _loaded(path, above).to_mapping()
    except InputError as error:
        raise file.error(BASE, f"must be a telescope: {error}") from None


def base_of(path: str | Path) -> Path | None:
    """Parameter file that another one builds on; None where that one stands alone.

    Raises
    ------
    ValueError
        The file cannot be read, or is not TOML.

    Examples
    --------
    >>> base_of(REFERENCE) is None
    True
    """
    name = _read(Path(path))[0].get(BASE)
    if name is None:
        return None
    return REFERENCE if name == REFERENCE_NAME else Path(path).parent / str(name)


def _check_body(body: MountedBody, name: str, file: ParameterFile) -> None:
    """Refuse an array or an appendage whose values are of no body, with the table."""
    from titop_plant.telescope.components import body_modes

    try:
        body_modes(body)
    except ValueError as error:
        raise file.error(name, f"must be a body: {error}") from None


def differences(path: str | Path) -> list[str]:
    """Values of a parameter file that differ from what it builds on, one line each, both values in it.

    A file that stands alone has none.

    Raises
    ------
    ValueError
        As :func:`load_telescope`.

    Examples
    --------
    >>> differences(REFERENCE)
    []
    """
    return [line for _, _, line in _compared(path)]


class DifferenceCounts(NamedTuple):
    """Values of a table that differ from the base, that it adds, and that it lacks."""

    changed: int
    added: int
    removed: int

    def __str__(self) -> str:
        return ", ".join(f"{counted(n, 'value')} {kind}" for kind, n in self._asdict().items() if n)


def difference_counts(path: str | Path) -> dict[str, DifferenceCounts]:
    """How many values of each table of a parameter file differ from what it builds on; tables without any are left out.

    Raises
    ------
    ValueError
        As :func:`load_telescope`.

    Examples
    --------
    >>> difference_counts(REFERENCE)
    {}
    """
    by_table: dict[str, list[int]] = {}
    for name, kind, _ in _compared(path):
        by_table.setdefault(re.split(r"[.\[]", name)[0], [0, 0, 0])[DifferenceCounts._fields.index(kind)] += 1
    return {table: DifferenceCounts(*counts) for table, counts in by_table.items()}


def difference_summary(path: str | Path, most: int = 4) -> list[str]:
    """At most so many lines of :func:`differences`; where there are more, one line with the counts of each table."""
    lines = differences(path)
    if len(lines) <= most:
        return lines
    tables = ", ".join(f"{table} ({counts})" for table, counts in difference_counts(path).items())
    return [f"differs from {_name(base_of(path))} in {tables}"]


def _compared(path: str | Path) -> list[tuple[str, str, str]]:
    """Name, kind (changed, added or removed) and text of each value that differs from the base."""
    base = base_of(path)
    if base is None:
        return []
    values, before = (dict(_flat("", load_telescope(file).to_mapping())) for file in (path, base))
    shown = _name(base).removeprefix("the ")
    rows = []
    for name, value in values.items():
        if name not in before:
            rows.append((name, "added", f"{name} = {_shown(value)}, added"))
        elif value != before[name]:
            rows.append((name, "changed", f"{name} = {_shown(value)}, {shown} {_shown(before[name])}"))
    return rows + [(name, "removed", f"{name} removed") for name in before if name not in values]


def _name(base: Path | None) -> str:
    return "the reference" if base in (None, REFERENCE) else f"{base}"


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Full name and value of each entry; of tables in a list the name counts, not the place."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else key, entry)
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        for i, item in enumerate(value):
            yield from _flat(f"{prefix}[{item.get('name', i)}]", {k: v for k, v in item.items() if k != "name"})
    else:
        yield prefix, value


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """Content of a TOML file, and its text."""
    try:
        text = read_text(path)
        return pickle.loads(_parsed(text)), text
    except OSError as error:
        raise InputError(f"cannot read the parameter file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a TOML file: expected UTF-8 text") from None
    except InputError as error:
        raise InputError(f"{path} is not a TOML file: {error}") from None


@lru_cache(maxsize=1)
def _reference(text: str) -> Telescope:
    """The telescope of the reference: nothing changes it, so that all may have the same one."""
    tables = pickle.loads(_parsed(text))
    return Telescope(with_limits(tables, tables, {}, ParameterFile(str(REFERENCE), text)))


@lru_cache(maxsize=4)
def _parsed(text: str) -> bytes:
    """Content of a TOML text, pickled: a copy of its own for each caller, a hundred times as fast as parsing."""
    return pickle.dumps(parse(text, "it", "TOML", tomllib.loads))


__all__ = ["REFERENCE", "difference_counts", "difference_summary", "differences", "load_telescope"]
