"""A table as arrays by name, with the units and the rate stated in its file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError
from lftkit.support.input_limits import UNPACKED, UNPACKED_RATIO, most_unpacked
from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.units import ANGLES

Column = FloatArray | IntArray | NDArray[np.datetime64]
WIDEST = 12
"""Columns that an array of two dimensions may have to be columns of a table."""
LISTED = 20
"""Names of columns in a message."""
SAME_RATE = 1e-6
"""Part by which two statements of one sampling rate may differ: a period is written with six digits or more."""
RATES = ("rate", "fs", "sampling_rate", "sample_rate", "samplerate", "sampling_frequency", "rate_hz", "fs_hz")
PERIODS = ("dt", "ts", "sample_time", "sampling_period", "sampling_time", "dt_s", "ts_s")
_SPELLINGS = {
    "µrad": "urad",
    "μrad": "urad",
    "microrad": "urad",
    "microradian": "urad",
    "microradians": "urad",
    "millirad": "mrad",
    "milliradian": "mrad",
    "milliradians": "mrad",
    "nanorad": "nrad",
    "radian": "rad",
    "radians": "rad",
    "arcseconds": "arcsec",
    "arcsecond": "arcsec",
    "arcsecs": "arcsec",
    "arc sec": "arcsec",
    "arcs": "arcsec",
    "as": "arcsec",
    '"': "arcsec",
    "\N{DOUBLE PRIME}": "arcsec",
    "asec": "arcsec",
    "milliarcsec": "mas",
    "milliarcsecond": "mas",
    "milliarcseconds": "mas",
    "marcsec": "mas",
    "arcminute": "arcmin",
    "arcminutes": "arcmin",
    "arc min": "arcmin",
    "'": "arcmin",
    "\N{PRIME}": "arcmin",
    "degree": "deg",
    "degrees": "deg",
    "\N{DEGREE SIGN}": "deg",
    "pixel": "px",
    "pixels": "px",
    "pix": "px",
    "rad_s": "rad/s",
    "deg_s": "deg/s",
    "dps": "deg/s",
    "µs": "us",
    "μs": "us",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "millisec": "ms",
    "millisecond": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "microsec": "us",
    "microsecond": "us",
    "microseconds": "us",
    "nsec": "ns",
    "nanosec": "ns",
    "nanosecond": "ns",
    "nanoseconds": "ns",
    "mins": "min",
    "minute": "min",
    "minutes": "min",
    "hr": "h",
    "hrs": "h",
    "hour": "h",
    "hours": "h",
    "day": "d",
    "days": "d",
    "n": "N",
    "newton": "N",
    "nm": "Nm",
    "n m": "Nm",
    "n*m": "Nm",
    "n.m": "Nm",
    "n·m": "Nm",
    "mnm": "mNm",
    "mn": "mN",
}
_IN_BRACKETS = re.compile(r"^(.+?)\s*[\[(]\s*((?:[^\[\]()]|\([^()]*\))+?)\s*[\])]$")
_ANGLES_AT_THE_END = "mas|arcsec|arcmin|mdeg|deg|degrees?|nrad|[uµμ]rad|mrad|rad"
_OTHERS_AT_THE_END = "rad[_/]s|deg[_/]s|dps|px|pix|pixels?|mm|um"  # never taken for an angle
_TIMES_AT_THE_END = "s|ms|us|ns|sec|msec|usec|nsec"
_AT_THE_END = re.compile(rf"^(.+?)_((?i:{_ANGLES_AT_THE_END}|{_OTHERS_AT_THE_END}|{_TIMES_AT_THE_END})|mNm|mN|Nm|N)$")
_BEHIND_A_MARK = re.compile(rf"^(.+?)(?: in |, ?| ?/ ?| )((?i:{_ANGLES_AT_THE_END}|{_OTHERS_AT_THE_END})|mNm|mN|Nm|N)$")
"""``x, mas``, ``x/mas`` (ISO 80000-1), ``x in mas``."""
_TIME_AT_THE_END = re.compile(
    rf"^((?:.*\.)?(?:t|time|timestamp|stamp|zeit))(?:_(min|h|d)|(?: in |, ?| ?/ ?| )({_TIMES_AT_THE_END}|µs|min|h|d))$",
    re.IGNORECASE,
)


def same_rate(one: float, other: float) -> bool:
    """Whether two rates [Hz] are the same but for the digits with which they are written."""
    return abs(one - other) <= SAME_RATE * one


def unit_name(text: str) -> str:
    """The usual spelling of a unit.

    Examples
    --------
    >>> unit_name("µrad"), unit_name(" MAS "), unit_name("N.m")
    ('urad', 'mas', 'Nm')
    """
    text = " ".join(text.split()).partition(" since ")[0]  # of times by the conventions of netCDF
    if text in ("N", "Nm", "mN", "mNm", "Mrad") or text.startswith("MN"):  # mega is not milli
        return text
    return _SPELLINGS.get(text.lower(), text.lower())


def split_unit(name: str) -> tuple[str, str]:
    """Name of a column without its unit, and the unit; empty where it names none.

    Examples
    --------
    >>> split_unit("LOS_X (urad)"), split_unit("los_x [mas]"), split_unit("time_ms"), split_unit("roll_rate")
    (('LOS_X', 'urad'), ('los_x', 'mas'), ('time', 'ms'), ('roll_rate', ''))
    >>> split_unit("x_deg"), split_unit("x_rad_s"), split_unit("x_min"), split_unit("time_min")
    (('x', 'deg'), ('x', 'rad/s'), ('x_min', ''), ('time', 'min'))
    >>> split_unit("x/mas"), split_unit("y, urad"), split_unit("t/ms"), split_unit("flow/s")
    (('x', 'mas'), ('y', 'urad'), ('t', 'ms'), ('flow/s', ''))
    """
    kinds = (_IN_BRACKETS, _AT_THE_END, _BEHIND_A_MARK, _TIME_AT_THE_END)
    match = next((m for kind in kinds if (m := kind.match(name.strip()))), None)
    if match is None:
        return name.strip(), ""
    base, *units = match.groups()
    return base, unit_name(next(unit for unit in units if unit))


def units_in(name: str) -> list[str]:
    """Units that the name of a column has: one behind the other where there are several.

    Examples
    --------
    >>> units_in("x_urad (mas)"), units_in("x [mas]"), units_in("roll_rate")
    (['mas', 'urad'], ['mas'], [])
    """
    rest, unit = split_unit(name)
    return [unit, *units_in(rest)] if unit else []


@dataclass(frozen=True)
class Table:
    """Columns of a file.

    Attributes
    ----------
    path : the file
    kind : its format in words
    columns : (n,) each, by name; n may differ between columns
    units : of columns, as stated in the file besides the name: as attribute, as text, in a comment
    rates : sampling rates [Hz] of columns, as stated in the file
    left_out : what of the file is not used, one sentence each
    names : of all columns in the order of the file, those that are left out too; empty: `columns` are all
    texts : row in the file and first cell that is no number, of columns that are left out for it
    """

    path: Path
    kind: str
    columns: Mapping[str, Column]
    units: Mapping[str, Sequence[str]] = field(default_factory=lambda: MappingProxyType({}))
    rates: Mapping[str, Sequence[float]] = field(default_factory=lambda: MappingProxyType({}))
    left_out: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    texts: Mapping[str, tuple[int, str]] = field(default_factory=lambda: MappingProxyType({}))

    def refuse_text(self, name: str, expected: str = "a number") -> None:
        """Refuse a column that was left out because of a cell; no effect on any other name."""
        if name in self.texts:
            row, cell = self.texts[name]
            raise InputError(f"{self.path}: row {row}, column {name} must be {expected}, got {cell!r}")

    def find(self, name: str) -> str | None:
        """Full name of a column that is named with or without its unit; None where there is none, or several."""
        if name in self.columns:
            return name
        columns = [column for column in self.columns if split_unit(column)[0] == name]
        return columns[0] if len(columns) == 1 else None

    def unit(self, name: str) -> str:
        """Unit of a column by attribute, comment or header; empty if not stated.

        Raises
        ------
        InputError
            Two units of one column.
        """
        stated = [unit_name(text) for text in self.units.get(name, ())]
        units = list(dict.fromkeys((*stated, *units_in(name))))
        if len(units) > 1:
            raise InputError(f"{self.path}: unit of {name} must be one, got {' and '.join(units)} in the file")
        return units[0] if units else ""

    def rate(self, names: Sequence[str]) -> float | None:
        """Sampling rate [Hz] stated in the file for columns; None if not stated.

        Raises
        ------
        InputError
            Two rates.
        """
        rates = sorted({rate for name in names for rate in self.rates.get(name, ())})
        if rates and not same_rate(rates[0], rates[-1]):
            rates_stated = f"{rates[0]:.9g} and {rates[-1]:.9g} Hz"
            raise InputError(f"{self.path}: rate of {' and '.join(names)} must be one, got {rates_stated} in the file")
        return rates[0] if rates else None

    def of_length(self, n: int) -> dict[str, Column]:
        """Columns of `n` rows."""
        return {name: column for name, column in self.columns.items() if len(column) == n}

    def listed(self) -> str:
        """Names of the columns, for messages."""
        names = list(self.columns)
        return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} others" if len(names) > LISTED else "")


def check_unpacked(path: Path, size: int) -> None:
    """Some kilobytes can stand for any number of rows: the declared size is checked before memory is taken."""
    if size > most_unpacked(path.stat().st_size):
        raise InputError(
            f"{path}: table must unpack to at most {UNPACKED / 1e6:g} MB or {UNPACKED_RATIO} times its size, "
            f"got {size / 1e6:.0f} MB"
        )


@dataclass
class Gathered:
    """Content of a file with named arrays: columns, and stated units and rates by owner."""

    columns: dict[str, Column] = field(default_factory=dict)
    units: dict[str, list[str]] = field(default_factory=dict)
    rates: dict[str, list[float]] = field(default_factory=dict)
    complex_arrays: list[str] = field(default_factory=list)

    def add(self, name: str, array: NDArray[Any], unit: str = "") -> None:
        """An array: a column, some columns side by side, or a scalar that may be the rate; another one is left out."""
        if array.dtype.names:
            for part in array.dtype.names:
                self.add(f"{name}.{part}", array[part], unit)
            return
        if array.dtype.kind == "m":
            array, unit = array.astype("timedelta64[ns]").astype(np.int64), "ns"
        if array.dtype.kind == "c" and array.size > 1:
            self.complex_arrays.append(name)
        if array.dtype.kind not in "fiuM" or array.ndim > 2:
            return
        if array.size == 1:
            self.add_setting(name, array)
            return
        if array.ndim == 2 and 1 in array.shape:
            array = array.reshape(-1)
        if array.ndim == 1:
            self._put(name, array, unit)
        elif array.ndim == 2:
            side = array.T if array.shape[0] <= WIDEST < array.shape[1] or array.shape[0] < array.shape[1] else array
            if side.shape[1] > WIDEST:
                return
            axes: Sequence[str] = "xyz" if side.shape[1] <= 3 else [str(i + 1) for i in range(side.shape[1])]
            for axis, column in zip(axes, side.T):
                self._put(f"{name}.{axis}", column, unit)

    def add_setting(self, name: str, value: NDArray[np.generic] | str) -> None:
        """A number or text beside the arrays: the rate, the period, or the unit of an array."""
        owner, _, short = name.rpartition(".")
        short = short.lower()
        if isinstance(value, str):
            if short in ("unit", "units"):
                self.add_unit(owner, value)
            elif short.endswith(("_unit", "_units")):
                self.add_unit(name.rpartition("_")[0], value)
            return
        number = float(value.reshape(-1)[0]) if value.dtype.kind in "fiu" else np.nan
        if 0 < number < np.inf and short in (*RATES, *PERIODS):
            self.rates.setdefault(owner, []).append(number if short in RATES else 1 / number)

    def add_unit(self, owner: str, unit: str) -> None:
        """Add a unit stated in the file for an array or a group."""
        self.units.setdefault(owner, []).append(unit)

    def _put(self, name: str, array: NDArray[np.generic], unit: str) -> None:
        self.columns[name] = np.ascontiguousarray(array)
        if unit:
            self.add_unit(name, unit)

    def table(self, path: Path, kind: str, left_out: Sequence[str] = ()) -> Table:
        """The table; statements about an array apply to its columns, about a group to all in it."""
        named = {
            owner: unit
            for name in self.columns
            for owner in _owners(name)
            if (unit := split_unit(owner)[1]) and (owner == name or unit in ANGLES)
        }
        units = {owner: [*self.units.get(owner, ()), *filter(None, [named.get(owner)])] for owner in self.units | named}
        about = {name: next((units[o] for o in _owners(name) if o in units), ()) for name in self.columns}
        rates = {name: next((self.rates[o] for o in _owners(name) if o in self.rates), ()) for name in self.columns}
        unused = [f"complex numbers not used: {', '.join(self.complex_arrays)}"] if self.complex_arrays else []
        return Table(path, kind, self.columns, about, rates, (*left_out, *unused))


def _owners(name: str) -> list[str]:
    """An array, the groups that it is in, from the nearest one on, and the file."""
    parts = name.split(".")
    return [".".join(parts[:i]) for i in range(len(parts), -1, -1)]
