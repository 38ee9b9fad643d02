"""Moves to controllers of more gain, from which a descent finds what no short step shows.

Where the infimum is approached only as the gains grow, the values fall along a narrow valley by a little for every
doubling of the gain; a descent then ends far from the infimum, as if at a minimum.
"""

from __future__ import annotations

import time

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.system import System
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.grid_source import Point, point_at
from lftkit.tuning.descent.metric import Metric
from lftkit.tuning.descent.quasi_newton import quasi_newton
from lftkit.tuning.descent.smooth_phase import smooth_phase
from lftkit.tuning.problem import Problem
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import AffineStructure, Structure

GAINS = (10.0, 3.0)  # factors of the controller's gain
FURTHER = (4.0, 1.0)  # times the last displacement
TOLERANCE = 1e-6  # of the logarithm of the value


def with_gain(structure: Structure, x: FloatArray, factor: float) -> FloatArray | None:
    """Parameters of `factor` times the controller at `x` (size,).

    None where the structure cannot say the parameters of a given controller, or where it or the controller forbids
    this one (fixed entries, an unstable controller).
    """
    if not isinstance(structure, AffineStructure | StableStateSpace):
        return None
    n, K, root = structure.order, structure.gain_matrix(x), np.sqrt(factor)
    model = System(
        K[:n, :n], root * K[:n, n:], root * K[n:, :n], factor * K[n:, n:], structure.inputs, structure.outputs
    )
    try:
        return structure.parameters_of(model)
    except ValueError:  # entries that this controller does not have
        return None


def gain_moves(problem: Problem, x: FloatArray, before: FloatArray | None = None) -> list[FloatArray]:
    """Stable points (size,) with more gain than `x`, and farther along the way from `before` to `x`."""
    moves = [with_gain(problem.structure, x, factor) for factor in GAINS]
    if before is not None:
        moves += [x + factor * (x - before) for factor in FURTHER]
    return [y for y in moves if y is not None and problem.stable(y)]


def descended(problem: Problem, x: FloatArray, evaluations: int, deadline: float, target: float) -> tuple[Point, int]:
    """Point that a descent from the stable point `x` (size,) leads to, and the evaluations it took.

    On the exact value where the problem suits it, else a smooth phase of at most about this number of evaluations.
    """
    if not ExactValue.suits(problem):
        smooth = smooth_phase(problem, x, evaluations, deadline, target)
        return smooth.point, smooth.evaluations
    value, identity = ExactValue(problem), np.eye(len(x))
    descent = quasi_newton(
        value,
        x,
        Metric(identity, identity),
        steps=evaluations,
        tolerance=TOLERANCE,
        stop=lambda: time.monotonic() > deadline,
    )
    return point_at(problem, descent.x), value.evaluations
