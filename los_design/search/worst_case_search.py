"""Worst case of the implemented loop: joint ascent over the logarithm of the frequency and all uncertain parameters.

A search of one metric has three steps, in each of the frequency bands :data:`BANDS`, so that no peak hides another:

1. **Screening.** At every frequency of a grid the metric is computed at random corners and random points of the box;
   at some of them also next to the telescope's slow modes there, and, of some members, at the peaks of their gain
   over an axis of frequencies so fine that it has them.
2. **Ascent.** From the best screened pairs the logarithm of the gain is maximised over log frequency and parameters
   (L-BFGS-B in the unit cube), with the gradient of the singular value (:mod:`los_loop.implemented_loop`).
3. **Confirmation.** The best point of each band, or of those near the largest value, is computed again on the sampled
   plant by the periodic solution (:func:`los_loop.sampled_loop_norms.weighted_gains`), which shares nothing but the
   telescope's matrices.

Every search gives a lower bound of the true worst case.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import logarithmic_grid
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.workers import Workers
from los_design.search.worst_points import WorstPoint
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop, LoopMetric

Pair = tuple[float, FloatArray]
"""Frequency [rad/s] and point of the unit cube."""
Found = tuple[float, float, FloatArray]
"""Value of a metric, frequency [rad/s] and point of the unit cube."""
BANDS: tuple[float, ...] = (
    LOWEST,
    0.2,
    1.0,
    4.0,
    12.0,
    35.0,
    130.0,
    200.0,
    300.0,
    380.0,
    450.0,
    560.0,
    640.0,
    740.0,
    1000.0,
    1600.0,
    HIGHEST,
)
"""Edges of the frequency bands of a search [rad/s]; that between slow and fast tones is one, too."""

LOWEST_MODE, MODE_OFFSETS = 0.1, (-4e-3, -1.5e-3, -4e-4, 4e-4, 1.5e-3, 4e-3)
"""Lowest [rad/s] of the telescope's modes, up to the edge of the fast tones, that a search starts at, and the relative
distances of the starts: the arrays' modes have a damping ratio of 0.1 %."""

LAST_PEAK, PEAK_STEP, PEAK_GROUP = 640.0, 2e-3, 40
"""Highest frequency [rad/s] at which the peaks of members are looked for, from the edge of the fast tones on, relative
step of that axis (half of the width of a peak of structural modes with a damping ratio of 0.2 %), and frequencies that
a process looks at together."""

AT_AN_EDGE = 1e-6
"""Relative distance from the edge of a band at which an ascent has reached it, and begins beyond it."""

LEADING, VARIED, CLIMBS = 0.75, (7, 40), 3
"""Bands whose best value is above this part of the largest one are searched again around their best point: number of
frequencies and of varied points at each, and ascents from the best of them."""

TOGETHER = 10
"""Frequencies of a screening, or ascents, that a process does at a time."""

APART = 0.01, 0.25
"""Least differences of log frequency, or of a parameter of the unit cube, of two points of a band."""

AT_AN_END = 0.7
"""Part of the parameters that are at an end of their range in the points whose slow modes are looked at."""

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
    patience : int
        Rounds without success after which the search around a band's best point ends; 0: there is none.
    several : int
        Most points of a band, with other parameters or frequencies than better ones; only the best is searched around.
    confirmed : float
        Points below this part of the largest value of their metric keep the value of the LFT: the periodic solution
        takes a quarter of the time of a search. Measured on two designs, it differs by less than 1e-4 of the largest
        value (by the sidebands of the camera).
    members : int
        Members whose peaks over a fine axis are starts, too; 0: there are none. The first are the corners of the box,
        where that many are asked for; of the others most parameters are at an end of their range.
    """

    frequencies: int = 500
    points: int = 60
    ascents: int = 300
    iterations: int = 30
    seed: int = 0
    patience: int = 3
    several: int = 1
    confirmed: float = 0.0
    members: int = 0

    def __post_init__(self) -> None:
        for name in ("frequencies", "points", "ascents", "iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")


class Search:
    """Worst points of one stage.

    Parameters
    ----------
    loop : ImplementedLoop
    options : SearchOptions, optional
    """

    def __init__(self, loop: ImplementedLoop, options: SearchOptions | None = None) -> None:
        self.loop = loop
        self.options = options or SearchOptions()
        self.metrics = loop.metrics()
        self.edge = loop.telescope.weights.band_edge
        self.bands = tuple(sorted({*BANDS, self.edge}))

    def run(
        self,
        names: Sequence[str] | None = None,
        starts: Iterable[WorstPoint] = (),
        workers: Workers | None = None,
    ) -> dict[str, list[WorstPoint]]:
        """Worst point of every band for each metric, worst first.

        Parameters
        ----------
        names : sequence of str, optional
            Figures; default: all of the stage.
        starts : iterable of WorstPoint
            Points of former searches that are climbed from, too.
        workers : Workers, optional
            Processes; the result does not depend on them.
        """
        names, workers = list(names or self.metrics), workers or Workers()
        tables = self._screen(names, workers)
        chunks: list[tuple[str, list[Pair]]] = []
        listed = list(starts)
        for name in names:
            tried = [(p.omega, self.loop.point(dict(p.parameters))) for p in listed if p.requirement == name]
            pairs = [*tried, *_best(tables[name], self.options.ascents, self.bands)]
            chunks += [(name, pairs[k : k + TOGETHER]) for k in range(0, len(pairs), TOGETHER)]
        climbed: dict[str, list[Found]] = {name: [] for name in names}
        for (name, _), reached in zip(chunks, workers.map(self._climbs, chunks)):
            climbed[name] += reached
        bands = [(name, *entry) for name in names for entry in self._best_of_bands(climbed[name])]
        worst: dict[str, list[WorstPoint]] = {name: [] for name in names}
        for (name, *_), point in zip(bands, workers.map(self._finished, bands)):
            worst[name].append(point)
        return {name: sorted(points, key=lambda p: -p.gamma) for name, points in worst.items()}

    def _screen(self, names: Sequence[str], workers: Workers) -> dict[str, list[Found]]:
        """For each metric the best points at each frequency of the grid, and points near the telescope's modes."""
        options, size = self.options, len(self.loop.names)
        rng = np.random.default_rng(options.seed)
        grid = np.geomspace(self.bands[0], HIGHEST, options.frequencies + 1)
        grid = grid[:-1] * (grid[1] / grid[0]) ** rng.uniform(size=options.frequencies)
        drawn = [(float(omega), _half_corners(rng, options.points, size)) for omega in grid]
        chunks = [(names, drawn[k : k + TOGETHER]) for k in range(0, len(drawn), TOGETHER)]
        near = points_with_ends(rng, max(2, options.points), size)
        near[0] = self.loop.point({})
        parts = workers.map(self._screened, chunks) + workers.map(self._at_modes, [(names, point) for point in near])
        parts += workers.map(self._at_peaks, self._fine_axis(names))
        return {name: [entry for part in parts for entry in part[name]] for name in names}

    def _screened(self, item: tuple[Sequence[str], Sequence[tuple[float, FloatArray]]]) -> dict[str, list[Found]]:
        """For each metric the three best points at each frequency."""
        names, drawn = item
        tables: dict[str, list[Found]] = {name: [] for name in names}
        closings = self.loop.at_each(np.array([omega for omega, _ in drawn]))
        for closed, (omega, points) in zip(closings, drawn):
            responses = self.loop.all_responses(closed, points)
            for name in names:
                metric = self.metrics[name]
                if metric.band[0] <= omega < metric.band[1]:
                    part = responses[:, metric.rows, metric.columns]
                    values = largest_gains(part) * self.loop.scale(metric, omega)
                    for k in np.argsort(-values, kind="stable")[:3]:
                        tables[name].append((float(values[k]), omega, points[k]))
        return tables

    def _at_modes(self, item: tuple[Sequence[str], FloatArray]) -> dict[str, list[Found]]:
        """Values of each metric close to the slow modes of a point, which are narrower than the steps of the grid."""
        names, point = item
        tables: dict[str, list[Found]] = {name: [] for name in names}
        modes = self.loop.open.modes(point, LOWEST_MODE, self.edge)
        omega = np.concatenate([modes * (1.0 + offset) for offset in MODE_OFFSETS])
        for closed in self.loop.at_each(np.sort(omega)):
            responses = self.loop.all_responses(closed, point[None])
            for name in names:
                metric = self.metrics[name]
                if metric.band[0] <= closed.omega < metric.band[1]:
                    value = float(largest_gains(responses[:, metric.rows, metric.columns])[0])
                    tables[name].append((value * self.loop.scale(metric, closed.omega), closed.omega, point))
        return tables

    def _fine_axis(self, names: Sequence[str]) -> list[tuple[Sequence[str], FloatArray, FloatArray]]:
        """Metrics, frequencies and points of which :meth:`_at_peaks` finds the peaks, in overlapping parts."""
        members, options = self.options.members, self.options
        if not members:
            return []
        low, high = self.edge, LAST_PEAK
        axis = logarithmic_grid(low, high, PEAK_STEP)
        points = points_with_ends(np.random.default_rng([options.seed, members]), members, len(self.loop.names))
        size = len(self.loop.names)
        if members >= 2**size:
            points[: 2**size] = list(itertools.product((0.0, 1.0), repeat=size))
        return [(names, axis[k : k + PEAK_GROUP + 2], points) for k in range(0, len(axis) - 2, PEAK_GROUP)]

    def _at_peaks(self, item: tuple[Sequence[str], FloatArray, FloatArray]) -> dict[str, list[Found]]:
        """Peaks of the gain of each point, over frequencies, for each metric."""
        names, axis, points = item
        values = {name: np.zeros((len(axis), len(points))) for name in names}
        for k, closed in enumerate(self.loop.at_each(axis)):
            responses = self.loop.all_responses(closed, points)
            for name in names:
                metric = self.metrics[name]
                if metric.band[0] <= closed.omega < metric.band[1]:
                    gains = largest_gains(responses[:, metric.rows, metric.columns])
                    values[name][k] = gains * self.loop.scale(metric, closed.omega)
        tables: dict[str, list[Found]] = {}
        for name, gains in values.items():
            inside = gains[1:-1]
            where = np.argwhere((inside > 0.0) & (inside >= gains[:-2]) & (inside > gains[2:]))
            tables[name] = [(float(inside[k, j]), float(axis[k + 1]), points[j]) for k, j in where]
        return tables

    def _climbs(self, item: tuple[str, Sequence[Pair]]) -> list[Found]:
        """What ascents from some pairs reach."""
        name, pairs = item
        return [self.climb(self.metrics[name], *pair) for pair in pairs]

    def _best_of_bands(self, climbed: Sequence[Found]) -> list[tuple[int, bool, bool, Found]]:
        """The best points of each band, whether it is one to search around (the first, and leading) or to confirm."""
        best: dict[int, list[Found]] = {}
        for entry in sorted(climbed, key=lambda entry: -entry[0]):
            of_band = best.setdefault(int(np.searchsorted(self.bands, entry[1])), [])
            if (
                entry[0] > 0.0
                and len(of_band) < self.options.several
                and all(apart(entry[1:], other[1:]) for other in of_band)
            ):
                of_band.append(entry)
        largest = max((of_band[0][0] for of_band in best.values() if of_band), default=0.0)
        return [
            (band, k == 0 and entry[0] >= LEADING * largest, entry[0] >= self.options.confirmed * largest, entry)
            for band, of_band in best.items()
            for k, entry in enumerate(of_band)
        ]

    def _finished(self, item: tuple[str, int, bool, bool, Found]) -> WorstPoint:
        """The best point of a band, searched around if the band is a leading one, with its value confirmed."""
        name, band, leading, confirmed, best = item
        metric = self.metrics[name]
        if leading:
            best = self._around(metric, best, np.random.default_rng([self.options.seed, band]))
        return self.confirmed(metric, *best[1:], exactly=confirmed)

    def _around(self, metric: LoopMetric, best: Found, rng: np.random.Generator) -> Found:
        """Ascents from variations of the best point of a band: one to three of its parameters, and the frequency.

        Most worst points have several parameters at their bounds; an ascent cannot change one from bound to bound.
        """
        failed, count = 0, len(self.loop.names)
        while failed < self.options.patience:
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
        n = int(np.searchsorted(self.bands, omega))
        return max(metric.band[0], self.bands[max(n - 1, 0)]), min(
            metric.band[1], self.bands[min(n, len(self.bands) - 1)]
        )

    def climb(self, metric: LoopMetric, omega: float, point: FloatArray) -> Found:
        """Local ascent: value, frequency and point reached.

        It stays in the band of its start; one that ends at an edge goes on in the band beyond as long as that is up.
        """
        climbed = self._climb(metric, self._band(metric, omega), omega, point)
        for _ in self.bands:
            beyond = self._beyond(metric, climbed[1], omega)
            if beyond is None:
                break
            further = self._climb(metric, self._band(metric, beyond), beyond, climbed[2])
            if further[0] <= climbed[0]:
                break
            omega, climbed = beyond, further
        return climbed

    def _beyond(self, metric: LoopMetric, reached: float, omega: float) -> float | None:
        """Frequency just beyond the edge that an ascent from `omega` has reached; None within its band."""
        low, high = self._band(metric, omega)
        if reached >= high * (1.0 - AT_AN_EDGE) and high < min(metric.band[1], self.bands[-1]):
            return high * (1.0 + AT_AN_EDGE)
        if reached <= low * (1.0 + AT_AN_EDGE) and low > max(metric.band[0], self.bands[0]):
            return low * (1.0 - AT_AN_EDGE)
        return None

    def _climb(self, metric: LoopMetric, edges: tuple[float, float], omega: float, point: FloatArray) -> Found:
        """Local ascent within two frequencies."""
        band, best = np.array(edges), (-np.inf, omega, point)

        def objective(x: FloatArray) -> tuple[float, FloatArray]:
            nonlocal best
            at, where = float(np.exp(x[0] * FREQUENCY_SCALE)), x[1:]
            value, slope, by_frequency = self.loop.gain(at, metric, where)
            if value > best[0]:
                best = (value, at, where.copy())
            return -np.log(value), -np.concatenate([[by_frequency * FREQUENCY_SCALE], slope]) / value

        scipy.optimize.minimize(
            objective,
            np.concatenate([[np.log(omega) / FREQUENCY_SCALE], np.clip(point, 0.0, 1.0)]),
            jac=True,
            method="L-BFGS-B",
            bounds=[tuple(np.log(band) / FREQUENCY_SCALE), *([(0.0, 1.0)] * len(point))],
            options={"maxiter": self.options.iterations, "maxfun": 2 * self.options.iterations, "ftol": 1e-7},
        )
        return best

    def confirmed(self, metric: LoopMetric, omega: float, point: FloatArray, exactly: bool = True) -> WorstPoint:
        """The point with its value by the periodic solution; not `exactly`: by the LFT."""
        loop, values = self.loop, self.loop.values(point)
        gamma, left, right = loop.singular_vectors(loop.at(omega), metric, point)
        if exactly and (exact := loop.exact_gain(metric, omega, values)) is not None:
            gamma = exact
        return WorstPoint(loop.stage, metric.name, gamma, metric.limit, omega, values, right, left)


def apart(one: Pair, other: Pair) -> bool:
    """Whether two points differ: in frequency by 1 %, or in a parameter by a quarter of its range."""
    return abs(np.log(one[0] / other[0])) > APART[0] or float(np.abs(one[1] - other[1]).max()) > APART[1]


def _half_corners(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    """Random points of the unit cube, the first half of them corners."""
    points = rng.uniform(size=(count, size))
    points[: count // 2] = np.round(points[: count // 2])
    return points


def points_with_ends(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    """Random points (count, size) of the unit cube, most coordinates of each at an end: worst members are at edges."""
    points = rng.uniform(size=(count, size))
    return np.where(rng.uniform(size=points.shape) < AT_AN_END, np.round(points), points)


def _best(table: Sequence[Found], count: int, edges: Sequence[float]) -> list[Pair]:
    """The best screened pairs: equal numbers of each band between the edges, further ones from the best of all."""
    order = sorted(table, key=lambda entry: -entry[0])
    bands: dict[int, list[Pair]] = {}
    for _, omega, point in order:
        bands.setdefault(int(np.searchsorted(edges, omega)), []).append((omega, point))
    each = max(1, count // (2 * max(len(bands), 1)))
    chosen = [entry for band in bands.values() for entry in band[:each]]
    known = {omega for omega, _ in chosen}
    rest = [(omega, point) for _, omega, point in order if omega not in known]
    return [*chosen, *rest[: max(0, count - len(chosen))]]
