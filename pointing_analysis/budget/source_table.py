"""Sources of a budget as a table (CSV or a workbook), to read and to write.

The columns are described in ``docs/pointing_analysis.md``. A row corresponds to a table ``[sources.x]`` of a TOML file;
values of several axes are separated by ``;``. Rows of the types ``requirement``, ``total`` and ``setting`` hold the
rest of the file: a setting has its key in ``source`` and its value in ``text`` (``title``, ``summation``, ``axes``,
``draws``, ``seed``), a total the index in ``source`` and the columns ``window`` [s] and ``factor``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.budget.table_files import read_rows
from pointing_analysis.units import ANGLES

LENGTHS = ("value", "half_range", "sigma", "amplitude", "rate")
"""Columns in the unit of the row."""

NUMBERS = (*LENGTHS, "frequency", "phase", "correlation_time", "duration", "transfer")
TEXTS = ("random",)
OF_TOTAL = ("window", "factor")
COLUMNS = ("source", "type", "unit", *NUMBERS, *TEXTS, *OF_TOTAL, "text")
"""Columns of a table of sources; ``text`` is of requirements and settings, `OF_TOTAL` of rows of the type ``total``."""

REQUIREMENT, TOTAL, SETTING = "requirement", "total", "setting"
"""Types of the rows that are no source; the column ``source`` has the name, the index, or the key."""

WHOLE = ("draws", "seed")
SETTINGS = ("title", "summation", "axes", *WHOLE)
SEPARATOR = " / "
"""Between the names of a group and of a source in it."""


def read_sources(path: Path) -> dict[str, Any]:
    """Content of a table of sources, in the form of a TOML file; values in the unit of the first row.

    Raises
    ------
    InputError
        Unknown or missing columns, a cell that is not a number, an unknown unit, a repeated name.
    """
    heads, rows = read_rows(path)
    if unknown := [head for head in heads if head and head not in COLUMNS]:
        raise InputError(f"{path}: columns must be among {', '.join(COLUMNS)}, got {unknown[0]!r}")
    if missing := [head for head in ("source", "type", "unit") if head not in heads]:
        raise InputError(f"{path}: columns must have source, type and unit, got no {missing[0]}")
    content: dict[str, Any] = {"sources": {}, REQUIREMENT: []}
    for where, cells in rows:
        _take(content, cells, where)
    return {"title": path.stem, **content}


def _take(content: dict[str, Any], cells: Mapping[str, str], where: str) -> None:
    """One row into the content."""
    name, kind = cells.get("source", ""), cells.get("type", "")
    if kind == REQUIREMENT:
        content[REQUIREMENT].append({"name": name, "text": cells.get("text", "")})
        return
    if kind == TOTAL:
        values = {key: _number(cells[key], where, key) for key in OF_TOTAL if key in cells}
        content.setdefault(TOTAL, []).append({"index": name, **values})
        return
    if kind == SETTING:
        text = cells.get("text", "")
        if name not in SETTINGS:
            raise InputError(f"{where}: setting must be one of {', '.join(SETTINGS)}, got {name!r}")
        if name in content:
            raise InputError(f"{where}: setting must be given once, got {name!r}")
        if name == "axes":
            content[name] = [axis.strip() for axis in text.split(";")]
        elif name in WHOLE:
            # A workbook may have a whole number with a decimal point
            digits = text.removesuffix(".0").removeprefix("-")
            if not (digits.isascii() and digits.isdigit() and len(digits) < 19):
                raise InputError(f"{where}: {name} must be a whole number, got {text!r}")
            content[name] = int(text.removesuffix(".0"))
        else:
            content[name] = text
        return
    if others := [key for key in OF_TOTAL if key in cells]:
        raise InputError(f"{where}: {others[0]} must be empty for a source, got {cells[others[0]]!r}")
    unit = cells.get("unit", content.get("unit", ""))
    if unit not in ANGLES:
        raise InputError(f"{where}: unit must be one of {', '.join(ANGLES)}, got {unit!r}")
    scale = ANGLES[unit] / ANGLES[content.setdefault("unit", unit)]
    table: dict[str, Any] = {"type": kind}
    for key in (*NUMBERS, *TEXTS):
        if key in cells:
            table[key] = cells[key] if key in TEXTS else _numbers(cells[key], where, key)
            if key in LENGTHS:
                table[key] = [scale * x for x in table[key]] if isinstance(table[key], list) else scale * table[key]
    group = content["sources"]
    *above, last = [part.strip() for part in name.split(SEPARATOR.strip())]
    for part in above:
        group = group.setdefault(part, {})
        if "type" in group:
            raise InputError(f"{where}: source must not be nested in another source, got {name!r}")
    if not last or last in group:
        raise InputError(f"{where}: source must be unique, got {name!r}")
    group[last] = table


def _number(cell: str, where: str, key: str) -> float:
    parsed = _numbers(cell, where, key)
    if isinstance(parsed, list):
        raise InputError(f"{where}: {key} must be one number, got {cell!r}")
    return parsed


def _numbers(cell: str, where: str, key: str) -> float | list[float]:
    try:
        parsed = [float(part) for part in cell.split(";")]
    except ValueError:
        raise InputError(
            f"{where}: {key} must be a number, or one per axis, separated by semicolons, got {cell!r}"
        ) from None
    return parsed[0] if len(parsed) == 1 else parsed


def source_rows(content: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of the table of sources of a budget file that has been read without a mistake.

    Raises
    ------
    InputError
        What no row can hold: a spectrum, a record, several tones, a transfer that depends on the frequency; a name
        that would be read as another one.
    """
    unit = str(content.get("unit", ""))
    rows = [{"source": key, "type": SETTING, "text": _setting(key, content[key])} for key in SETTINGS if key in content]
    rows += [
        {"source": _plain("requirement", r.get("name", "")), "type": REQUIREMENT, "text": str(r["text"])}
        for r in content.get(REQUIREMENT, ())
    ]
    for entry in content.get(TOTAL, ()):
        values = {key: _cell(entry[key]) for key in OF_TOTAL if key in entry}
        rows.append({"source": str(entry["index"]), "type": TOTAL, **values})
    rows += [{"source": name, "unit": unit, **row} for name, row in _flat(content.get("sources", {}), (), 1.0)]
    return rows


def _setting(key: str, value: Any) -> str:
    if key != "axes":
        return _plain(key, int(value) if key in WHOLE else value)
    return "; ".join(_plain("axis", axis, ";") for axis in value)


def _plain(what: str, value: Any, separator: str = "") -> str:
    """A text that is read as it is written: without blanks at its ends, and without the separator."""
    text = str(value)
    if text != text.strip() or (separator and (not text or separator in text)):
        ends = f", not empty and without {separator!r}," if separator else ""
        raise InputError(f"{what} must be a text{ends} without leading or trailing spaces in a table, got {text!r}")
    return text


def _flat(table: Mapping[str, Any], path: tuple[str, ...], gain: float) -> Iterator[tuple[str, dict[str, str]]]:
    """Name and cells of each source of a tree; transfers of groups are in those of their sources."""
    name, transfer = SEPARATOR.join(_plain("source", part, "/") for part in path), table.get("transfer", 1.0)
    if isinstance(transfer, (int, float)):
        gain *= float(transfer)
    else:
        raise InputError(f"{name}: transfer must be a number in a table, got {transfer!r}")
    if "type" not in table:
        for key, entry in table.items():
            if key != "transfer":
                yield from _flat(entry, (*path, key), gain)
        return
    cells = {key: value for key, value in table.items() if key != "transfer"}
    if one := cells.pop("tones", None):
        if len(one) > 1:
            raise InputError(f"{name}: tones must be one in a table, got {len(one)}")
        cells |= {**one[0], "type": "periodic"}
    if unknown := sorted(set(cells) - {"type", *NUMBERS, *TEXTS}):
        raise InputError(f"{name}: a table has no column for {', '.join(unknown)} of a source of type {cells['type']}")
    shown = {key: _cell(value) for key, value in cells.items()}
    yield name, {**shown, **({} if gain == 1.0 else {"transfer": repr(gain)})}


def _cell(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "; ".join(repr(float(x)) for x in value)
    return repr(float(value)) if isinstance(value, (int, float)) else str(value)
