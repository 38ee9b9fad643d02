"""Checks of a user's parameter file against the reference file: names, kinds, lengths, signs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from lftkit.errors import InputError
from pointing_analysis.files.settings import CheckedTable, Refused
from titop_plant.ports import AXES
from titop_plant.sensors import SENSORS
from titop_plant.telescope.sections import LOOP_FREQUENCIES

T = TypeVar("T", bound=CheckedTable)

POSITIVE = {
    "mass",
    "moving_mass",
    "casing_mass",
    "axial_inertia",
    "radial_inertia",
    "stiffness",
    "frequencies",
    "frequency",
    "maximum_speed",
    "authority",
    "bandwidth",
    "los_sensitivity",
    "primary_focal_length",
    "mirror_distance",
    "back_focal_distance",
    "step_frequency",
    "ape_limit",
    "rpe_limit",
    "rpe_limit_fine",
    "rpe_window",
    "washout",
    "E",
    "G",
    "density",
    "size",
    "diameter",
    "thickness",
    "height",
    "width",
    "share",
    "aperture_diameter",
    "wavelength",
    "pixel_mas",
    "weight_mas",
}
"""Keys whose numbers must be above zero, in any table."""

ANY_SIGN = ("pma.height",)
"""By full name those that are positions: a section's height is above zero, that of the actuators is over a point."""

NOT_NEGATIVE = {
    "damping",
    "gearbox_stiffness",
    "gearbox_damping",
    "torque_bound",
    *(entry.noise for entry in SENSORS),
    "radial_force",
    "axial_force",
    "radial_torque",
    "modes",
    "tones",
    "wheel_imbalance",
    "spider_vanes",
    "spider_width",
}

RANGES = {
    "share": (0.0, 1.0, ""),
    "relative_uncertainty": (0.0, 0.99, ""),
    "obscuration": (0.0, 0.99, ""),
    "band_edge": (*LOOP_FREQUENCIES, " rad/s"),
}
"""Smallest and largest value of keys, and their unit."""

ANY_LENGTH = {"force_harmonics", "force_ratios", "torque_harmonics", "torque_ratios", "step_harmonics"}
"""Lists that may be longer or shorter than those of the reference."""

ANY_NUMBER = ("reaction_wheel.azimuths_deg", "reaction_wheel.default_speed", "pma.azimuths_deg")
"""The same by full name: how many there are is checked where all of the file is known."""

OPEN: Mapping[str, str] = {"body.ports.": "", "body.sections.": "bracket_"}
"""Tables in which a user may add names of this beginning, with values like those of the first such name there."""

REPLACE = "replace"
"""Key of a user's table: the lists of named tables, for instance equipment, that replace those of the reference."""

REQUIRED = {
    "equipment": {"name", "mass", "size"},
    "further_modes": {"frequency", "direction", "share"},
    "requirement": {"name", "text"},
}
OPTIONAL = {"equipment": {"position", "node"}, "further_modes": set[str](), "requirement": {"loop"}}


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

    def error(self, key: str, problem: str) -> InputError:
        """A ValueError that names the file, the line and the key."""
        known = key
        while known not in self.lines and "[" in known:
            known = known.rpartition("[")[0]
        line = self.lines.get(known)
        about = f"unknown parameter {key!r}, {problem}" if problem.startswith("expected") else f"{key!r} {problem}"
        return InputError(f"{self.path}{f', line {line}' if line else ''}: {about}")

    def made(self, kind: type[T], name: str, table: Mapping[str, Any], **parts: Any) -> T:
        """The object of a table of the file, made by its class, with parts that are made already; others read the rest.

        Raises
        ------
        ValueError
            A value that does not fit; the message names the file, the line and the key.
        """
        try:
            return kind.of_part(table, **parts)
        except Refused as error:
            raise self.refused(error.within(name)) from None

    def refused(self, error: Refused) -> InputError:
        """A ValueError that names the file, the line and the key of a refused value."""
        return self.error(error.key, error.problem)

    def merged(self, base: Mapping[str, Any], over: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
        """The reference's table, its values replaced by the user's.

        Raises
        ------
        ValueError
            An unknown key, a value of another kind, length or sign than the reference's.
        """
        result = dict(base)
        replaced = self._replaced(base, over, prefix)
        for key, value in over.items():
            name = f"{prefix}{key}"
            if key == REPLACE and _named(base):
                continue
            like = base[key] if key in base else self._model(name, key, prefix, base)
            if like is None:
                known = [*base, *([REPLACE] if _named(base) else [])]
                raise self.error(name, f"expected one of: {', '.join(known)}")
            if isinstance(like, dict):
                if not isinstance(value, dict):
                    raise self.error(name, f"must be a table, got {value!r}")
                result[key] = self.merged(like, value, f"{name}.")
            elif key in _named(base) and key not in replaced:
                result[key] = self._merged_tables(name, key, base[key], value)
            else:
                self.check(name, key, like, value)
                result[key] = value
        return result

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

    def _merged_tables(self, name: str, key: str, base: list[dict[str, Any]], value: Any) -> list[dict[str, Any]]:
        """Tables of the reference, those of the same name changed and others added by the user's."""
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(name, f"must be tables [[{name}]], got {value!r}")
        found = {item["name"]: dict(item) for item in base}
        given: set[str] = set()
        for i, item in enumerate(value):
            own = item.get("name")
            if not isinstance(own, str):
                raise self.error(
                    f"{name}[{i}]", "has no 'name'" if own is None else f"must have a text as name, got {own!r}"
                )
            if own in given:
                raise self.error(f"{name}[{i}].name", f"must be given once, got {own!r} twice")
            given.add(own)
            merged = {**found.get(own, {}), **item}
            for one, other in (("position", "node"), ("node", "position")):
                if one in item and other not in item:
                    merged.pop(other, None)
            self._check_tables(name, key, [merged], first=i)
            found[own] = merged
        return list(found.values())

    def check(self, name: str, key: str, base: Any, value: Any) -> None:
        """Refuse a value of another kind, length or sign than the reference's."""
        if key in REQUIRED:
            self._check_tables(name, key, value)
        elif isinstance(base, str):
            if not isinstance(value, str):
                raise self.error(name, f"must be a text in quotes, got {value!r}")
        elif isinstance(base, list):
            self._check_list(name, key, base, value)
        else:
            self._check_number(name, key, value, isinstance(base, int))

    def _check_list(self, name: str, key: str, base: list[Any], value: Any) -> None:
        if not isinstance(value, list):
            raise self.error(name, f"must be a list of {len(base)}, got {value!r}")
        if key not in ANY_LENGTH and name not in ANY_NUMBER and len(value) != len(base):
            raise self.error(name, f"must have {len(base)} entries, got {len(value)}")
        for i, item in enumerate(value):
            self.check(f"{name}[{i}]", key, base[min(i, len(base) - 1)], item)

    def _check_number(self, name: str, key: str, value: Any, whole: bool) -> None:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(name, f"must be a number, got {value!r}")
        if whole and not isinstance(value, int):
            raise self.error(name, f"must be a whole number, got {value!r}")
        if key in POSITIVE and name not in ANY_SIGN and not value > 0:
            raise self.error(name, f"must be positive, got {value!r}")
        if key in NOT_NEGATIVE and not value >= 0:
            raise self.error(name, f"must not be negative, got {value!r}")
        low, high, unit = RANGES.get(key, (-math.inf, math.inf, ""))
        if not low <= value <= high:
            raise self.error(name, f"must be between {low:g} and {high:g}{unit}, got {value!r}")
        if key == "theta_range" and not abs(value) < 2.0 * math.pi:
            raise self.error(
                name, f"must be between -2 pi and 2 pi rad, where tau = tan(theta/4) is regular, got {value!r}"
            )

    def _check_names(self, name: str, value: Any) -> None:
        names = value if isinstance(value, list) else [value]
        if not all(isinstance(item, str) for item in names):
            raise self.error(name, f"must be a text or a list of texts, got {value!r}")

    def _check_tables(self, name: str, key: str, value: Any, first: int = 0) -> None:
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(name, f"must be tables [[{name}]], got {value!r}")
        for i, item in enumerate(value, start=first):
            for missing in sorted(REQUIRED[key] - set(item)):
                raise self.error(f"{name}[{i}]", f"has no {missing!r}")
            for unknown in sorted(set(item) - REQUIRED[key] - OPTIONAL[key]):
                known = ", ".join(sorted(REQUIRED[key] | OPTIONAL[key]))
                raise self.error(f"{name}[{i}].{unknown}", f"expected one of: {known}")
            if key == "equipment" and not {"position", "node"} & set(item):
                raise self.error(f"{name}[{i}]", "needs a 'position' or a 'node'")
            for part, entry in item.items():
                if part == "loop":
                    self._check_names(f"{name}[{i}].{part}", entry)
                    continue
                like: Any = [0.0] * 3 if part in ("size", "position") else "" if part in _TEXTS else 0.0
                self.check(f"{name}[{i}].{part}", part, like, entry)
            if key == "further_modes" and item["direction"] not in AXES:
                raise self.error(
                    f"{name}[{i}].direction", f"must be one of {', '.join(AXES)}, got {item['direction']!r}"
                )


def _named(base: Mapping[str, Any]) -> list[str]:
    """Keys of the lists whose tables have names."""
    return [key for key in base if "name" in REQUIRED.get(key, ())]


_TEXTS = ("name", "node", "direction", "text")


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
