"""Worst case of the implemented loop: joint ascent over the logarithm of the frequency and all uncertain parameters.

A search of one metric has three steps, in each of the frequency bands :data:`BANDS`, so that no peak hides another:

1. **Screening.** At every frequency of a grid the metric is computed at random corners and random points of the box;
   at some of them also next to the telescope's slow modes there.
2. **Ascent.** From the best screened pairs the logarithm of the gain is maximised over log frequency and parameters
   (L-BFGS-B in the unit cube), with the gradient of the singular value (:mod:`los_design.implemented_loop`).
3. **Confirmation.** The best point of each band is computed again on the sampled plant by the periodic solution
   (:func:`los_design.sampled_loop_norms.weighted_gains`), which shares nothing but the telescope's matrices.

Every search gives a lower bound of the true worst case.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from los_design.implemented_loop import HIGHEST, ImplementedLoop, LoopMetric, loop_metrics
from los_design.sampled_loop import sampled_loop
from los_design.sampled_loop_norms import weighted_gains
from lti import SampledSystem, UncertainSystem
from lti.batched_linalg import largest_gains
from lti.ordinary_file import read_ordinary_file
from titop_plant.disturbances import CHANNELS
from titop_plant.interface import FRAME_TICKS
from titop_plant.telescope.budget import BAND_EDGE
from titop_plant.telescope.parameters import Parameters

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BANDS = (1e-2, 0.2, 1.0, 4.0, 12.0, 35.0, BAND_EDGE, 130.0, 200.0, 300.0, 380.0, 450.0, 560.0, 640.0, 740.0, 1000.0,
         1600.0, HIGHEST)  # fmt: skip
"""Edges of the frequency bands of a search [rad/s]."""

WHEEL_CHANNELS = ("force x", "force y", "force z", "torque x", "torque y")

MODES, MODE_OFFSETS = (0.1, BAND_EDGE), (-4e-3, -1.5e-3, -4e-4, 4e-4, 1.5e-3, 4e-3)
"""Band [rad/s] of the telescope's modes that a search starts at, whatever its grid, and the relative distances of the
starts: the arrays' modes have a damping ratio of 0.1 %."""

STEP = 1e-6
"""Step of log frequency for the slope."""

LEADING, VARIED, CLIMBS, PATIENCE = 0.75, (7, 40), 3, 3
"""Bands whose best value is above this part of the largest one are searched again around their best point: number of
frequencies and of varied points at each, ascents from the best of them, and rounds without success until it ends."""

SPREAD = 0.01
"""Standard deviation of log frequency in that search."""

FREQUENCY_SCALE = 0.05
"""Change of log frequency that the ascent counts like a whole range of a parameter."""


@dataclass(frozen=True)
class SearchOptions:
    """Effort of a search.

    Parameters
    ----------
    frequencies : int
        Of the screening, logarithmically spaced between 0.01 rad/s and :data:`HIGHEST`, with a random shift.
    points : int
        Parameter points for each of them: half of them corners.
    ascents : int
        For each metric, over all its bands.
    iterations : int
        Most steps of an ascent.
    seed : int
    """

    frequencies: int = 500
    points: int = 60
    ascents: int = 300
    iterations: int = 30
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("frequencies", "points", "ascents", "iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True)
class WorstPoint:
    """Largest value found for one metric of one stage, in one band.

    Parameters
    ----------
    stage, requirement : str
    gamma : float
        Value over the limit, by the periodic solution; of a sensitivity by the frequency response.
    limit : float
        rad, N, or 1.
    omega : float
        rad/s.
    parameters : mapping of str to float
    disturbance : ndarray, complex
        Unit vector of the inputs: normalised disturbances (22), or signals added to the commands.
    direction : ndarray, complex
        Unit vector of the outputs that they cause: **response = gamma limit direction**.
    """

    stage: str
    requirement: str
    gamma: float
    limit: float
    omega: float
    parameters: Mapping[str, float]
    disturbance: ComplexArray
    direction: ComplexArray

    @property
    def channel(self) -> str:
        """Name of the input with the largest part of the disturbance."""
        k = int(np.abs(self.disturbance).argmax())
        if len(self.disturbance) != CHANNELS:
            return f"command {k + 1}"
        return f"solar array drive {k - 19}" if k >= 20 else f"wheel {k // 5 + 1}, {WHEEL_CHANNELS[k % 5]}"

    def to_mapping(self) -> dict[str, Any]:
        """For JSON."""
        vectors = {"disturbance": self.disturbance, "direction": self.direction}
        return {
            "gamma": self.gamma,
            "limit": self.limit,
            "omega": self.omega,
            "parameters": dict(self.parameters),
            **{name: {"real": v.real.tolist(), "imag": v.imag.tolist()} for name, v in vectors.items()},
        }

    @classmethod
    def from_mapping(cls, stage: str, requirement: str, values: Mapping[str, Any]) -> WorstPoint:
        """As :meth:`to_mapping` makes it."""
        disturbance, direction = (
            np.array(values[name]["real"]) + 1j * np.array(values[name]["imag"])
            for name in ("disturbance", "direction")
        )
        gamma, limit, omega = (float(values[name]) for name in ("gamma", "limit", "omega"))
        return cls(stage, requirement, gamma, limit, omega, dict(values["parameters"]), disturbance, direction)


class Search:
    """Worst points of one stage.

    Parameters
    ----------
    system : UncertainSystem
        As :func:`titop_plant.simulation.control_loop_plant` makes it.
    parameters : mapping
        Telescope parameters.
    k_fsm, k_pma : SampledSystem
    stage : {"none", "isolator", "fsm", "fsm+pma"}
    options : SearchOptions, optional
    """

    def __init__(
        self,
        system: UncertainSystem,
        parameters: Parameters,
        k_fsm: SampledSystem,
        k_pma: SampledSystem,
        stage: str,
        options: SearchOptions | None = None,
    ) -> None:
        self.loop = ImplementedLoop(system, parameters, k_fsm, k_pma, stage)
        self.pair = (k_fsm, k_pma)
        self.options = options or SearchOptions()
        self.metrics = loop_metrics(parameters, stage)

    def run(self, names: Sequence[str] | None = None, starts: Iterable[WorstPoint] = ()) -> dict[str, list[WorstPoint]]:
        """Worst point of every band for each metric, worst first.

        Parameters
        ----------
        names : sequence of str, optional
            Figures; default: all of the stage.
        starts : iterable of WorstPoint
            Points of former searches that are climbed from, too.
        """
        metrics = [self.metrics[name] for name in (names or self.metrics)]
        screened = self._screen(metrics)
        given = list(starts)
        found = {}
        for metric, table in zip(metrics, screened):
            tried = [(p.omega, self.loop.point(dict(p.parameters))) for p in given if p.requirement == metric.name]
            found[metric.name] = self._metric(metric, [*tried, *_best(table, self.options.ascents)])
        return found

    def _screen(self, metrics: Sequence[LoopMetric]) -> list[list[tuple[float, float, FloatArray]]]:
        """For each metric a list of (value, frequency, point): the best points at each frequency."""
        options = self.options
        rng = np.random.default_rng(options.seed)
        grid = np.geomspace(BANDS[0], HIGHEST, options.frequencies + 1)
        grid = grid[:-1] * (grid[1] / grid[0]) ** rng.uniform(size=options.frequencies)
        tables: list[list[tuple[float, float, FloatArray]]] = [[] for _ in metrics]
        for omega in grid:
            closed = self.loop.at(float(omega))
            points = rng.uniform(size=(options.points, len(self.loop.names)))
            points[: options.points // 2] = np.round(points[: options.points // 2])
            whole = LoopMetric("all", slice(0, 10), slice(0, 30), 1.0)
            responses = self.loop.responses(closed, whole, self.loop.delta(points))
            for metric, table in zip(metrics, tables):
                if metric.band[0] <= omega < metric.band[1]:
                    part = responses[:, metric.rows, metric.columns]
                    values = largest_gains(part) * self.loop.scale(metric, float(omega))
                    for k in np.argsort(-values)[:3]:
                        table.append((float(values[k]), float(omega), points[k]))
        for omega, point in self._at_modes(rng):
            closed = self.loop.at(omega)
            for metric, table in zip(metrics, tables):
                if metric.band[0] <= omega < metric.band[1]:
                    table.append((float(self.loop.gains(closed, metric, point[None])[0]), omega, point))
        return tables

    def _at_modes(self, rng: np.random.Generator) -> Iterable[tuple[float, FloatArray]]:
        """Pairs close to the telescope's slow modes, which are narrower than the steps of the grid."""
        count = max(2, self.options.points // 3)
        points = rng.uniform(size=(count, len(self.loop.names)))
        points[: count // 2] = np.round(points[: count // 2])
        points[0] = self.loop.point({})
        for point in points:
            for mode in self.loop.open.modes(point, MODES[0], MODES[1]):
                for offset in MODE_OFFSETS:
                    yield float(mode * (1.0 + offset)), point

    def _metric(self, metric: LoopMetric, starts: Sequence[tuple[float, FloatArray]]) -> list[WorstPoint]:
        best: dict[int, tuple[float, float, FloatArray]] = {}
        for omega, point in starts:
            value, at, where = self.climb(metric, omega, point)
            band = int(np.searchsorted(BANDS, at))
            if value > best.get(band, (0.0,))[0]:
                best[band] = (value, at, where)
        rng = np.random.default_rng(self.options.seed)
        largest = max((entry[0] for entry in best.values()), default=0.0)
        for band, entry in best.items():
            if entry[0] >= LEADING * largest:
                best[band] = self._around(metric, entry, rng)
        ordered = sorted(best.values(), key=lambda entry: -entry[0])
        return sorted((self.confirmed(metric, *entry[1:]) for entry in ordered), key=lambda p: -p.gamma)

    def _around(
        self, metric: LoopMetric, best: tuple[float, float, FloatArray], rng: np.random.Generator
    ) -> tuple[float, float, FloatArray]:
        """Ascents from variations of the best point of a band: one to three of its parameters, and the frequency.

        Most worst points have several parameters at their bounds; an ascent cannot change one from bound to bound.
        """
        failed, count = 0, len(self.loop.names)
        while failed < PATIENCE:
            tried = []
            for omega in best[1] * np.exp(SPREAD * rng.standard_normal(VARIED[0])):
                points = np.tile(best[2], (VARIED[1], 1))
                for point in points:
                    which = rng.choice(count, size=rng.integers(1, 4), replace=False)
                    value = rng.uniform(size=len(which))
                    point[which] = np.where(rng.uniform(size=len(which)) < 0.5, np.round(value), value)
                low, high = self._band(metric, best[1])
                omega = float(np.clip(omega, low, high))
                values = self.loop.gains(self.loop.at(omega), metric, points)
                k = int(values.argmax())
                tried.append((float(values[k]), omega, points[k]))
            before = best[0]
            for _, omega, point in sorted(tried, key=lambda entry: -entry[0])[:CLIMBS]:
                best = max(best, self.climb(metric, omega, point), key=lambda entry: entry[0])
            failed = 0 if best[0] > before * (1.0 + 1e-3) else failed + 1
        return best

    def _band(self, metric: LoopMetric, omega: float) -> tuple[float, float]:
        """Edges of the band of a frequency, within those of the metric."""
        n = int(np.searchsorted(BANDS, omega))
        return max(metric.band[0], BANDS[max(n - 1, 0)]), min(metric.band[1], BANDS[min(n, len(BANDS) - 1)])

    def climb(self, metric: LoopMetric, omega: float, point: FloatArray) -> tuple[float, float, FloatArray]:
        """Local ascent: value, frequency and point reached. It stays in the band of its start."""
        band, best = np.array(self._band(metric, omega)), (-np.inf, omega, point)

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            nonlocal best
            at, where = float(np.exp(x[0] * FREQUENCY_SCALE)), x[1:]
            here, ahead = self.loop.with_neighbour(at, STEP)
            value, slope = self.loop.gain(here, metric, where)
            if value > best[0]:
                best = (value, at, where.copy())
            by_frequency = (
                np.log(float(self.loop.gains(ahead, metric, where[None])[0]) / value) / STEP * FREQUENCY_SCALE
            )
            return -np.log(value), -np.concatenate([[by_frequency], slope / value])

        scipy.optimize.minimize(
            objective,
            np.concatenate([[np.log(omega) / FREQUENCY_SCALE], np.clip(point, 0.0, 1.0)]),
            jac=True,
            method="L-BFGS-B",
            bounds=[tuple(np.log(band) / FREQUENCY_SCALE), *([(0.0, 1.0)] * len(point))],
            options={"maxiter": self.options.iterations, "maxfun": 2 * self.options.iterations, "ftol": 1e-7},
        )
        return best

    def confirmed(self, metric: LoopMetric, omega: float, point: FloatArray) -> WorstPoint:
        """The point with its value by the periodic solution."""
        loop, values = self.loop, self.loop.values(point)
        gamma, left, right = loop.singular_vectors(loop.at(omega), metric, point)
        if metric.disturbed:
            plant = loop.system.data_at(values)
            sensitivity = float(loop.parameters["fsm"]["los_sensitivity"])
            stage = "isolator" if loop.stage == "none" else loop.stage
            closed = sampled_loop(plant, *self.pair, loop=stage, frame_ticks=FRAME_TICKS, los_sensitivity=sensitivity)
            response, relative = weighted_gains(closed, plant, loop.parameters, np.array([omega]))
            gain = float(relative[0]) if metric.relative else float(largest_gains(response[:, metric.rows])[0])
            gamma = gain / metric.limit
        return WorstPoint(loop.stage, metric.name, gamma, metric.limit, omega, values, right, left)


def _best(table: Sequence[tuple[float, float, FloatArray]], count: int) -> list[tuple[float, FloatArray]]:
    """The best screened pairs: equal numbers of each band, further ones from the best of all."""
    order = sorted(table, key=lambda entry: -entry[0])
    bands: dict[int, list[tuple[float, FloatArray]]] = {}
    for _, omega, point in order:
        bands.setdefault(int(np.searchsorted(BANDS, omega)), []).append((omega, point))
    each = max(1, count // (2 * max(len(bands), 1)))
    chosen = [entry for band in bands.values() for entry in band[:each]]
    known = {omega for omega, _ in chosen}
    rest = [(omega, point) for _, omega, point in order if omega not in known]
    return [*chosen, *rest[: max(0, count - len(chosen))]]


def worst_of(found: Mapping[str, Sequence[WorstPoint]]) -> dict[str, WorstPoint]:
    """The worst point of each metric; ``RPE`` is the worse of slow and fast tones."""
    worst = {name: points[0] for name, points in found.items() if points}
    tones = [worst[name] for name in ("slow", "fast") if name in worst]
    if tones:
        worst["RPE"] = max(tones, key=lambda p: p.gamma)
    return worst


def store_worst_points(path: Path, found: Iterable[WorstPoint], basis: Mapping[str, str]) -> None:
    """Write points as JSON by stage and metric; `basis` says for which parameters and controllers they hold."""
    stages: dict[str, dict[str, Any]] = {}
    for point in found:
        stages.setdefault(point.stage, {})[point.requirement] = point.to_mapping()
    path.write_text(json.dumps({**basis, "stages": stages}, indent=1) + "\n", encoding="utf-8")


def load_worst_points(folder: Path | None = None) -> dict[str, dict[str, WorstPoint]]:
    """Worst points by stage and metric: of a folder of designs, or of the stored designs.

    Raises
    ------
    ValueError
        The file is missing.
    """
    path = (folder or Path(__file__).parent) / "worst_points.json"
    if not path.exists():
        raise ValueError(f"{path} must exist: it is made by `los-testbed design all`")
    content = json.loads(read_ordinary_file(path))["stages"]
    return {
        stage: {name: WorstPoint.from_mapping(stage, name, values) for name, values in table.items()}
        for stage, table in content.items()
    }
