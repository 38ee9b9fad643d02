"""Kinds of sources of disturbance: the keys of the table of each, and from the table to its signal."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic.dataclasses import dataclass as pydantic_dataclass

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from pointing_analysis.files.settings import POSITIVE, STRICT, CheckedTable, Refused, setting, settings_class
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
T = TypeVar("T", bound=CheckedTable)

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

    def made(self, kind: type[T]) -> T:
        """The object of the table."""
        try:
            return kind.of_table(self.table)
        except Refused as error:
            raise self.error(str(error)) from None

    def file(self, name: str) -> Table:
        """Table of values."""
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
    count = 0
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
                count += 1
                break
    if not count:
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


def _rate(entry: DisturbanceTable, table: Table, n: int, stated: float | None) -> float:
    """Sampling rate [Hz] of a series: by its times, by the file, or as given; one that is given must be the same."""
    when = time_column(table.of_length(n), [])
    of_file = _rate_by_times(entry, table, when, stated) if when is not None else table.rate(list(table.of_length(n)))
    if of_file is None:
        if stated is None:
            refuse_text_times(table)
            raise entry.error(f"{table.path} must have a column time, or rate must be given, got {table.listed()}")
        return stated
    if stated is not None and abs(stated - of_file) > SAME_RATE * of_file:
        source = f"column {when}" if when is not None else "file"
        raise entry.error(f"rate must be that of {table.path}, {of_file:g} Hz by its {source}, got {stated:g} Hz")
    return of_file


def _rate_by_times(entry: DisturbanceTable, table: Table, when: str, stated: float | None) -> float:
    """Sampling rate [Hz] by a column of times; a rate that is `stated` tells that they are in seconds."""
    unit = table.unit(when)
    try:
        stamps = column_stamps(when, entry.column(table, when), stated, "" if FORCE.knows(unit) else unit)
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


def _phased(amplitude: FloatArray, sense: float, rng: np.random.Generator) -> ComplexArray:
    """Amplitudes with random phases; radial ones turn with the rotor, **x leads y by a quarter turn for sense > 0**."""
    force, axial, torque, about = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, 4))
    turn = -1j * sense
    return np.asarray(amplitude * np.array([force, turn * force, axial, torque, turn * torque, about]))


def _audible(make: Callable[..., Signal], rows: list[tuple[float, float, ComplexArray]], *more: Any) -> Made:
    """Tones below the tick rate; higher ones are excluded and reported."""
    kept = [row for row in rows if row[1] < 2 * np.pi / DT]
    if not kept:
        raise InputError("disturbance must have a tone below 1000 Hz, got none")
    remarks = (f"{len(rows) - len(kept)} tones above 1000 Hz excluded",) if len(kept) < len(rows) else ()
    return make(kept, DT, *more), remarks


Made = tuple["Signal", tuple[str, ...]]


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class SourceTable(CheckedTable):
    """Keys of a source of any kind."""

    name: str = setting(..., "name of the source")
    kind: str = setting(..., "kind of the source")
    place: str = setting("bus", "place where it acts")
    frame: Any = setting("own", "its axes: own, body, or three rows of three numbers")
    offset: tuple[float, ...] | None = setting(
        None, "point where the force acts, from the place", "m", -LARGEST, LARGEST, length=3
    )
    scale: float = setting(1.0, "factor of its forces and torques")

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:
        """Signal of the source, and what was done to its values.

        Raises
        ------
        ValueError
            A file that cannot be used, a value that does not fit.
        """
        raise NotImplementedError

    def speed_in(self, entry: DisturbanceTable, run: RunConditions, speed: float | None) -> float:
        """Speed of a rotor [rad/s]: given, or that of the wheel where it is."""
        of_wheel = run.speed_at(self.place) if speed is None else speed
        if of_wheel is None:
            raise entry.error(f"speed must be given [rad/s] at {self.place}, which is no wheel, got none")
        return of_wheel


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Wrench(CheckedTable):
    """Force and torque; one of the two may be missing."""

    force: tuple[float, ...] | None = setting(None, "force", "N", -LARGEST, LARGEST, length=3)
    torque: tuple[float, ...] | None = setting(None, "torque", "Nm", -LARGEST, LARGEST, length=3)

    def __post_init__(self) -> None:
        if self.force is None and self.torque is None:
            others = [name for name, value in self.to_mapping().items() if value is not None]
            raise Refused("", f"must have force or torque, got {', '.join(others)}")

    @property
    def values(self) -> FloatArray:
        """Force and torque (6,)."""
        return np.array([*(self.force or (0.0,) * 3), *(self.torque or (0.0,) * 3)])


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Harmonic(Wrench):
    """A harmonic in the table of a source itself."""

    order: float = setting(..., "frequency over that of the fundamental", "", POSITIVE)


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class HarmonicsTable(SourceTable):
    """Keys of a source with harmonics, which are in the table itself or in a file."""

    file: str | None = setting(None, "file of the harmonics")
    harmonics: tuple[Harmonic, ...] | None = setting(None, "tables with order, force and torque")

    def rows(self, entry: DisturbanceTable, units: WrenchUnits) -> list[tuple[float, FloatArray]]:
        """Order and amplitudes (6,) of each harmonic."""
        if self.file is not None:
            if self.harmonics is not None:
                raise entry.error(f"harmonics must be in a file or in the table, got both: {self.file!r} and a list")
            table = entry.file(self.file)
            order = _column(entry, table, "order", "harmonic", units=ORDER)
            for wrong in order[~((order > 0) & (order < math.inf))]:
                raise entry.error(f"order of a harmonic must be a number above 0, got {wrong}")
            return list(zip(order.tolist(), _axes(entry, table, len(order), units)))
        if not self.harmonics:
            raise entry.error("harmonics must be tables or in a file, got neither")
        return [(harmonic.order, harmonic.values) for harmonic in self.harmonics]


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class MeasuredSeries(SourceTable):
    """A record of forces and torques over time."""

    file: str = setting(..., "file of the record")
    rate: float | None = setting(None, "sampling rate", "Hz", POSITIVE, absent="that of the file")
    repeat: bool = setting(False, "a record that is shorter than the run is repeated")
    keep_mean: bool = setting(False, "the mean of the record stays")

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.signals import SampledSignal, repeated

        table = entry.file(self.file)
        n = max(len(column) for column in table.columns.values())
        values, remarks = _axes(entry, table, n), []
        rate = _rate(entry, table, n, self.rate)
        length = n / rate
        if not self.keep_mean:
            mean = values.mean(axis=0)
            values = values - mean
            if np.abs(mean).max() > 0.01 * values.std():
                remarks.append(
                    f"mean {', '.join(f'{value:.3g}' for value in mean)} removed (keep_mean = true keeps it)"
                )
        if length < run.duration:
            if not self.repeat:
                raise entry.error(
                    f"{table.path} must be as long as the run, {run.duration:g} s, got {length:g} s "
                    "(repeat = true repeats it)"
                )
            values = repeated(values, rate)
            faded = (n - len(values)) / rate
            how = f"its end faded into its beginning over {faded:g} s" if faded else "as it is"
            remarks.append(f"record repeated every {len(values) / rate:g} s, {how}")
        return SampledSignal(values, rate, DT), tuple(remarks)


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Harmonics(HarmonicsTable):
    """Harmonics of the speed of a rotor."""

    squared: bool = setting(True, "amplitudes grow with the square of the speed")
    speed: float | None = setting(None, "speed of the rotor", "rad/s", absent="that of the wheel at the place")

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.signals import tone_signal

        speed, rng = self.speed_in(entry, run, self.speed), _rng(entry, run)
        sense, size = float(np.sign(speed)) or 1.0, speed**2 if self.squared else 1.0
        harmonics = self.rows(entry, PER_SPEED_SQUARED if self.squared else FORCE)
        return _audible(tone_signal, [(h, h * abs(speed), size * _phased(a, sense, rng)) for h, a in harmonics])


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Waterfall(SourceTable):
    """Spectra of a rotor at many speeds."""

    file: str = setting(..., "file of the spectra")
    speed: float | None = setting(None, "speed of the rotor", "rad/s", absent="that of the wheel at the place")
    bandwidth: float = setting(1.0, "width of a line of the spectra", "bins", POSITIVE)

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.signals import SumSignal, noise_of_density, tone_signal
        from titop_plant.disturbances.waterfall import grid_of, identify

        table, speed, rng = entry.file(self.file), self.speed_in(entry, run, self.speed), _rng(entry, run)
        name = next((name for name in table.columns if split_unit(name)[0].lower() == "speed"), "speed")
        scale = {"rpm": 1 / 60, "rad/s": 1 / (2 * np.pi), "Hz": 1.0, "hz": 1.0}.get(table.unit(name))
        if scale is None:
            raise entry.error(f"unit of {name} must be rpm, rad/s or Hz (speed [rpm]), got {table.unit(name)!r}")
        at, frequency = scale * _column(entry, table, "speed"), _column(entry, table, *FREQUENCIES, units=FREQUENCY)
        turning, sense = abs(speed) / (2 * np.pi), float(np.sign(speed)) or 1.0
        try:
            model = identify(*grid_of(at, frequency, _axes(entry, table, at.size)), self.bandwidth)
            omega, amplitude = model.lines_at(turning)
            density = model.density_at(turning)
        except ValueError as error:
            raise entry.error(f"{table.path}: {error}") from None
        if not omega.size and not density.any():
            raise entry.error(f"{table.path}: waterfall must have harmonics or noise, got zeros")
        rows = [(2 * np.pi * f / abs(speed), 2 * np.pi * f, _phased(a, sense, rng)) for f, a in zip(omega, amplitude)]
        noise = noise_of_density(model.frequency, density, run.duration, DT, rng)
        tones, remarks = _audible(tone_signal, rows) if rows else (None, ())
        return SumSignal(tuple(part for part in (tones, noise) if part)), (*model.remarks, *remarks)


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class SpectralDensity(SourceTable):
    """Noise of a power spectral density."""

    file: str = setting(..., "file of the density")

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.signals import NOISE_SECONDS, PASSES, noise_of_density

        table = entry.file(self.file)
        frequency = _column(entry, table, *FREQUENCIES, units=FREQUENCY)
        density = _axes(entry, table, frequency.size, units=DENSITY)
        if frequency.size < 2 or not (np.diff(frequency) > 0).all() or frequency[0] < 0 or (density < 0).any():
            raise entry.error(
                f"{table.path} must have two or more ascending frequencies and no negative density, got "
                f"{frequency.size} frequencies, {int((np.diff(frequency) <= 0).sum())} not above the last, and "
                f"{int((density < 0).sum())} negative densities"
            )
        remarks = []
        if frequency[-1] > PASSES:
            remarks.append(f"density above {PASSES:g} Hz excluded")
        if run.duration > NOISE_SECONDS:
            remarks.append(f"noise repeats after {NOISE_SECONDS:g} s")
        signal = noise_of_density(frequency, density, run.duration, DT, _rng(entry, run))
        return signal, tuple(remarks)


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Cooler(HarmonicsTable):
    """Harmonics of a fixed frequency, with the phase noise of a moving mass."""

    frequency: float = setting(..., "fundamental", "Hz", POSITIVE)
    linewidth: float = setting(0.0, "width of the fundamental's line", "Hz", 0.0)

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.moving_mass import WIDEST, PhaseNoise, moving_mass
        from titop_plant.disturbances.signals import tone_signal

        rng, base = _rng(entry, run), 2 * np.pi * self.frequency
        rows: list[tuple[float, float, ComplexArray]] = []
        for order, amplitude in self.rows(entry, FORCE):
            rows.append((order, order * base, amplitude * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))))
        widest = WIDEST * self.frequency
        if self.linewidth > widest:
            raise entry.error(f"linewidth must be between 0 and {widest:g} Hz, got {self.linewidth:g} Hz")
        if not self.linewidth:
            return _audible(tone_signal, rows)
        noise = PhaseNoise.of(self.linewidth, self.frequency, run.duration, rng)
        return _audible(moving_mass, rows, base, noise)


@settings_class
@pydantic_dataclass(frozen=True, kw_only=True, config=STRICT)
class Pulses(SourceTable, Wrench):
    """Pulses of a constant force and torque."""

    period: float = setting(..., "time from one pulse to the next", "s", POSITIVE)
    width: float = setting(..., "duration of a pulse", "s", POSITIVE)
    first: float = setting(0.0, "time of the first pulse", "s")
    last: float | None = setting(None, "time after which none begins", "s", absent="the end of the run")

    def make(self, entry: DisturbanceTable, run: RunConditions) -> Made:  # noqa: D102 (of the base)
        from titop_plant.disturbances.signals import PulseSignal

        last = math.inf if self.last is None else self.last
        if self.width > self.period:
            raise entry.error(f"width must not be above the period of {self.period:g} s, got {self.width:g} s")
        if last < self.first:
            raise entry.error(f"last must not be before first, {self.first:g} s, got {last:g} s")
        late = self.first >= run.duration
        remarks = (f"no pulse: the first is at {self.first:g} s, the run ends at {run.duration:g} s",) if late else ()
        return PulseSignal(self.values, self.first, self.width, self.period, last, DT), remarks


KINDS: Mapping[str, type[SourceTable]] = MappingProxyType(
    {
        "series": MeasuredSeries,
        "harmonics": Harmonics,
        "waterfall": Waterfall,
        "psd": SpectralDensity,
        "cooler": Cooler,
        "pulses": Pulses,
    }
)
"""Class of the table of each kind of source."""
