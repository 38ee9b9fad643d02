"""Worst parameters of a closed loop: many samples, then local ascent over parameters and frequency.

A lower bound of the true worst case, as every search is, with the parameters at which it is reached. The plant comes
as any function of the parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from lftkit.analysis.frequency_response import PoleError
from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import common_period
from lftkit.systems.sampled.bilinear import unwarped_frequency
from lftkit.systems.sampled.image import image_of
from lftkit.systems.system import System
from lftkit.tuning.gains.controller_response import controller_response
from lftkit.tuning.goals import Goal, resolved_build
from lftkit.tuning.requirements import HinfGain, TuningRequirement
from lftkit.tuning.requirements.assembled_loop import NO_DELAY
from lftkit.tuning.result import WorstCase
from lftkit.tuning.robust.closed_loop_evaluator import ClosedLoopEvaluator, gain_at
from lftkit.tuning.structures.structures import gain_matrix_of

Build = Callable[[Mapping[str, float]], System]
Box = Mapping[str, tuple[float, float]]


@checked
@dataclass(frozen=True)
class WorstCaseOptions:
    """Effort of a worst-case search.

    Parameters
    ----------
    samples : int
        Random samples beside the middle of the box and its corners.
    corners : int
        All corners where they are at most so many (up to seven parameters), otherwise a random choice of this number.
    others : int
        Runners-up that are reported, at most.
    apart : float
        Relative distance of peak frequencies from which on peaks count as different ones.
    climbs : int
        Local ascents for every requirement, from its best samples.
    iterations : int
        Most steps of a climb.
    step : float
        Difference step, as a fraction of the box.
    seed : int
    wall_limit : float
        Seconds; what was found until then is answered.
    """

    samples: int = 60
    climbs: int = 2
    iterations: int = 15
    step: float = 1e-5
    seed: int = 0
    wall_limit: float = 300.0
    corners: int = 128
    others: int = 2
    apart: float = 0.1

    def __post_init__(self) -> None:
        if self.samples < 0 or self.climbs < 0 or self.iterations < 1:
            raise InputError(
                "expected samples >= 0, climbs >= 0 and iterations >= 1, got "
                f"{self.samples}, {self.climbs} and {self.iterations}"
            )
        if not 0 < self.step < 0.1:
            raise InputError(f"step must be between 0 and 0.1 of the box, got {self.step}")


@checked
def worst_case(
    build: Build,
    box: Box,
    controller: System,
    requirements: Sequence[TuningRequirement | Goal],
    *,
    loop_delay: float = 0.0,
    options: WorstCaseOptions | None = None,
) -> tuple[WorstCase, ...]:
    """Maximise every requirement over the parameters in `box`.

    Parameters
    ----------
    build : callable
        From parameter values by name to a :class:`System`, in continuous or discrete time.
    box : mapping of str to (lowest, highest)
    controller : System
        Of the models' sampling period.
    requirements : sequence
    loop_delay : float
        Delay on the commands [s]; 0 in discrete time.
    options : WorstCaseOptions, optional

    Returns
    -------
    tuple of WorstCase
        One for each requirement, in order.

    Raises
    ------
    ValueError
        An empty box or bounds in the wrong order, sampling periods that differ, a delay in discrete time.

    Examples
    --------
    The peak of a mass on a spring grows with the mass and falls with the damper:

    >>> def build(p):
    ...     return System([[0, 1], [-1 / p["m"], -p["c"] / p["m"]]], [[0, 0], [1 / p["m"], 1 / p["m"]]],
    ...                  [[1, 0], [1, 0]], [[0, 0], [0, 0]], [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    >>> from lftkit.systems.system import System
    >>> none = System.static([[0.0]], [("y", 1)], [("u", 1)])
    >>> found, = worst_case(build, {"m": (1, 2), "c": (0.1, 0.2)}, none, [HinfGain("w", "z")])
    >>> round(found.value, 2), {k: round(v, 3) for k, v in found.parameters.items()}
    (14.15, {'m': 2.0, 'c': 0.1})
    """
    options = options or WorstCaseOptions()
    if not box:
        raise InputError("the box of parameters is empty: there is nothing to search")
    for name, (low, high) in box.items():
        if not (np.isfinite(low) and np.isfinite(high) and low <= high):
            raise InputError(f"parameter {name!r}: expected finite bounds, lowest first, got ({low}, {high})")
    middle = {name: 0.5 * (low + high) for name, (low, high) in box.items()}
    ready, needs = resolved_build(build, requirements, middle)
    search = _Search(ready, box, controller, needs, loop_delay, options)
    with one_thread():
        return search.run()


class _Search:
    """State of one search; points are in the unit cube. Discrete systems are evaluated on their images."""

    def __init__(
        self,
        build: Build,
        box: Box,
        controller: System,
        requirements: tuple[TuningRequirement, ...],
        loop_delay: float,
        options: WorstCaseOptions,
    ) -> None:
        self._build, self._controller, self._options = build, controller, options
        self._requirements, self._delay = requirements, loop_delay
        self._names = tuple(box)
        self._low = np.array([box[n][0] for n in self._names])
        self._width = np.array([box[n][1] for n in self._names]) - self._low
        self._deadline = time.monotonic() + options.wall_limit
        self._count, self._dt = 0, 0.0

    def run(self) -> tuple[WorstCase, ...]:
        n, rng = len(self._names), np.random.default_rng(self._options.seed)
        points: list[FloatArray] = [np.full(n, 0.5)]
        if 2**n <= self._options.corners:
            points += [np.array([(k >> j) & 1 for j in range(n)], dtype=float) for k in range(2**n)]
        else:
            points += list(rng.integers(0, 2, (self._options.corners, n)).astype(float))
        points += list(rng.uniform(size=(self._options.samples, n)))
        table = []
        for point in points:
            table.append(self._evaluate(point))
            if np.isinf(table[-1][0]).any() or time.monotonic() > self._deadline:
                break
        values = np.array([t[0] for t in table])
        rows = []
        for i, r in enumerate(self._requirements):
            order = np.argsort(-values[:, i], kind="stable")
            best, omega, point = values[order[0], i], table[order[0]][1][i], points[order[0]]
            sampled = float(best)
            for start in order[: self._options.climbs]:
                if np.isinf(best) or time.monotonic() > self._deadline:
                    break
                value, frequency, where = self._climb(i, points[start])
                if value > best:
                    best, omega, point = value, frequency, where
            others = self._runners_up(order, values[:, i], [t[1][i] for t in table], float(omega), points)
            rows.append(((r.name, float(best), self._parameters(point), float(omega), sampled), others))
        cases = tuple(WorstCase(*f, self._count, others) for f, others in rows)
        return tuple(replace(w, omega=unwarped_frequency(w.omega, self._dt)) for w in cases) if self._dt else cases

    def _runners_up(
        self,
        order: IntArray,
        values: FloatArray,
        frequencies: list[float],
        omega: float,
        points: list[FloatArray],
    ) -> tuple[tuple[float, Mapping[str, float]], ...]:
        """The worst samples whose peaks lie apart from `omega` and from one another."""
        seen = [omega]
        others: list[tuple[float, Mapping[str, float]]] = []
        for k in order:
            if len(others) == self._options.others or not np.isfinite(values[k]):
                break
            if all(self._apart(frequencies[k], w) for w in seen):
                seen.append(frequencies[k])
                others.append((float(values[k]), self._parameters(points[k])))
        return tuple(others)

    def _apart(self, a: float, b: float) -> bool:
        """Whether two peak frequencies [rad/s], infinity allowed, belong to different peaks."""
        return bool(a != b and (np.isinf(a) or np.isinf(b) or abs(a - b) > self._options.apart * max(a, b)))

    def _parameters(self, point: FloatArray) -> dict[str, float]:
        return dict(zip(self._names, (self._low + point * self._width).tolist()))

    def _model(self, point: FloatArray) -> System:
        """Model at a point, of a discrete one its image; the first says what the controller and requirements are."""
        model = self._build(self._parameters(point))
        if not model.dt:
            return model
        if not self._dt:
            if self._delay:
                raise InputError(f"{NO_DELAY}, got {self._delay:g} s")
            self._dt = common_period([model, self._controller])
            self._requirements = tuple(r.on_image(model) for r in self._requirements)
            self._controller = image_of(self._controller) if self._controller.dt else self._controller
        return image_of(model)

    def _evaluate(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and peak frequencies of all requirements at a point."""
        self._count += 1
        model = self._model(point)
        return ClosedLoopEvaluator(model, self._controller, self._delay).values(self._requirements)

    def _climb(self, i: int, start: FloatArray) -> tuple[float, float, FloatArray]:
        """Local ascent of the logarithm of one requirement with differences at the peak frequency."""
        best = (-np.inf, 0.0, start)

        def objective(point: FloatArray) -> tuple[float, FloatArray]:
            nonlocal best
            inside = np.clip(point, 0.0, 1.0)
            values, frequencies = self._evaluate(inside)
            value, omega = float(values[i]), float(frequencies[i])
            if value > best[0]:
                best = (value, omega, inside.copy())
            if not np.isfinite(value) or time.monotonic() > self._deadline:
                raise _Enough
            return -np.log(max(value, 1e-300)), -self._slope(i, inside, omega, value)

        with suppress(_Enough):
            scipy.optimize.minimize(
                objective,
                start,
                jac=True,
                method="L-BFGS-B",
                bounds=[(0.0, 1.0)] * len(start),
                options={"maxiter": self._options.iterations, "maxfun": 2 * self._options.iterations},
            )
        return best

    def _slope(self, i: int, point: FloatArray, omega: float, value: float) -> FloatArray:
        """Relative slope: by the envelope theorem, differences at the fixed peak frequency are enough."""
        h = self._options.step
        slope = np.zeros(len(point))
        for j in np.flatnonzero(self._width > 0):
            ends = []
            for side in (-h, h):
                moved = point.copy()
                moved[j] = np.clip(moved[j] + side, 0.0, 1.0)
                ends.append((moved[j], self._fixed(i, moved, omega)))
            slope[j] = (ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0])
        return slope / max(value, 1e-300)

    def _fixed(self, i: int, point: FloatArray, omega: float) -> float:
        r = self._requirements[i]
        model = self._model(point)
        if isinstance(r, HinfGain):
            K = controller_response(gain_matrix_of(self._controller), self._controller.order, np.array([omega]))[0]
            with suppress(PoleError):  # the plant may have a pole at this frequency that the loop moves away
                return gain_at(model, self._controller, r, omega, K, self._delay)
        return float(ClosedLoopEvaluator(model, self._controller, self._delay).values([r])[0][0])


class _Enough(Exception):
    """Ends a climb: an unstable point is as bad as can be."""
