"""Starts from full-order controllers of two Riccati equations, LQG and H-infinity, reduced to the order that is tuned.

A small weight on the commands and a small noise on the measurements make sure that the equations have solutions
(:mod:`lftkit.synthesis.riccati_controllers`). With the state estimate as its state a controller is
``x' = A_E x + B_E u - L y, u = F x + D y``; this system, not the controller, is stable and is reduced by balanced
truncation (left coprime factors, Liu and Anderson 1986). What results need not stabilise: these are starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.reduction.balancing import truncated
from lftkit.synthesis.extended_plant import ExtendedPlant
from lftkit.synthesis.riccati_controllers import FullOrderEstimator, central, lowest_level, lqg, sampled_lqg
from lftkit.systems.system import System
from lftkit.tuning.gains.loop import extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain, TuningRequirement
from lftkit.tuning.requirements.sector import SectorGain
from lftkit.tuning.structures.structures import AffineStructure, Structure

MAX_ORDER = 40  # of the weighted plant


def reduced_starts(problem: Problem, most: int = 2) -> list[FloatArray]:
    """Parameters of reduced full-order controllers for the first model, of each kind and of `most` gain requirements.

    Empty where the structure cannot say the parameters of a given controller.
    """
    structure = problem.structure
    if not isinstance(structure, AffineStructure):
        return []
    candidates: list[FloatArray] = []
    measured = tuple(p.name for p in problem.structure.inputs)
    commanded = tuple(p.name for p in problem.structure.outputs)
    gains = [
        r
        for r in problem.requirements
        if isinstance(r, HinfGain | H2Gain) and not (r.hard or isinstance(r, SectorGain))
    ]
    plants = [
        extended_plant(
            problem.models[0],
            measured,
            commanded,
            0,
            r,
            loop_delay=problem.loop_delay,
            pade_order=problem.pade_order,
        )
        for r in gains[:most]
    ]
    for plant in [p for p in plants if 0 < len(p.A) <= MAX_ORDER]:
        regular = _regularised(plant)
        for synthesis in (_h2, _hinf):
            try:
                reduced = [_reduced(full, plant, structure.order) for full in synthesis(regular)]
                starts = [_parameters(structure, *matrices) for matrices in reduced if matrices is not None]
            except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
                continue
            candidates += [x for x in starts if x is not None and np.all(np.isfinite(x))]
    return candidates


def sampled_lqg_starts(
    model: System, requirements: Sequence[TuningRequirement], structure: Structure, most: int = 2
) -> list[FloatArray]:
    """Parameters of discrete LQG controllers for `most` H2 gains without weights, with and without a direct path.

    They are the optimum of all controllers, and of the strictly proper ones. Empty where the structure has another
    order than the model or cannot say the parameters of a given controller.
    """
    if not isinstance(structure, AffineStructure) or structure.order != model.order:
        return []
    gains = [r for r in requirements if isinstance(r, H2Gain) and r.weight_in is None and r.weight_out is None]
    measured, commanded = (tuple(p.name for p in ports) for ports in (structure.inputs, structure.outputs))
    sampled = []
    for gain in gains[:most]:
        try:
            plant = _regularised(extended_plant(model, measured, commanded, 0, gain))
            laws = [sampled_lqg(plant, direct=direct)[0] for direct in (False, True)]
        except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
            continue
        starts = [_taken(structure, *law, model.dt) for law in laws]
        sampled += [x for x in starts if x is not None]
    return sampled


def _regularised(plant: ExtendedPlant, size: float = 1e-3) -> ExtendedPlant:
    """The plant with a small noise on each measurement and weight on each command, relative to its direct paths."""
    (n, nu), ny = plant.B2.shape, len(plant.C2)
    effort = size * (float(np.abs(plant.D12).max(initial=0.0)) or 1.0)
    noise = size * (float(np.abs(plant.D21).max(initial=0.0)) or 1.0)
    return replace(
        plant,
        B1=np.hstack([plant.B1, np.zeros((n, ny))]),
        C1=np.vstack([plant.C1, np.zeros((nu, n))]),
        D11=linalg.block_diag(plant.D11, np.zeros((nu, ny))),
        D12=np.vstack([plant.D12, effort * np.eye(nu)]),
        D21=np.hstack([plant.D21, noise * np.eye(ny)]),
    )


def _h2(plant: ExtendedPlant) -> list[FullOrderEstimator]:
    full = lqg(plant)
    return [] if full is None else [full]


def _hinf(plant: ExtendedPlant) -> list[FullOrderEstimator]:
    """Central controllers at levels a little above the lowest one that is found."""
    level = lowest_level(plant)
    designs = [] if level is None else [central(plant, above * level[1]) for above in (1.1, 1.01, 1.0005)]
    return [full for full in designs if full is not None]


def _reduced(full: FullOrderEstimator, plant: ExtendedPlant, order: int) -> Matrices | None:
    """A, B, C and D of the controller of this order."""
    if order == 0:
        empty = np.zeros((0, 0))
        D = full.D + full.F @ linalg.pinv(plant.C2)
        return empty, np.zeros((0, D.shape[1])), np.zeros((len(D), 0)), D
    kept = truncated(full.A, np.hstack([full.B, -full.L]), full.F, order)
    if kept is None:
        return None
    A, B, C = kept
    nu = full.B.shape[1]
    return A + B[:, :nu] @ C, B[:, nu:] + B[:, :nu] @ full.D, C, full.D


def _parameters(
    structure: AffineStructure, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray
) -> FloatArray | None:
    """Parameters of this controller, its states as they are or in real modal form."""
    forms = [(A, B, C)]
    if len(A):
        blocks, V = cast(
            "tuple[FloatArray, FloatArray]", linalg.cdf2rdf(*cast("tuple[ComplexArray, ComplexArray]", linalg.eig(A)))
        )
        values = linalg.svdvals(V)
        if values[0] < 1e8 * values[-1]:
            forms.append((blocks, linalg.solve(V, B), C @ V))
    return next((x for form in forms if (x := _taken(structure, *form, D)) is not None), None)


def _taken(
    structure: AffineStructure, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float = 0.0
) -> FloatArray | None:
    try:
        return structure.parameters_of(System(A, B, C, D, structure.inputs, structure.outputs, dt=dt))
    except ValueError:  # fixed entries that this controller does not have
        return None
