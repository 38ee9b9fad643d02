"""Where tuning starts from: given points, random ones at the speed of the plant, and the same with less gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.system import System
from lftkit.tuning.descent.gain_moves import with_gain
from lftkit.tuning.problem import Problem
from lftkit.tuning.structures.bounds import bounds_of
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import AffineStructure, Structure

SIZES = (0.1, 1.0, 0.01, 3.0, 10.0, 0.3, 100.0, 30.0)  # of random starts in turn
LOWER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0)


@dataclass(frozen=True)
class Start:
    """A start: its seed, and its parameters (size,) or the number of a random one, made where it is run."""

    seed: int
    x: FloatArray | None = None
    number: int = 0

    def parameters(self, problem: Problem) -> FloatArray:
        """The parameters (size,)."""
        if self.x is not None:
            return problem.admitted(self.x)
        rng = np.random.default_rng(self.seed)
        x = SIZES[self.number % len(SIZES)] * problem.structure.start(rng)
        x = _at_the_speed_of_the_plant(problem, x, rng)
        return problem.admitted(x if problem.bounds is None else problem.bounds.drawn(x, rng))


def start_sizes(problem: Problem, points: Sequence[FloatArray], seed: int) -> FloatArray:
    """Magnitudes of the parameters of starts (size,), at least 1: the given ones and a random one of each size."""
    random = [start.parameters(problem) for start in random_starts(len(SIZES), seed, 0)]
    return np.asarray(np.abs([*points, *random]).max(axis=0, initial=1.0))


def given_starts(points: Sequence[FloatArray], seed: int) -> list[Start]:
    """Starts from given parameters."""
    return [Start(of_point, x) for x, of_point in zip(points, _seeds(seed, 0, len(points)))]


def random_starts(count: int, seed: int, batch: int) -> list[Start]:
    """One batch of `count` random starts."""
    return [Start(of_start, None, batch * count + k) for k, of_start in enumerate(_seeds(seed, 1 + batch, count))]


def _seeds(seed: int, stream: int, count: int) -> list[int]:
    return [int(s.generate_state(1)[0]) for s in np.random.SeedSequence([seed, stream]).spawn(count)]


def lowered_gain(problem: Problem, x: FloatArray) -> FloatArray | None:
    """Parameters of the same controller with less gain, as little less as makes every model stable.

    None where the structure cannot say the parameters of a controller of less gain, or where not even no gain at all
    is enough.
    """
    for factor in LOWER:
        trial = with_gain(problem.structure, x, factor)
        if trial is None:
            return None
        if problem.stable(trial):
            return trial
    return None


def _at_the_speed_of_the_plant(problem: Problem, x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random start whose controller is stable, as fast as some mode of the plant, and weak if that stabilises the loop.

    Only for structures that can say the parameters of a given controller; others start where they say.
    """
    structure = problem.structure
    n = structure.order
    if n == 0 or not isinstance(structure, AffineStructure | StableStateSpace):
        return x
    plant = problem.models[0].A
    sizes = np.abs(scipy.linalg.eigvals(plant)) if len(plant) else np.ones(1)
    sizes = sizes[sizes > 0] if np.any(sizes > 0) else np.ones(1)
    low, high = np.log(np.quantile(sizes, [0.1, 0.9]))
    K = structure.gain_matrix(x)
    A = K[:n, :n] / max(float(np.abs(K[:n, :n]).max()), 1e-300)
    A = np.exp(rng.uniform(low, high)) * (A - (scipy.linalg.eigvals(A).real.max() + 0.3) * np.eye(n))
    try:
        trial = structure.parameters_of(System(A, K[:n, n:], K[n:, :n], K[n:, n:], structure.inputs, structure.outputs))
    except ValueError:  # a structure with fixed entries that a stable random controller does not have
        return x
    if problem.stable(trial):
        return trial
    lowered = lowered_gain(problem, trial)
    return x if lowered is None else lowered


def start_checked(x: ArrayLike, structure: Structure) -> FloatArray:
    """A given start as an array, or ValueError."""
    start: Any = np.asarray(x, dtype=float)
    if start.shape != (structure.size,) or not np.all(np.isfinite(start)):
        raise InputError(f"a start must be {structure.size} finite parameters, got an array of shape {start.shape}")
    bounds = bounds_of(structure)
    outside = [] if bounds is None else np.flatnonzero((start < bounds.lower) | (start > bounds.upper)).tolist()
    for k in outside[:1]:
        assert bounds is not None
        name = getattr(structure, "names", {k: f"x[{k}]"})[k]
        interval = f"({bounds.lower[k]:g}, {bounds.upper[k]:g})"
        raise InputError(f"start of {name} must be within its bounds {interval}, got {start[k]:g}")
    return np.asarray(start)
