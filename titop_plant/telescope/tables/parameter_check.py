"""Checks of a user's parameter file against the reference file: names, kinds, lengths, signs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.files.settings import CheckedTable, Refused, unknown
from titop_plant.sensors import SENSORS, TICKS_PER_SECOND, whole_ticks
from titop_plant.telescope.sections import TABLES, Equipment, Material, RequirementTable

NOT_NEGATIVE = {entry.noise for entry in SENSORS}
"""Keys of the table of the sensors whose numbers must not be negative."""

RATES = {entry.rate for entry in SENSORS if entry.framed}
"""Keys of its rates, which divide the tick rate."""

OPEN: Mapping[str, str] = {"body.ports.": "", "body.sections.": "bracket_"}
"""Tables in which a user may add names of this beginning, with values like those of the first such name there."""

REPLACE = "replace"
"""Key of a user's table: the lists of named tables, for instance equipment, that replace those of the reference."""

ALTERNATIVES = (("position", "node"), ("speed_range", "maximum_speed"))
"""Keys of which a table has one, so that the one of the user's table takes the place of the other."""
LISTS: Mapping[str, type[CheckedTable]] = {"equipment": Equipment, "requirement": RequirementTable}
"""Classes of the tables of lists in which a name is given once."""


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

    def check_tables(self, tables: Mapping[str, Any]) -> None:
        """Refuse values that the classes of the tables do not take.

        Raises
        ------
        ValueError
            A value of another kind, length or range.
        """
        for name, kinds in TABLES.items():
            for kind in kinds:
                with self.refusals(name):
                    kind.of_part(tables[name])
        for name, table in tables["materials"].items():
            with self.refusals(f"materials.{name}"):
                Material.of_part(table)

    def merged(self, base: Mapping[str, Any], over: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
        """The reference's table, its values replaced by the user's; unknown keys are left to `refuse_unknown`.

        Raises
        ------
        ValueError
            No table where one is needed, a table of a list that cannot be; what the classes of the
        tables check is left to `check_tables`.
        """
        result = dict(base)
        replaced = self._replaced(base, over, prefix)
        added = {name for kind in TABLES.get(prefix.removesuffix("."), ()) for name in kind.SETTINGS}
        for key, value in over.items():
            name = f"{prefix}{key}"
            if key == REPLACE and _named(base):
                continue
            like = base[key] if key in base else self._model(name, key, prefix, base)
            if like is None and key not in added:
                known = dict.fromkeys([*base, *sorted(added), *([REPLACE] if _named(base) else [])])
                self._unknown[name] = known
            elif isinstance(like, dict):
                if not isinstance(value, dict):
                    raise self.error(name, f"must be a table, got {value!r}")
                result[key] = self.merged(like, value, f"{name}.")
            elif key in _named(base):
                result[key] = self._merged_tables(name, LISTS[key], base[key], value, key in replaced)
            else:
                if prefix == "sensors.":
                    self.check(name, key, like, value)
                result[key] = value
        return without_alternatives(result, over)

    def _model(self, name: str, key: str, prefix: str, base: Mapping[str, Any]) -> Any:
        """Value of the reference that one with a name of the user must be like; None where none may be added."""
        if prefix not in OPEN or not key.startswith(OPEN[prefix]):
            return None
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", key):
            raise self.error(name, "must have a name of letters, digits and _")
        return next(value for known, value in base.items() if known.startswith(OPEN[prefix]))

    def _replaced(self, base: Mapping[str, Any], over: Mapping[str, Any], prefix: str) -> list[str]:
        """Lists of named tables that the user's file replaces as a whole."""
        asked = over.get(REPLACE, []) if _named(base) else []
        if not isinstance(asked, list) or any(key not in _named(base) for key in asked):
            raise self.error(f"{prefix}{REPLACE}", f"must be a list of {', '.join(_named(base))}, got {asked!r}")
        for key in asked:
            if key not in over:
                raise self.error(f"{prefix}{REPLACE}", f"must name lists that this file holds, got {key!r}")
        return asked

    def _merged_tables(
        self, name: str, kind: type[CheckedTable], base: list[dict[str, Any]], value: Any, replaced: bool
    ) -> list[dict[str, Any]]:
        """Tables of the reference, those of the same name changed and others added by the user's, or the user's."""
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

    def check_rate(self, name: str, rate: float) -> None:
        """Refuse a rate of samples [Hz] that does not divide that of the ticks, or that is below 1 Hz."""
        if not rate >= 1.0 or whole_ticks(rate) is None:
            text = f"must divide {TICKS_PER_SECOND} Hz (50, 40, 25, ...) and be 1 Hz at least, got {rate!r} Hz"
            raise self.error(name, text)

    def check(self, name: str, key: str, base: Any, value: Any) -> None:
        """Refuse a value of another kind, length or sign than that of a table without a class."""
        if isinstance(base, str):
            if not isinstance(value, str):
                raise self.error(name, f"must be a text in quotes, got {value!r}")
        elif isinstance(base, list):
            if not isinstance(value, list):
                raise self.error(name, f"must be a list of {len(base)}, got {value!r}")
            if len(value) != len(base):
                raise self.error(name, f"must have {len(base)} entries, got {len(value)}")
            for i, (like, item) in enumerate(zip(base, value)):
                self.check(f"{name}[{i}]", key, like, item)
        else:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise self.error(name, f"must be a number, got {value!r}")
            if key == "washout" and not value > 0:
                raise self.error(name, f"must be positive, got {value!r}")
            if key in NOT_NEGATIVE and not value >= 0:
                raise self.error(name, f"must not be negative, got {value!r}")
            if key in RATES:
                self.check_rate(name, value)


def without_alternatives(merged: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A merged table without the keys in place of which the user's table has others."""
    replaced = {
        other for pair in ALTERNATIVES for one, other in (pair, pair[::-1]) if one in over and other not in over
    }
    return {key: value for key, value in merged.items() if key not in replaced}


def _named(base: Mapping[str, Any]) -> list[str]:
    """Keys of the lists whose tables have names."""
    return [key for key in base if key in LISTS]


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
