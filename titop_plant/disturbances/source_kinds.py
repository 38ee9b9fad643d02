"""Kinds of sources of disturbance: from the table of a source to its signal, with the checks of its keys.

The keys of each kind are listed in :mod:`los_testbed.parts.disturbance_files`.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.tables.los_table import read_table
from pointing_analysis.read.tables.table import Column, Table, split_unit
from pointing_analysis.read.tables.times import column_stamps, refuse_text_times, time_column
from pointing_analysis.read.time_grid import NANO, time_grid
from titop_plant.disturbances.units import DENSITY, FORCE, FREQUENCY, ORDER, PER_SPEED_SQUARED, Units, WrenchUnits
from titop_plant.interface import DT

if TYPE_CHECKING:
    from titop_plant.disturbances.signals import Signal

AXES = (
    ("fx", "force_x", "force.x"),
    ("fy", "force_y", "force.y"),
    ("fz", "force_z", "force.z"),
    ("tx", "mx", "torque_x", "torque.x"),
    ("ty", "my", "torque_y", "torque.y"),
    ("tz", "mz", "torque_z", "torque.z"),
)
"""Names of the columns of the six axes, in any case; an array of six columns is ``wrench``."""
LARGEST = 1e7
"""[N, Nm] Larger values are no force on a spacecraft."""
SAME_RATE = 1e-3
"""Part by which a rate that is given may differ from that of the file."""


@dataclass(frozen=True)
class RunConditions:
    """Parameters of a run for its sources: wheel speeds [rad/s], length [s], seed, names of the wheels."""

    speeds: tuple[float, ...]
    duration: float
    seed: int
    names: tuple[str, ...] = ()

    def speed_at(self, place: str) -> float | None:
        """Speed of the wheel at a place [rad/s]; None where there is no wheel."""
        places = {f"wheel_{i}": speed for i, speed in enumerate(self.speeds, start=1)}
        return {**places, **dict(zip(self.names, self.speeds))}.get(place)


FREQUENCIES = ("frequency", "freq", "f")
"""Names of columns of frequencies."""


@dataclass(frozen=True)
class DisturbanceTable:
    """One table ``[[disturbance]]`` with the folder of its file."""

    table: Mapping[str, Any]
    folder: Path
    where: str
    _tables: list[Table] = field(default_factory=list, init=False, compare=False, repr=False)
    _used: set[str] = field(default_factory=set, init=False, compare=False, repr=False)

    def error(self, text: str) -> InputError:
        """A ValueError that names file and source."""
        return InputError(f"{self.where}, disturbance {self.table.get('name', '?')!r}: {text}")

    def number(self, key: str, default: float | None = None, low: float = -math.inf) -> float:
        """A finite number, above `low`."""
        value = self.table.get(key, default)
        if not is_number(value) or not (math.isfinite(value) or value == default) or not value > low:
            above = "" if low == -math.inf else f" above {low:g}"
            raise self.error(f"{key} must be a number{above}, got {value!r}")
        return float(value)

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.table.get(key, default)
        if not isinstance(value, bool):
            raise self.error(f"{key} must be true or false, got {value!r}")
        return value

    def wrench(self, table: Mapping[str, Any] | None = None) -> FloatArray:
        """Force and torque (6,) of this table or of one in it; one of the two may be missing."""
        own = self.table if table is None else table
        if not {"force", "torque"} & set(own):
            raise self.error(f"force or torque must be given, got {', '.join(own)}")
        return np.concatenate([self.vector("force", own), self.vector("torque", own)])

    def vector(self, key: str, table: Mapping[str, Any] | None = None) -> FloatArray:
        """Three numbers, zero where the key is missing."""
        value = (self.table if table is None else table).get(key, [0.0, 0.0, 0.0])
        try:
            found = np.array(value, dtype=float)
        except (TypeError, ValueError):
            found = np.zeros(0)
        if found.shape != (3,) or not (np.abs(found) <= LARGEST).all():
            raise self.error(f"{key} must be three numbers, got {value!r}")
        return found

    def file(self) -> Table:
        """Table of values."""
        name = self.table.get("file")
        if not isinstance(name, str):
            raise self.error(f"file must be the name of a file, got {name!r}")
        try:
            table = read_table(self.folder / name)
        except ValueError as error:
            raise self.error(f"file: {error}") from None
        self._tables.append(table)
        return table

    def column(self, table: Table, name: str) -> Column:
        """A column, which is noted as used."""
        self._used.add(name)
        return table.columns[name]

    def ignored(self) -> tuple[str, ...]:
        """Entries of the files without effect on the source, one sentence each."""
        rows = [text for table in self._tables for text in table.left_out]
        names = [name for table in self._tables for name in table.columns if name not in self._used]
        return (*rows, *([f"columns not used: {', '.join(names)}"] if names else []))


def _rng(entry: DisturbanceTable, run: RunConditions) -> np.random.Generator:
    key = zlib.crc32(str(entry.table["name"]).encode())
    return np.random.default_rng(np.random.SeedSequence(run.seed, spawn_key=(98, key)))


def _axes(entry: DisturbanceTable, table: Table, n: int, units: WrenchUnits = FORCE) -> FloatArray:
    """Values (n, 6) of a table, in SI units; of an array of six columns the unit may be two, ``N, Nm``."""
    values = np.zeros((n, 6))
    bases: dict[str, str] = {}
    spelled = {base for names in AXES for base in names}
    for name in table.of_length(n):
        first = bases.setdefault(base := split_unit(name)[0].lower(), name)
        if name != first and base in spelled:
            raise entry.error(f"{table.path} must have one column for each axis, got {first} and {name}")
    whole = [f"wrench.{i + 1}" for i in range(6)]
    found = 0
    for name in table.texts:
        if split_unit(name)[0].lower() in spelled:
            table.refuse_text(name)
    for axis, names in enumerate(AXES):
        for base in (*names, whole[axis]):
            column = next((bases[key] for key in bases if key == base or key.endswith(f".{base}")), None)
            if column is not None:
                both = table.unit(column).replace(";", ",").split(",")
                unit = both[axis // 3] if len(both) == 2 else table.unit(column)
                values[:, axis] = _scaled(entry, table, column, units.of_axis(axis), unit)
                found += 1
                break
    if not found:
        names_ = ", ".join(names[0].capitalize() for names in AXES)
        raise entry.error(f"{table.path} must have columns of {names_}, got {table.listed()}")
    odd = ~(np.abs(values) <= LARGEST)
    if odd.any():
        raise entry.error(f"{table.path} must have finite values in every row, got {int(odd.sum())} that are not")
    return values


def _scaled(entry: DisturbanceTable, table: Table, column: str, units: Units, unit: str) -> FloatArray:
    """Values of a column in SI units."""
    scale = units.scale(unit)
    if scale is None:
        raise entry.error(f"unit of {column} must be {units.expected}, got {unit!r}")
    return np.asarray(entry.column(table, column), dtype=float) * scale


def _column(entry: DisturbanceTable, table: Table, *names: str, units: Units | None = None) -> FloatArray:
    for name in table.columns:
        if split_unit(name)[0].lower() in names:
            if units is not None:
                return _scaled(entry, table, name, units, table.unit(name))
            return np.asarray(entry.column(table, name), dtype=float)
    for name in table.texts:
        if split_unit(name)[0].lower() in names:
            table.refuse_text(name)
    raise entry.error(f"{table.path} must have a column {names[0]}, got {table.listed()}")


Made = tuple["Signal", tuple[str, ...]]


def _series(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.signals import SampledSignal, repeated

    keeps_mean, repeats = entry.flag("keep_mean", False), entry.flag("repeat", False)
    table = entry.file()
    n = max(len(column) for column in table.columns.values())
    values, remarks = _axes(entry, table, n), []
    rate = _rate(entry, table, n)
    length = n / rate
    if not keeps_mean:
        mean = values.mean(axis=0)
        values = values - mean
        if np.abs(mean).max() > 0.01 * values.std():
            remarks.append(f"mean {_listed(mean)} removed (keep_mean = true keeps it)")
    if length < run.duration:
        if not repeats:
            raise entry.error(
                f"{table.path} must be as long as the run, {run.duration:g} s, got {length:g} s "
                "(repeat = true repeats it)"
            )
        values = repeated(values, rate)
        faded = (n - len(values)) / rate
        how = f"its end faded into its beginning over {faded:g} s" if faded else "as it is"
        remarks.append(f"record repeated every {len(values) / rate:g} s, {how}")
    return SampledSignal(values, rate, DT), tuple(remarks)


def _rate(entry: DisturbanceTable, table: Table, n: int) -> float:
    """Sampling rate [Hz] of a series: by its times, by the file, or as given; one that is given must be the same."""
    given = entry.number("rate", None, 0.0) if "rate" in entry.table else None
    when = time_column(table.of_length(n), [])
    own = _rate_by_times(entry, table, when, given) if when is not None else table.rate(list(table.of_length(n)))
    if own is None:
        if given is None:
            refuse_text_times(table)
            raise entry.error(f"{table.path} must have a column time, or rate must be given, got {table.listed()}")
        return entry.number("rate", None, 0.0)
    if given is not None and abs(given - own) > SAME_RATE * own:
        source = f"column {when}" if when is not None else "file"
        raise entry.error(f"rate must be that of {table.path}, {own:g} Hz by its {source}, got {given:g} Hz")
    return own


def _rate_by_times(entry: DisturbanceTable, table: Table, when: str, given: float | None) -> float:
    """Sampling rate [Hz] by a column of times; a rate that is `given` tells that they are in seconds."""
    unit = table.unit(when)
    try:
        stamps = column_stamps(when, entry.column(table, when), given, "" if FORCE.knows(unit) else unit)
    except ValueError as error:
        raise entry.error(f"{table.path}: {error}") from None
    seconds = (stamps - stamps.min()) / NANO
    grid = time_grid(seconds)
    if grid is None or not grid.fits or not np.array_equal(grid.place, np.arange(stamps.size)):
        steps = np.diff(seconds) if stamps.size > 1 else np.zeros(1)
        raise entry.error(
            f"times of {table.path} must be uniform and without gaps, got steps of {steps.min():g} to {steps.max():g} s"
        )
    return 1.0 / grid.period


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _harmonics(entry: DisturbanceTable, units: WrenchUnits = FORCE) -> list[tuple[float, FloatArray]]:
    """Order and amplitudes (6,) of each harmonic, of a list in the file itself or of a table."""
    tables = entry.table.get("harmonics")
    if tables is not None and "file" in entry.table:
        raise entry.error(f"harmonics must be in a file or in the table, got both: {entry.table['file']!r} and a list")
    if tables is None and "file" not in entry.table:
        raise entry.error("harmonics or file must be given, got neither")
    if tables is None:
        table = entry.file()
        order = _column(entry, table, "order", "harmonic", units=ORDER)
        rows = list(zip(order.tolist(), _axes(entry, table, len(order), units)))
    elif isinstance(tables, list) and tables and all(isinstance(one, dict) and "order" in one for one in tables):
        unknown = sorted({key for one in tables for key in one} - {"order", "force", "torque"})
        if unknown:
            raise entry.error(f"keys of a harmonic must be among order, force, torque, got {', '.join(unknown)}")
        rows = [(one["order"], entry.wrench(one)) for one in tables]
    else:
        raise entry.error(f"harmonics must be tables with order, force and torque, got {tables!r}")
    for order, _ in rows:
        if not is_number(order) or not 0 < order < math.inf:
            raise entry.error(f"order of a harmonic must be a number above 0, got {order!r}")
    return [(float(order), amplitude) for order, amplitude in rows]


def _speed(entry: DisturbanceTable, run: RunConditions) -> float:
    """Speed of a rotor [rad/s]: given, or that of the wheel where it is."""
    place = entry.table.get("place", "bus")
    if "speed" in entry.table:
        return entry.number("speed")
    if (speed := run.speed_at(str(place))) is not None:
        return speed
    raise entry.error(f"speed must be given [rad/s] at {place}, which is no wheel, got none")


def _phased(amplitude: FloatArray, sense: float, rng: np.random.Generator) -> ComplexArray:
    """Amplitudes with random phases; radial ones turn with the rotor, **x leads y by a quarter turn for sense > 0**."""
    force, axial, torque, about = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, 4))
    turn = -1j * sense
    return np.asarray(amplitude * np.array([force, turn * force, axial, torque, turn * torque, about]))


def _wheel(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.signals import tone_signal

    speed, rng = _speed(entry, run), _rng(entry, run)
    squared = entry.flag("squared", True)
    sense, size = float(np.sign(speed)) or 1.0, speed**2 if squared else 1.0
    found = _harmonics(entry, PER_SPEED_SQUARED if squared else FORCE)
    rows = [(h, h * abs(speed), size * _phased(a, sense, rng)) for h, a in found]
    return _audible(tone_signal, rows)


def _audible(make: Callable[..., Signal], rows: list[tuple[float, float, ComplexArray]], *more: Any) -> Made:
    """Tones below the tick rate; higher ones are excluded and reported."""
    kept = [row for row in rows if row[1] < 2 * np.pi / DT]
    if not kept:
        raise InputError("disturbance must have a tone below 1000 Hz, got none")
    remarks = (f"{len(rows) - len(kept)} tones above 1000 Hz excluded",) if len(kept) < len(rows) else ()
    return make(kept, DT, *more), remarks


def _waterfall(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.signals import SumSignal, noise_of_density, tone_signal
    from titop_plant.disturbances.waterfall import grid_of, identify

    table, speed, rng = entry.file(), _speed(entry, run), _rng(entry, run)
    name = next((name for name in table.columns if split_unit(name)[0].lower() == "speed"), "speed")
    scale = {"rpm": 1 / 60, "rad/s": 1 / (2 * np.pi), "Hz": 1.0, "hz": 1.0}.get(table.unit(name))
    if scale is None:
        raise entry.error(f"unit of {name} must be rpm, rad/s or Hz (speed [rpm]), got {table.unit(name)!r}")
    at, frequency = scale * _column(entry, table, "speed"), _column(entry, table, *FREQUENCIES, units=FREQUENCY)
    turning, sense = abs(speed) / (2 * np.pi), float(np.sign(speed)) or 1.0
    bandwidth = entry.number("bandwidth", 1.0, 0.0)
    try:
        model = identify(*grid_of(at, frequency, _axes(entry, table, at.size)), bandwidth)
        found, amplitude = model.lines_at(turning)
        density = model.density_at(turning)
    except ValueError as error:
        raise entry.error(f"{table.path}: {error}") from None
    if not found.size and not density.any():
        raise entry.error(f"{table.path}: waterfall must have harmonics or noise, got zeros")
    rows = [(2 * np.pi * f / abs(speed), 2 * np.pi * f, _phased(a, sense, rng)) for f, a in zip(found, amplitude)]
    noise = noise_of_density(model.frequency, density, run.duration, DT, rng)
    tones, remarks = _audible(tone_signal, rows) if rows else (None, ())
    return SumSignal(tuple(part for part in (tones, noise) if part)), (*model.remarks, *remarks)


def _psd(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.signals import NOISE_SECONDS, PASSES, noise_of_density

    table = entry.file()
    frequency = _column(entry, table, *FREQUENCIES, units=FREQUENCY)
    density = _axes(entry, table, frequency.size, units=DENSITY)
    if frequency.size < 2 or not (np.diff(frequency) > 0).all() or frequency[0] < 0 or (density < 0).any():
        raise entry.error(
            f"{table.path} must have two or more ascending frequencies and no negative density, got {frequency.size} "
            f"frequencies, {int((np.diff(frequency) <= 0).sum())} not above the last, and {int((density < 0).sum())} "
            "negative densities"
        )
    remarks = []
    if frequency[-1] > PASSES:
        remarks.append(f"density above {PASSES:g} Hz excluded")
    if run.duration > NOISE_SECONDS:
        remarks.append(f"noise repeats after {NOISE_SECONDS:g} s")
    signal = noise_of_density(frequency, density, run.duration, DT, _rng(entry, run))
    return signal, tuple(remarks)


def _cooler(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.moving_mass import WIDEST, PhaseNoise, moving_mass
    from titop_plant.disturbances.signals import tone_signal

    rng, frequency = _rng(entry, run), entry.number("frequency", None, 0.0)
    base = 2 * np.pi * frequency
    rows: list[tuple[float, float, ComplexArray]] = []
    for order, amplitude in _harmonics(entry):
        rows.append((order, order * base, amplitude * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))))
    width = entry.number("linewidth", 0.0)
    if not 0 <= width <= WIDEST * frequency:
        raise entry.error(f"linewidth must be between 0 and {WIDEST * frequency:g} Hz, got {width:g} Hz")
    if not width:
        return _audible(tone_signal, rows)
    return _audible(moving_mass, rows, base, PhaseNoise.of(width, frequency, run.duration, rng))


def _pulses(entry: DisturbanceTable, run: RunConditions) -> Made:
    from titop_plant.disturbances.signals import PulseSignal

    wrench = entry.wrench()
    width, period = entry.number("width", None, 0.0), entry.number("period", None, 0.0)
    if width > period:
        raise entry.error(f"width must not be above the period of {period:g} s, got {width:g} s")
    first, last = entry.number("first", 0.0), entry.number("last", math.inf)
    if last < first:
        raise entry.error(f"last must not be before first, {first:g} s, got {last:g} s")
    return PulseSignal(wrench, first, width, period, last, DT), ()


KINDS: Mapping[str, tuple[Callable[[DisturbanceTable, RunConditions], Made], set[str]]] = MappingProxyType(
    {
        "series": (_series, {"file", "rate", "repeat", "keep_mean"}),
        "harmonics": (_wheel, {"file", "harmonics", "squared", "speed"}),
        "waterfall": (_waterfall, {"file", "speed", "bandwidth"}),
        "psd": (_psd, {"file"}),
        "cooler": (_cooler, {"frequency", "harmonics", "linewidth", "file"}),
        "pulses": (_pulses, {"force", "torque", "period", "width", "first", "last"}),
    }
)
"""Maker of each kind of source, and its keys."""
