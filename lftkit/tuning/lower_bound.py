"""Lower bounds of a tuning problem: what no controller of any order can do better, for each gain and model alone.

The infimum of an H-infinity norm over all controllers is the lowest level at which two Riccati equations have solutions
(Doyle, Glover, Khargonekar and Francis 1989; Zhou, Doyle and Glover 1996, theorem 17.1), that of an H2 norm is reached
by the LQG controller. Both need every command in the error and noise on every measurement (D12 of full column rank, D21
of full row rank); without them, with a delay or with a band of frequencies, there is no bound here. A bound is
numerical, not a proof: it counts only if the controller just above it reaches it on the assembled loop.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import h2_norm, hinf_norm
from lftkit.arrays import FloatArray
from lftkit.systems.system import System
from lftkit.tuning.full_order import MAX_ORDER, FullOrderEstimator, central, lowest_level, lqg
from lftkit.tuning.gains.loop import ExtendedPlant, extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain, TuningRequirement

RANK = 1e-6
"""Smallest singular value of D12 and D21, relative to the largest one, that counts as rank."""
ROUNDING = 1e-6
"""Relative error of an H2 norm of an optimal loop that counts as rounding."""
JUST_ABOVE = 1e-3
"""Relative distance from the lowest level of the controller that confirms it, and the excess that it may have."""


def full_order_bounds(problem: Problem) -> FloatArray:
    """Lower bounds of the normalised values, shape (requirements, models); minus infinity where none is known."""
    found = np.full((len(problem.given), len(problem.models)), -np.inf)
    if problem.loop_delay:
        return found
    for i, requirement in enumerate(problem.given):
        for k, model in enumerate(problem.models):
            found[i, k] = _bound(problem, model, requirement)
    return found


def _bound(problem: Problem, model: System, requirement: TuningRequirement) -> float:
    if not isinstance(requirement, HinfGain | H2Gain) or type(requirement) not in (HinfGain, H2Gain):
        return -np.inf
    if isinstance(requirement, HinfGain) and requirement.band != (0.0, np.inf):
        return -np.inf
    measured = tuple(p.name for p in problem.structure.inputs)
    commanded = tuple(p.name for p in problem.structure.outputs)
    try:
        plant = extended_plant(model, measured, commanded, 0, requirement)
        if 0 < len(plant.A) <= MAX_ORDER and _of_full_rank(plant):
            return _hinf_bound(plant) if isinstance(requirement, HinfGain) else _h2_bound(plant)
    except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
        pass
    return -np.inf


def _of_full_rank(plant: ExtendedPlant) -> bool:
    """Whether every command is in the error and every measurement has noise."""
    for matrix, least in ((plant.D12, plant.D12.shape[1]), (plant.D21, len(plant.D21))):
        sizes = linalg.svdvals(matrix) if min(matrix.shape) else np.zeros(0)
        if len(sizes) < least or not sizes[least - 1] > RANK * sizes[0] or not least:
            return False
    return True


def _hinf_bound(plant: ExtendedPlant) -> float:
    level = lowest_level(plant)
    if level is None:
        return -np.inf
    low, high = level
    confirming = central(plant, (1.0 + JUST_ABOVE) * high)
    if confirming is None:
        return -np.inf
    A, B, C, D = _closed(plant, confirming)
    reached = hinf_norm(A, B, C, D).value if float(linalg.eigvals(A).real.max()) < 0.0 else np.inf
    return low if reached <= (1.0 + JUST_ABOVE) ** 2 * high else -np.inf


def _h2_bound(plant: ExtendedPlant) -> float:
    if plant.D11.any():
        return -np.inf
    (optimal,) = lqg(plant) or (None,)
    if optimal is None:
        return -np.inf
    A, B, C, D = _closed(plant, optimal)
    if not float(linalg.eigvals(A).real.max()) < 0.0:
        return -np.inf
    return float(h2_norm(A, B, C, D)) * (1.0 - ROUNDING)


def _closed(plant: ExtendedPlant, full: FullOrderEstimator) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Closed loop with a full-order controller."""
    n, nu, ny = len(full.A), len(full.F), len(plant.C2)
    K = np.block([[full.A + full.B @ full.F, full.B @ full.D - full.L], [full.F, full.D]])
    zero = np.zeros((n, n))
    loop = ExtendedPlant(
        linalg.block_diag(plant.A, zero),
        np.vstack([plant.B1, np.zeros((n, plant.B1.shape[1]))]),
        np.block([[np.zeros((len(plant.A), n)), plant.B2], [np.eye(n), np.zeros((n, nu))]]),
        np.hstack([plant.C1, np.zeros((len(plant.C1), n))]),
        np.block([[np.zeros((n, len(plant.A))), np.eye(n)], [plant.C2, np.zeros((ny, n))]]),
        plant.D11,
        np.hstack([np.zeros((len(plant.C1), n)), plant.D12]),
        np.vstack([np.zeros((n, plant.B1.shape[1])), plant.D21]),
        linalg.block_diag(zero, plant.D22),
    ).closed(K)
    return loop.A, loop.B, loop.C, loop.D
