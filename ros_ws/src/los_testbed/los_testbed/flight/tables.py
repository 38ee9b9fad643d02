"""Numbers in C: hexadecimal floats, which are exact, their SHA-256, and the way back from a C file."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import read_text

UNITS = ("k_fsm", "k_pma", "controller", "gate")
"""Translation units with tables."""

HEADER = "los_flight.h"
"""The header, which says the hash of all tables."""

_TABLE = re.compile(r"^static const double (\w+)(?:\[\d+\])+ = \{(.*?)^\};$", re.DOTALL | re.MULTILINE)
_NUMBER = r"-?0x[01](?:\.[0-9a-f]+)?p[+-]\d+"
_STATED = re.compile(r'_SHA256(?:\[65\])?[ =\\]*\s*"([0-9a-f]{64})"', re.IGNORECASE)


def hex_float(value: float) -> str:
    """A number as C99 reads it, exactly; ``NAN``, ``INFINITY`` as doubles.

    Examples
    --------
    >>> hex_float(0.1), hex_float(-0.0), hex_float(float("-inf"))
    ('0x1.999999999999ap-4', '-0x0.0p+0', '-((double)INFINITY)')
    """
    number = float(value)
    if np.isnan(number):
        return "((double)NAN)"
    if np.isinf(number):
        return f"{'-' if number < 0 else ''}((double)INFINITY)"
    return number.hex()


def table_hash(tables: Mapping[str, FloatArray]) -> str:
    """SHA-256 of the tables of one unit: for each a line with its name, then one with each number, row by row."""
    lines = [line for name, values in tables.items() for line in (name, *map(float.hex, values.ravel().tolist()))]
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


def common_hash(hashes: Mapping[str, str]) -> str:
    """SHA-256 of all units: for each a line with its name and its hash."""
    return hashlib.sha256("".join(f"{unit} {hashes[unit]}\n" for unit in UNITS).encode()).hexdigest()


@dataclass(frozen=True)
class Tables:
    """Tables of a translation unit.

    Parameters
    ----------
    values : mapping
        Name to array of one or two dimensions, in the order of the C file.
    """

    values: Mapping[str, FloatArray]

    @classmethod
    def of(cls, **tables: ArrayLike) -> Tables:
        """Tables from arrays by name."""
        return cls({name: np.asarray(values, dtype=float) for name, values in tables.items()})

    @property
    def sha256(self) -> str:
        """:func:`table_hash` of the values."""
        return table_hash(self.values)

    def declaration(self, name: str) -> str:
        """The table as C code."""
        values = self.values[name]
        sizes = "".join(f"[{size}]" for size in values.shape)
        if values.ndim == 1:
            return f"static const double {name}{sizes} = {{\n{_lines(values, 4)}}};"
        rows = "".join(f"    {{\n{_lines(row, 8)}    }},\n" for row in values)
        return f"static const double {name}{sizes} = {{\n{rows}}};"


def _lines(values: FloatArray, indent: int) -> str:
    """Numbers, four to a line."""
    texts = [hex_float(value) for value in values.tolist()]
    rows = [", ".join(texts[i : i + 4]) for i in range(0, len(texts), 4)]
    return "".join(f"{' ' * indent}{row},\n" for row in rows)


@dataclass(frozen=True)
class Checked:
    """Comparison of a folder of flight code with a pair of designs.

    Parameters
    ----------
    found, expected : str
        Hash of the tables in the C files, and of those of the designs.
    faults : tuple of str
        Differences; empty without any.
    """

    found: str
    expected: str
    faults: tuple[str, ...]


def read_tables(path: Path) -> tuple[Tables, str]:
    """Tables of a C file of this export, and the hash that the file states.

    Raises
    ------
    ValueError
        The file cannot be read or has no such tables.
    """
    text = _text(path)
    tables = {
        name: np.array([float.fromhex(number) for number in re.findall(_NUMBER, body)])
        for name, body in _TABLE.findall(text)
    }
    if not tables:
        raise InputError(f"{path} must have tables of flight code, got none")
    return Tables(tables), _stated(text, path)


def check_tables(folder: Path, expected: Mapping[str, Tables]) -> Checked:
    """Compare the tables in a folder of flight code, and the hashes that it states, with those of designs.

    Raises
    ------
    ValueError
        A file of the folder is missing or has no tables.
    """
    faults, digests = [], {}
    for unit in UNITS:
        path = folder / f"{unit}.c"
        tables, stated = read_tables(path)
        digests[unit] = tables.sha256
        if stated != tables.sha256:
            faults.append(f"{path.name} states {stated[:12]}, its tables are {tables.sha256[:12]}")
        if tables.sha256 != expected[unit].sha256:
            faults.append(f"tables of {path.name} differ from the designs")
    header = folder / HEADER
    stated, common = _stated(_text(header), header), common_hash(digests)
    if stated != common:
        faults.append(f"{HEADER} states {stated[:12]}, the tables are {common[:12]}")
    wanted = common_hash({unit: tables.sha256 for unit, tables in expected.items()})
    return Checked(common, wanted, tuple(faults))


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except UnicodeDecodeError:
        raise InputError(f"{path} must be text in UTF-8, got other bytes") from None
    except OSError as error:
        raise InputError(f"cannot read the flight code {path}: {error.strerror}") from None


def _stated(text: str, path: Path) -> str:
    stated = _STATED.search(text)
    if stated is None:
        raise InputError(f"{path} must state the SHA-256 of its tables, got none")
    return stated[1]
