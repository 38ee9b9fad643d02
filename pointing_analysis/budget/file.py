"""Pointing budget in a TOML file: tree of error sources, their transfers, requirements.

The format is described in ``docs/pointing_analysis.md``. A table under ``sources`` with a ``type`` is a source, one
without is a group; a group or source may have a ``transfer``.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.budget import sources as kinds
from pointing_analysis.budget.source_table import read_sources
from pointing_analysis.budget.sources import ENSEMBLE, TIME, ErrorSource
from pointing_analysis.budget.table_files import ENDINGS
from pointing_analysis.files.settings import refuse_unknown
from pointing_analysis.files.structured_text import is_number, load_toml, read_text
from pointing_analysis.indices.errors import performance_error
from pointing_analysis.read.los_source import open_los
from pointing_analysis.requirements.requirement import Requirement, parse
from pointing_analysis.units import ANGLES

Entry = Mapping[str, Any]
Testbed = Callable[[tuple[str, ...], Entry, float], list[ErrorSource]]
"""Sources of the testbed's own closed loop: (path, table, unit [rad]) -> sources in that unit."""
OfTestbed = Callable[[Entry], Sequence[Requirement]]
"""Requirements of the telescope of such a table."""
INDICES = ("APE", "RPE")
MOST_DRAWS = 10_000_000
BEYOND = 4
"""Draws that must be beyond a required share, so that its quantile and the bounds of it are draws."""
TOP = {"title", "unit", "axes", "summation", "draws", "seed", "total", "requirement", "sources"}


@dataclass(frozen=True)
class TotalRule:
    """A total per axis by the rule of the standard: index, window [s], number of standard deviations."""

    index: str
    window: float | None
    factor: float


@dataclass(frozen=True)
class PointingBudget:
    """A pointing budget.

    Attributes
    ----------
    title : heading
    unit : unit of all values
    axes : names of the axes
    summation : ``distribution`` or ``rss``: by which a margin is computed
    draws, seed : of the distribution of the total
    sources : the leaves of the tree, behind their transfers
    requirements : pointing requirements on the norm of two axes or on one axis
    totals : totals per axis
    """

    title: str
    unit: str
    axes: tuple[str, ...]
    summation: str
    draws: int
    seed: int
    sources: tuple[ErrorSource, ...]
    requirements: tuple[Requirement, ...]
    totals: tuple[TotalRule, ...]


def load_budget(
    path: str | os.PathLike[str], testbed: Testbed | None = None, of_testbed: OfTestbed | None = None
) -> PointingBudget:
    """Read a budget.

    Parameters
    ----------
    path : TOML file, or a table of sources (:mod:`pointing_analysis.budget.source_table`) with the ending .csv or .xlsx
    testbed : makes the sources of type ``testbed``; without it such a source is an error
    of_testbed : requirements of the telescope of such a source, for a file that has neither requirements nor totals;
        those on indices that a budget has are taken, on the error at every instant where they are on its rms in windows

    Raises
    ------
    InputError
        A file that cannot be read, or an entry that cannot be used.
    """
    file = Path(path)
    content = read_content(file)
    try:
        return _budget(content, file, testbed, of_testbed)
    except (ValueError, TypeError) as error:
        raise InputError.of_file(file, error) from None


def read_content(file: Path) -> dict[str, Any]:
    """Tables of a budget's file, not yet checked.

    Raises
    ------
    InputError
        A file that cannot be read.
    """
    return read_sources(file) if file.suffix.lower() in ENDINGS else dict(load_toml(read_text(file), file))


def _budget(content: Entry, file: Path, testbed: Testbed | None, of_testbed: OfTestbed | None) -> PointingBudget:
    refuse_unknown(content, sorted(TOP))
    unit, axes = content.get("unit"), tuple(content.get("axes", ("x", "y")))
    if unit not in ANGLES:
        raise InputError(f"{file}: unit must be one of {', '.join(ANGLES)}, got {unit!r}")
    summation = content.get("summation", "distribution")
    if summation not in ("distribution", "rss"):
        raise InputError(f"{file}: summation must be distribution or rss, got {summation!r}")
    requirements = tuple(_requirement(file, entry, len(axes)) for entry in content.get("requirement", ()))
    unseen = min((1.0 - r.probability for r in requirements), default=0.0)
    reader = _Reader(file, ANGLES[unit], len(axes), testbed, unseen)
    sources = tuple(reader.tree(content.get("sources", {}), ()))
    if not sources:
        raise InputError(f"{file}: sources must hold at least one source, got none")
    totals = tuple(_total(file, entry) for entry in content.get("total", ()))
    table = testbed_table(content.get("sources", {}))
    if not requirements and not totals and of_testbed is not None and table is not None:
        requirements = tuple(replace(r, of_windows=False) for r in of_testbed(table) if r.index in INDICES)
    if not requirements and not totals:
        raise InputError(f"{file}: must hold a list requirement or total, got neither")
    draws, seed = int(content.get("draws", 50_000)), int(content.get("seed", 1))
    if not 1000 <= draws <= MOST_DRAWS:
        raise InputError(f"{file}: draws must be 1000 to {MOST_DRAWS}, got {draws}")
    if summation == "distribution":
        # Refuse a share that so many draws cannot show: `BEYOND` of them must be beyond it
        for requirement in requirements:
            needed = BEYOND / (1.0 - requirement.probability) * (1.0 - 1e-9)
            if needed > MOST_DRAWS:
                most = f"at most {1.0 - BEYOND / MOST_DRAWS:.8g} of a distribution"
                raise InputError(
                    f'{file}: share must be {most} (summation = "rss" has no such limit), got {requirement.exact_text}'
                )
            if draws < needed:
                raise InputError(
                    f"{file}: draws must be {math.ceil(needed)} or more for {requirement.exact_text}, got {draws}"
                )
    title = str(content.get("title", file.stem))
    return PointingBudget(title, unit, axes, summation, draws, seed, sources, requirements, totals)


def testbed_table(table: Entry) -> Entry | None:
    """First source of type ``testbed`` in a tree of tables."""
    if table.get("type") == "testbed":
        return table
    inner = (testbed_table(entry) for entry in table.values() if isinstance(entry, dict))
    return next((entry for entry in inner if entry is not None), None)


def _requirement(file: Path, entry: Any, axes: int) -> Requirement:
    if not isinstance(entry, dict) or "text" not in entry or set(entry) - {"text", "name"}:
        raise InputError(f"{file}: requirement must have the keys text and name, got {entry!r}")
    try:
        requirement = parse(str(entry["text"]), str(entry.get("name", "")))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    if requirement.index not in INDICES:
        raise InputError(f"{file}: index must be one of {', '.join(INDICES)} in a budget, got {requirement.index}")
    if requirement.of_windows:
        instants = replace(requirement, of_windows=False).quantity
        raise InputError(
            f"{file}: requirement must be on {instants} in a budget, which is for every instant, without rms of "
            f"windows, got {requirement.quantity!r}"
        )
    if axes != 2:
        raise InputError(f"{file}: axes must be two with requirements, got {axes}")
    return requirement


def _total(file: Path, entry: Any) -> TotalRule:
    if not isinstance(entry, dict) or entry.get("index") not in INDICES or set(entry) - {"index", "window", "factor"}:
        raise InputError(
            f"{file}: total must have an index, {' or '.join(INDICES)}, a window and a factor, got {entry!r}"
        )
    window = _positive(file, "window", entry.get("window")) if entry["index"] == "RPE" else None
    return TotalRule(entry["index"], window, float(entry.get("factor", 2.0)))


def _positive(file: Path, name: str, value: Any) -> float:
    if not is_number(value) or not 0 < value < math.inf:
        raise InputError(f"{file}: {name} must be a positive number, got {value!r}")
    return float(value)


class _Reader:
    """Reads the tree of sources of one file; of a recorded one the sensor may miss the share `unseen`."""

    def __init__(self, file: Path, scale: float, axes: int, testbed: Testbed | None, unseen: float) -> None:
        self.file, self.scale, self.axes, self.testbed, self.unseen = file, scale, axes, testbed, unseen
        self.kinds: dict[str, tuple[set[str], Callable[[tuple[str, ...], Entry, list[Any]], list[ErrorSource]]]] = {
            "constant": ({"value", "half_range", "sigma", "random"}, self._constant),
            "random": ({"sigma", "correlation_time"}, self._random),
            "periodic": ({"amplitude", "frequency", "phase"}, self._periodic),
            "tones": ({"tones"}, self._tones),
            "drift": ({"rate", "duration"}, self._drift),
            "spectrum": ({"frequency", "psd"}, self._spectrum),
            "measured": ({"bag", "los", "unit", "rate", "transient"}, self._measured),
            "testbed": ({"part", "loop", "scenario", "seed", "settings"}, self._testbed),
        }

    def tree(self, table: Entry, path: tuple[str, ...], above: tuple[Any, ...] = ()) -> Iterator[ErrorSource]:
        """All sources of a table and of the tables in it."""
        if not isinstance(table, dict):
            raise InputError(f"{self.file}: {' / '.join(path)} must be a table, got {table!r}")
        gains = [*above, table["transfer"]] if "transfer" in table else list(above)
        if "type" not in table:
            for name, entry in table.items():
                if name != "transfer":
                    yield from self.tree(entry, (*path, name), tuple(gains))
            return
        kind = table["type"]
        if kind not in self.kinds:
            raise self.wrong(path, f"type must be one of {', '.join(self.kinds)}", kind)
        known, make = self.kinds[kind]
        refuse_unknown(table, sorted(known | {"type", "transfer"}), ".".join(("sources", *path)))
        yield from make(path, table, gains)

    def wrong(self, path: tuple[str, ...], what: str, got: object) -> InputError:
        return InputError(f"{self.file}: {' / '.join(path)}: {what}, got {got!r}")

    def vector(self, path: tuple[str, ...], name: str, value: Any) -> FloatArray:
        """A value for each axis; a single number applies to all."""
        array = np.asarray(value, dtype=float)
        each: FloatArray = np.broadcast_to(array, (self.axes,)).copy() if array.ndim == 0 else array
        if each.shape != (self.axes,) or not np.isfinite(each).all():
            raise self.wrong(path, f"{name} must be {self.axes} finite numbers", value)
        return each

    def gain(self, path: tuple[str, ...], transfers: list[Any], hertz: FloatArray) -> FloatArray:
        """Magnitude of all transfers at some frequencies [Hz]."""
        return np.abs(self.response(path, transfers, hertz))

    def response(self, path: tuple[str, ...], transfers: list[Any], hertz: FloatArray) -> ComplexArray:
        """All transfers at some frequencies [Hz]; of a file, which has gains only, with the phase zero."""
        total: ComplexArray = np.ones(hertz.size, dtype=complex)
        for entry in transfers:
            if is_number(entry):
                total = total * float(entry)
            elif isinstance(entry, dict) and set(entry) == {"numerator", "denominator"}:
                from scipy import signal  # slow to import, and few budgets have such a transfer

                poles = np.roots(entry["denominator"])
                if np.any(poles.real > 0.0):
                    unstable = float(poles.real.max())
                    raise self.wrong(path, "transfer must be stable", f"a pole of real part {unstable:.4g} rad/s")
                with np.errstate(divide="ignore", invalid="ignore"):
                    _, rational = signal.freqs(entry["numerator"], entry["denominator"], 2 * np.pi * hertz)
                if not np.isfinite(rational).all():
                    raise self.wrong(path, "transfer must be finite at the frequencies of the source", entry)
                total = total * rational
            elif isinstance(entry, dict) and set(entry) == {"file"}:
                lines = read_text(self.file.parent / str(entry["file"])).splitlines()
                table = np.loadtxt(lines, delimiter=",", ndmin=2)
                if table.shape[1] != 2 or np.any(np.diff(table[:, 0]) <= 0) or np.any(table <= 0):
                    raise self.wrong(path, "transfer file must have increasing frequencies [Hz] and gains", table.shape)
                total = total * np.exp(np.interp(np.log(np.maximum(hertz, 1e-300)), *np.log(table).T))
            else:
                raise self.wrong(path, "transfer must be a number, numerator and denominator, or a file", entry)
        return np.asarray(total)

    def steady(self, path: tuple[str, ...], transfers: list[Any]) -> float:
        """Gain at frequency zero, with its sign: known errors may cancel."""
        return float(self.response(path, transfers, np.zeros(1)).real[0])

    def fixed(self, path: tuple[str, ...], transfers: list[Any]) -> float:
        """Gain of transfers that must not depend on the frequency."""
        if not all(isinstance(t, (int, float)) for t in transfers):
            raise self.wrong(path, "transfer must be a number for this type (give a spectrum)", transfers[-1])
        return self.steady(path, transfers)

    def _constant(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        names = ("value", "half_range", "sigma")
        value, half, sigma = (self.vector(path, name, table.get(name, 0.0)) for name in names)
        random = table.get("random", ENSEMBLE)
        if random not in (TIME, ENSEMBLE):
            raise self.wrong(path, f"random must be {TIME} or {ENSEMBLE}", random)
        if not any(name in table for name in names) or np.any(half < 0) or np.any(sigma < 0):
            raise self.wrong(
                path, "a constant must have a value, or a half_range or sigma of zero or more", dict(table)
            )
        return [kinds.constant(path, value, half, sigma, random).scaled(self.steady(path, transfers))]

    def _random(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        sigma = self.vector(path, "sigma", table.get("sigma"))
        if np.any(sigma < 0):
            raise self.wrong(path, "sigma must be zero or more", table["sigma"])
        gain, time = self.fixed(path, transfers), table.get("correlation_time", 0.0)
        if time == 0:
            return [kinds.white(path, sigma).scaled(gain)]
        tau = _positive(self.file, f"{' / '.join(path)}: correlation_time", time)
        return [kinds.correlated(path, sigma, tau).scaled(gain)]

    def _periodic(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        return self._tones(
            path, {"tones": [{k: v for k, v in table.items() if k not in ("type", "transfer")}]}, transfers
        )

    def _tones(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        hertz, phasors = [], []
        for entry in table.get("tones", ()):
            hertz.append(_positive(self.file, f"{' / '.join(path)}: frequency", entry.get("frequency")))
            amplitude = self.vector(path, "amplitude", entry.get("amplitude"))
            phase = self.vector(path, "phase", entry.get("phase", 0.0))
            phasors.append(amplitude * np.exp(1j * np.radians(phase)))
        if not hertz:
            raise self.wrong(
                path, "tones must be a list of frequency [Hz], amplitude and phase [deg]", table.get("tones")
            )
        f = np.array(hertz)
        return [kinds.tones(path, 2 * np.pi * f, np.array(phasors).T * self.gain(path, transfers, f))]

    def _drift(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        duration = _positive(self.file, f"{' / '.join(path)}: duration", table.get("duration"))
        rate = self.vector(path, "rate", table.get("rate"))
        return [kinds.drift(path, rate, duration).scaled(self.steady(path, transfers))]

    def _spectrum(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        f = np.asarray(table.get("frequency", ()), dtype=float)
        density = np.asarray(table.get("psd", ()), dtype=float)
        density = np.repeat(density[:, None], self.axes, axis=1) if density.ndim == 1 else density
        if (
            f.size < 2
            or np.any(np.diff(f) <= 0)
            or f[0] <= 0
            or density.shape != (f.size, self.axes)
            or np.any(density <= 0)
        ):
            raise self.wrong(
                path, "spectrum must have two or more increasing frequencies [Hz] and positive densities", table
            )
        edges = np.union1d(np.geomspace(f[0], f[-1], 4001)[1:-1], f)
        middle, steps = np.sqrt(edges[1:] * edges[:-1]), np.diff(np.log(edges))
        # f times the density is a power of f in each step; its integral over log f is exact, also on a steep flank.
        level = np.stack([np.interp(np.log(edges), np.log(f), np.log(f * d)) for d in density.T], axis=1)
        half = np.diff(level, axis=0) / 2
        slope = np.where(np.abs(half) < 1e-4, 1 + half**2 / 6, np.sinh(half) / np.where(half == 0, 1, half))
        power = np.exp((level[1:] + level[:-1]) / 2) * slope * steps[:, None]
        return [kinds.spectrum(path, middle, power * self.gain(path, transfers, middle)[:, None] ** 2)]

    def _measured(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        if "bag" not in table:
            raise self.wrong(path, "bag must name a bag or a table", None)
        bag = self.file.parent / str(table["bag"])
        run = open_los(bag, los=table.get("los"), unit=table.get("unit"), rate=table.get("rate"))
        if run.contradictions:
            raise self.wrong(path, f"bag must agree with its own digests: {run.contradictions[0]}", str(bag))
        series = performance_error(run, table.get("transient"))
        if why := series.unseen.reason(self.unseen, 0.0):
            raise self.wrong(path, f"bag must show the motion: {why}", str(bag))
        return [kinds.measured(path, series.values / self.scale, series.dt).scaled(self.fixed(path, transfers))]

    def _testbed(self, path: tuple[str, ...], table: Entry, transfers: list[Any]) -> list[ErrorSource]:
        if self.testbed is None:
            raise self.wrong(path, "type testbed needs the command los-testbed budget", "testbed")
        gain = self.fixed(path, transfers)
        return [source.scaled(gain) for source in self.testbed(path, table, self.scale)]
