"""Lower bounds of a tuning problem: what no controller of any order can do better, for each gain and model alone.

The infimum of an H-infinity norm over all controllers is the lowest level at which two Riccati equations have solutions
(Doyle, Glover, Khargonekar and Francis 1989; Zhou, Doyle and Glover 1996, theorem 17.1), that of an H2 norm is reached
by the LQG controller. Both need every command in the error and noise on every measurement (D12 of full column rank, D21
of full row rank), but for the H2 norm of a loop on samples. Without them an H-infinity norm has the bound of
:func:`~lftkit.synthesis.hinfsyn`, by linear matrix inequalities, for the soft gains and the first model; for others and
for more states it has that of single points (:mod:`lftkit.synthesis.working_plant`). With a delay or with a band of
frequencies there is none here. A bound is numerical, not a proof: it counts only if a controller nearly reaches it on
the assembled loop.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import h2_norm, hinf_norm
from lftkit.arrays import FloatArray
from lftkit.synthesis.extended_plant import ClosedLoopMatrices, ExtendedPlant
from lftkit.synthesis.full_order import h2syn, hinfsyn
from lftkit.synthesis.lower_bound import SETTINGS as PROGRAM
from lftkit.synthesis.riccati_controllers import FullOrderEstimator, central, lowest_level, lqg
from lftkit.synthesis.standard_plant import has_rank
from lftkit.synthesis.working_plant import gain_out_of_reach
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.system import System
from lftkit.tuning.full_order import MAX_ORDER
from lftkit.tuning.gains.loop import extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain, TuningRequirement
from lftkit.tuning.requirements.gains import SampledH2Gain

Closed = Callable[[FullOrderEstimator], ClosedLoopMatrices]
"""The closed loop of a full-order controller."""

ANY = (0.0, np.inf)
"""Band of all frequencies."""
ROUNDING = 1e-6
"""Relative error of an H2 norm of an optimal loop that counts as rounding."""
JUST_ABOVE = 1e-3
"""Relative distance from the lowest level of the controller that confirms it, and the excess that it may have."""


def full_order_bounds(problem: Problem) -> FloatArray:
    """Lower bounds of the normalised values, shape (requirements, models); minus infinity where none is known."""
    bounds = np.full((len(problem.given), len(problem.models)), -np.inf)
    if problem.loop_delay:
        return bounds
    for i, requirement in enumerate(problem.given):
        for k, model in enumerate(problem.models):
            bounds[i, k] = _bound(problem, model, requirement, closely=not (k or requirement.hard))
    return bounds


def _bound(problem: Problem, model: System, requirement: TuningRequirement, *, closely: bool) -> float:
    synthesis = _hinf_level if type(requirement) is HinfGain else _h2_norm if isinstance(requirement, H2Gain) else None
    if synthesis is None or getattr(requirement, "band", ANY) != ANY:
        return -np.inf
    measured = tuple(p.name for p in problem.structure.inputs)
    commanded = tuple(p.name for p in problem.structure.outputs)

    def plant(order: int) -> ExtendedPlant:
        return extended_plant(model, measured, commanded, order, requirement)  # type: ignore[arg-type]

    try:
        if isinstance(requirement, SampledH2Gain):
            # Of the discrete plant that belongs to an image, for white noise of unit density
            image = extended_plant(model, measured, commanded, 0, requirement.unlagged)
            if len(image.A) > MAX_ORDER:
                return -np.inf
            optimal = h2syn(_system(image, requirement.period), "y", "u")
            return optimal.lower * (1.0 - ROUNDING) / float(np.sqrt(requirement.period))
        alone = plant(0)
        if len(alone.A) > MAX_ORDER:
            return -np.inf
        D12, D21 = alone.D12, alone.D21
        full_rank = has_rank(D12, D12.shape[1], 1e-6, size=0.0) and has_rank(D21, len(D21), 1e-6, size=0.0)
        if len(alone.A) and full_rank:
            return synthesis(alone, lambda full: plant(len(full.A)).closed(full.gain_matrix))
        if synthesis is _hinf_level and closely and 0 < len(alone.A) <= PROGRAM.most_states:
            # Bound by the program of :func:~lftkit.synthesis.hinfsyn, or by single points; minus infinity for
            # none
            return hinfsyn(_system(alone), "y", "u").lower or -np.inf
        if synthesis is _hinf_level:
            return gain_out_of_reach(alone) or -np.inf
    except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
        pass
    return -np.inf


def _system(plant: ExtendedPlant, dt: float = 0.0) -> System:
    """The plant, or with a period the sampled one whose image it is."""
    P, (nw, nu), (nz, ny) = plant, (plant.B1.shape[1], plant.B2.shape[1]), (len(plant.C1), len(plant.C2))
    A, B, C = P.A, np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2])
    D: FloatArray = np.block([[P.D11, P.D12], [P.D21, P.D22]])
    if dt:
        A, B, C, D = to_discrete(A, B, C, D, dt)
    return System(A, B, C, D, (Port("w", nw), Port("u", nu)), (Port("z", nz), Port("y", ny)), "P", dt)


def _hinf_level(plant: ExtendedPlant, closed: Closed) -> float:
    level = lowest_level(plant)
    if level is None:
        return -np.inf
    low, high = level
    confirming = central(plant, (1.0 + JUST_ABOVE) * high)
    loop = None if confirming is None else closed(confirming)
    if loop is None or not float(linalg.eigvals(loop.A).real.max()) < 0.0:
        return -np.inf
    reached = hinf_norm(loop.A, loop.B, loop.C, loop.D).value
    # a loop below the level: the equations had no solution there by rounding alone
    return low if (1.0 - ROUNDING) * low <= reached <= (1.0 + JUST_ABOVE) ** 2 * high else -np.inf


def _h2_norm(plant: ExtendedPlant, closed: Closed) -> float:
    optimal = None if plant.D11.any() else lqg(plant)
    loop = None if optimal is None else closed(optimal)
    if loop is None or not float(linalg.eigvals(loop.A).real.max()) < 0.0:
        return -np.inf
    # neither D11 nor the optimal controller has a direct path: what the loop has of one is rounding
    norm = float(h2_norm(loop.A, loop.B, loop.C, np.zeros_like(loop.D)))
    return norm * (1.0 - ROUNDING) if np.isfinite(norm) else -np.inf
