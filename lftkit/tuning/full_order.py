"""Starts from full-order controllers of two Riccati equations, LQG and H-infinity, reduced to the order that is tuned.

A small weight on the commands and a small noise on the measurements make sure that the equations have solutions. The
H-infinity controller is the central one (Doyle, Glover, Khargonekar and Francis 1989), near the lowest level at which
it exists, D11 left out. With the state estimate as its state a controller is
``x' = A_E x + B_E u - L y, u = F x``; this system, not the controller, is stable and is reduced by balanced truncation
(left coprime factors, Liu and Anderson 1986). What results need not stabilise: these are starts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.systems.reduction import truncated
from lftkit.systems.system import System
from lftkit.tuning.gains.loop import ExtendedPlant, extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain
from lftkit.tuning.requirements.sector import SectorGain
from lftkit.tuning.structures.structures import AffineStructure

MAX_ORDER = 40  # of the weighted plant
REGULARISED = 1e-3  # weight of commands and noise of measurements, relative to the direct paths of the plant or to 1
MAX_CONDITION = 1e8  # of the eigenvectors of a controller in modal form
LEVELS, ABOVE = 12, 1.1  # bisections of the H-infinity level; level used over the lowest one found
MAX_REQUIREMENTS = 2


@dataclass(frozen=True)
class FullOrderEstimator:
    """Full-order controller ``x' = A x + B u - L y, u = F x``."""

    A: FloatArray
    B: FloatArray
    L: FloatArray
    F: FloatArray


def reduced_starts(problem: Problem) -> list[FloatArray]:
    """Parameters of reduced full-order controllers for the first model, one of each kind and gain requirement.

    Empty where the structure cannot say the parameters of a given controller.
    """
    structure = problem.structure
    if not isinstance(structure, AffineStructure):
        return []
    found = []
    for plant in _plants(problem):
        for synthesis in (_lqg, _hinf):
            x = _start(synthesis, plant, structure)
            if x is not None and np.all(np.isfinite(x)):
                found.append(x)
    return found


def _start(
    synthesis: Callable[[ExtendedPlant], FullOrderEstimator | None], plant: ExtendedPlant, structure: AffineStructure
) -> FloatArray | None:
    try:
        estimator = synthesis(plant)
        reduced = None if estimator is None else _reduced(estimator, plant, structure.order)
        return None if reduced is None else _parameters(structure, *reduced)
    except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
        return None


def _plants(problem: Problem) -> list[ExtendedPlant]:
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
        for r in gains[:MAX_REQUIREMENTS]
    ]
    return [p for p in plants if 0 < len(p.A) <= MAX_ORDER]


def _regularised(plant: ExtendedPlant) -> Matrices:
    """B1, C1, D12 and D21 with a small noise on each measurement and a small weight on each command."""
    nu, ny = plant.B2.shape[1], len(plant.C2)
    effort = REGULARISED * (float(np.abs(plant.D12).max(initial=0.0)) or 1.0)
    noise = REGULARISED * (float(np.abs(plant.D21).max(initial=0.0)) or 1.0)
    return (
        np.hstack([plant.B1, np.zeros((len(plant.A), ny))]),
        np.vstack([plant.C1, np.zeros((nu, len(plant.A)))]),
        np.vstack([plant.D12, effort * np.eye(nu)]),
        np.hstack([plant.D21, noise * np.eye(ny)]),
    )


def _lqg(plant: ExtendedPlant) -> FullOrderEstimator | None:
    B1, C1, D12, D21 = _regularised(plant)
    try:
        X = linalg.solve_continuous_are(plant.A, plant.B2, C1.T @ C1, D12.T @ D12, s=C1.T @ D12)
        Y = linalg.solve_continuous_are(plant.A.T, plant.C2.T, B1 @ B1.T, D21 @ D21.T, s=B1 @ D21.T)
    except (linalg.LinAlgError, ValueError):
        return None
    F = -linalg.solve(D12.T @ D12, plant.B2.T @ X + D12.T @ C1)
    L = -linalg.solve(D21 @ D21.T, plant.C2 @ Y + D21 @ B1.T).T
    return FullOrderEstimator(plant.A + L @ plant.C2, plant.B2 + L @ plant.D22, L, F)


def _hinf(plant: ExtendedPlant) -> FullOrderEstimator | None:
    """Central controller at a level a little above the lowest one that is found."""
    high, best = 1.0, None
    for _ in range(LEVELS):
        best = _central(plant, high)
        if best is not None:
            break
        high *= 10.0
    low = high
    for _ in range(LEVELS):
        if best is None or _central(plant, low / 10.0) is None:
            break
        low /= 10.0
    low, high = low / 10.0, low
    for _ in range(LEVELS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if _central(plant, middle) is not None else (middle, high)
    return None if best is None else _central(plant, ABOVE * high)


def _central(plant: ExtendedPlant, level: float) -> FullOrderEstimator | None:
    B1, C1, D12, D21 = _regularised(plant)
    nw, nz = B1.shape[1], len(C1)
    D1, D2 = np.hstack([np.zeros((nz, nw)), D12]), np.vstack([np.zeros((nz, nw)), D21])
    B, C = np.hstack([B1, plant.B2]), np.vstack([C1, plant.C2])
    R = D1.T @ D1 - linalg.block_diag(level**2 * np.eye(nw), np.zeros((plant.B2.shape[1],) * 2))
    S = D2 @ D2.T - linalg.block_diag(level**2 * np.eye(nz), np.zeros((len(plant.C2),) * 2))
    try:
        X = linalg.solve_continuous_are(plant.A, B, C1.T @ C1, R, s=C1.T @ D1)
        Y = linalg.solve_continuous_are(plant.A.T, C.T, B1 @ B1.T, S, s=B1 @ D2.T)
    except (linalg.LinAlgError, ValueError):
        return None
    product = X @ Y / level**2
    least = min(float(linalg.eigvalsh(M)[0]) / max(1.0, float(np.abs(M).max())) for M in (X, Y))
    if least < -1e-7 or float(np.abs(linalg.eigvals(product)).max()) >= 1.0:
        return None
    F = -linalg.solve(R, B.T @ X + D1.T @ C1)
    L = -linalg.solve(S, C @ Y + D2 @ B1.T).T[:, nz:]
    ZL = linalg.solve(np.eye(len(X)) - product.T, L)
    seen = plant.C2 + D21 @ F[:nw]
    return FullOrderEstimator(plant.A + B1 @ F[:nw] + ZL @ seen, plant.B2 + ZL @ plant.D22, ZL, F[nw:])


def _reduced(full: FullOrderEstimator, plant: ExtendedPlant, order: int) -> Matrices | None:
    """A, B, C and D of the controller of this order."""
    if order == 0:
        empty = np.zeros((0, 0))
        D = full.F @ linalg.pinv(plant.C2)
        return empty, np.zeros((0, D.shape[1])), np.zeros((len(D), 0)), D
    kept = truncated(full.A, np.hstack([full.B, -full.L]), full.F, order)
    if kept is None:
        return None
    A, B, C = kept
    nu = full.B.shape[1]
    return A + B[:, :nu] @ C, B[:, nu:], C, np.zeros((nu, B.shape[1] - nu))


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
        if values[0] < MAX_CONDITION * values[-1]:
            forms.append((blocks, linalg.solve(V, B), C @ V))
    return next((x for form in forms if (x := _taken(structure, *form, D)) is not None), None)


def _taken(structure: AffineStructure, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> FloatArray | None:
    try:
        return structure.parameters_of(System(A, B, C, D, structure.inputs, structure.outputs))
    except ValueError:  # fixed entries that this controller does not have
        return None
