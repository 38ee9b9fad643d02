"""Checks of a parameter file: names of its keys, what it lacks, and its values, merged with those of its base."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.files.settings import CheckedTable, Refused, unknown
from titop_plant.telescope.sections import (
    TABLES,
    Equipment,
    LimitsTable,
    Material,
    RequirementTable,
    StructureTable,
)

MATERIALS, REQUIREMENT = "materials", "requirement"
"""Tables of materials by name, and list of requirements."""

FURTHER = ("appendage", "sensor", "actuator", "uncertain", "disturbance", "plant")
"""Tables that a file may have beside those of `TABLES`."""

BASE, REFERENCE_NAME = "base", "reference"
"""Key at the head of a file: what it builds on, the reference or another parameter file by its name."""

REPLACE = "replace"
"""Key of a table: the lists of named tables, for instance equipment, that replace those of the base."""

ALTERNATIVES = (("position", "node"), ("speed_range", "maximum_speed"))
"""Keys of which a table has one, so that the one of the user's table takes the place of the other."""
EQUIPMENT = "equipment"
"""List of named tables in those of the structures."""
LIMITS = LimitsTable.SETTINGS
"""Keys of the weights that are made of the requirements."""


class ParameterFile:
    """One user's file: finds the line of a key for the message about it.

    Parameters
    ----------
    path : str
        For the messages.
    text : str
        Content of the file.
    """

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self.lines = dict(_keys(text))
        self._unknown: dict[str, Iterable[str]] = {}

    def error(self, key: str, problem: str) -> InputError:
        """A ValueError that names the file, the line and the key."""
        return InputError(f"{self.path}{', '.join(['', *self._line(key)])}: {key!r} {problem}")

    def _line(self, key: str) -> list[str]:
        """Line of a key, or of the table that it is in."""
        while key and key not in self.lines:
            key = re.sub(r"[.\[]?[^.\[]*$", "", key)
        return [f"line {self.lines[key]}"] if key else []

    def note_unknown(self, name: str, table: Mapping[str, Any], known: Iterable[str]) -> bool:
        """Whether a table of this name has keys that are not known, for :meth:`refuse_unknown`."""
        names = tuple(known)
        keys = {f"{name}.{key}": names for key in table if key not in names}
        self._unknown.update(keys)
        return bool(keys)

    def refuse_unknown(self) -> None:
        """Refuse all keys that were noted as unknown, each with its line.

        Raises
        ------
        ValueError
            There are any.
        """
        places = list(self.lines)
        in_order = sorted(self._unknown, key=lambda key: places.index(key) if key in places else -1)
        about = [": ".join([*self._line(key), unknown(key, self._unknown[key])]) for key in in_order]
        if about:
            raise InputError(f"{self.path}{', ' if about[0].startswith('line') else ': '}{'; '.join(about)}")

    @contextmanager
    def refusals(self, name: str) -> Iterator[None]:
        """What a class refuses of a table of this name becomes a ValueError that names file, line and key."""
        try:
            yield
        except Refused as error:
            refused = error.within(name)
            if refused.known:
                self._unknown.update(dict.fromkeys((refused.key, *refused.more), refused.known))
                self.refuse_unknown()
            raise self.error(refused.key, refused.problem) from None

    def require_all(self, tables: Mapping[str, Any]) -> None:
        """Refuse a file that lacks tables or keys and has no base to take them from.

        Raises
        ------
        ValueError
            With all of them.
        """
        frames = any(not tables.get(name, {}).get("modal_data") for name in ("body", "payload"))
        lacks = [f"[{name}]" for name in (*TABLES, *([MATERIALS] if frames else [])) if name not in tables]
        lacks += [] if REQUIREMENT in tables else [f"[[{REQUIREMENT}]]"]
        for name, kinds in TABLES.items():
            table = tables.get(name)
            if isinstance(table, dict):
                lacks += [f"{name}.{key}" for kind in kinds for key in kind.missing(table) if key not in LIMITS]
        if lacks:
            raise InputError(
                f'{self.path}: must have a base, or all that a telescope needs: {BASE} = "{REFERENCE_NAME}" takes from '
                f"the reference what los-testbed plant rows writes, got no {', '.join(lacks)}"
            )

    def check_tables(self, tables: Mapping[str, Any]) -> None:
        """Refuse values that the classes of the tables do not take; lists of tables are left to the layout.

        Raises
        ------
        ValueError
            A value of another kind, length or range.
        """
        for name, kinds in TABLES.items():
            table = tables[name]
            for kind in kinds if isinstance(table, dict) else ():
                with self.refusals(name):
                    if table.get("modal_data"):  # the keys of a frame need not be there
                        kind.check_given(table)
                    else:
                        kind.of_part(table)
        for name, table in tables.get(MATERIALS, {}).items():
            if not isinstance(table, dict):
                raise self.error(f"{MATERIALS}.{name}", f"must be a table, got {table!r}")
            with self.refusals(f"{MATERIALS}.{name}"):
                Material.of_table(table)

    def merged(self, base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
        """The tables of what a file builds on, with the values of the file.

        Unknown keys are left to `refuse_unknown`, what the classes of the tables check to `check_tables`.

        Raises
        ------
        ValueError
            No table where one is needed, a table of a list that cannot be.
        """
        result = dict(base)
        replaced = self._replaced(over, (REQUIREMENT,), "")
        for name, value in over.items():
            if name == REQUIREMENT:
                before = base.get(name, [])
                result[name] = self._merged_tables(name, RequirementTable, before, value, name in replaced)
            elif name in TABLES or name == MATERIALS:
                if not isinstance(value, dict):
                    raise self.error(name, f"must be a table, got {value!r}")
                before = base.get(name)
                result[name] = self._merged_table(name, before if isinstance(before, dict) else {}, value)
            elif name != REPLACE:
                self._unknown[name] = (*TABLES, MATERIALS, REQUIREMENT, *FURTHER, BASE, REPLACE)
        return result

    def _merged_table(self, name: str, base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
        """A table of `TABLES`, or that of the materials, with the values of the file."""
        result, known = dict(base), [key for kind in TABLES.get(name, ()) for key in kind.SETTINGS]
        lists = [EQUIPMENT] if EQUIPMENT in known else []
        replaced = self._replaced(over, lists, f"{name}.")
        for key, value in over.items():
            inner = f"{name}.{key}"
            if key == REPLACE and lists:
                continue
            if key in lists:
                result[key] = self._merged_tables(inner, Equipment, base.get(key, []), value, key in replaced)
            elif known and key not in known:
                self._unknown[inner] = [*known, *([REPLACE] if lists else [])]
            else:
                self._check_names(inner, value)
                result[key] = self._with_values(inner, base.get(key), value)
        return without_alternatives(result, over)

    def _with_values(self, name: str, base: Any, value: Any) -> Any:
        """A value of the file, of a table with those of the base that it leaves."""
        if not isinstance(base, dict):
            return value
        if not isinstance(value, dict):
            raise self.error(name, f"must be a table, got {value!r}")
        return {**base, **{key: self._with_values(f"{name}.{key}", base.get(key), one) for key, one in value.items()}}

    def _check_names(self, name: str, value: Any) -> None:
        """Note cross sections that a structure does not have; refuse points and sections whose name is none."""
        outer, _, inner = name.partition(".")
        kind = next(iter(TABLES.get(outer, ())), None)
        if inner not in ("ports", "sections") or kind is None or not isinstance(value, dict):
            return
        for key in value:
            if inner == "sections" and issubclass(kind, StructureTable) and not kind.is_section(key):
                self._unknown[f"{name}.{key}"] = kind.SECTIONS
            elif not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", key):
                raise self.error(f"{name}.{key}", "must have a name of letters, digits and _")

    def _replaced(self, over: Mapping[str, Any], lists: Sequence[str], prefix: str) -> list[str]:
        """Lists of named tables that the file replaces as a whole."""
        asked = over.get(REPLACE, []) if lists else []
        if not isinstance(asked, list) or any(key not in lists for key in asked):
            raise self.error(f"{prefix}{REPLACE}", f"must be a list of {', '.join(lists)}, got {asked!r}")
        for key in asked:
            if key not in over:
                raise self.error(f"{prefix}{REPLACE}", f"must name lists that this file holds, got {key!r}")
        return list(asked)

    def _merged_tables(
        self, name: str, kind: type[CheckedTable], base: list[dict[str, Any]], value: Any, replaced: bool
    ) -> list[dict[str, Any]]:
        """Tables of the base, those of the same name changed and others added by the file's, or the file's."""
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(name, f"must be tables [[{name}]], got {value!r}")
        by_name: dict[str, dict[str, Any]] = {item["name"]: item for item in base}
        named: set[str] = set()
        for i, item in enumerate(value):
            stated = item.get("name")
            merged = dict(item) if replaced or not isinstance(stated, str) else {**by_name.get(stated, {}), **item}
            merged = without_alternatives(merged, item)
            if self.note_unknown(f"{name}[{i}]", item, kind.SETTINGS):
                continue
            with self.refusals(f"{name}[{i}]"):
                kind.of_part(merged)
            if stated in named and not replaced:
                raise self.error(f"{name}[{i}].name", f"must be given once, got {stated!r} twice")
            named.add(stated)
            by_name[stated] = merged
        return value if replaced else list(by_name.values())


def without_alternatives(merged: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A merged table without the keys in place of which the user's table has others."""
    replaced = {
        other for pair in ALTERNATIVES for one, other in (pair, pair[::-1]) if one in over and other not in over
    }
    return {key: value for key, value in merged.items() if key not in replaced}


def _keys(text: str) -> Iterator[tuple[str, int]]:
    """Full name and line of every key and table; tables of a list have their number, ``name[0]``."""
    prefix, count = "", Counter[str]()
    for number, line in enumerate(text.splitlines(), start=1):
        head = re.match(r"\s*(\[\[?)\s*([\w.]+)\s*\]", line)
        entry = re.match(r"\s*([\w.]+)\s*=", line)
        if head:
            name = head[2]
            if head[1] == "[[":
                count[name] += 1
                name = f"{name}[{count[name] - 1}]"
            prefix = f"{name}."
            yield name, number
        elif entry:
            yield f"{prefix}{entry[1]}", number
