"""Starts from full-order controllers of two Riccati equations, LQG and H-infinity, reduced to the order that is tuned.

A small weight on the commands and a small noise on the measurements make sure that the equations have solutions. The
H-infinity controller is the central one (Doyle, Glover, Khargonekar and Francis 1989), near the lowest level at which
it exists. A direct path from disturbance to error is taken out first (Safonov, Limebeer and Chiang 1989): a static
gain makes it as small as it can be (Parrott), and the plant with the rest of it has the same controllers at this level
as one without. With the state estimate as its state a controller is ``x' = A_E x + B_E u - L y, u = F x + D y``; this
system, not the controller, is stable and is reduced by balanced truncation (left coprime factors, Liu and Anderson
1986). What results need not stabilise: these are starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import is_stable
from lftkit.analysis.riccati import riccati
from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.reduction.balancing import truncated
from lftkit.support.regular_solve import regular_solve
from lftkit.systems.system import System
from lftkit.tuning.gains.loop import ExtendedPlant, extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import H2Gain, HinfGain, TuningRequirement
from lftkit.tuning.requirements.sector import SectorGain
from lftkit.tuning.structures.structures import AffineStructure, Structure

MAX_ORDER = 40  # of the weighted plant
REGULARISED = 1e-3  # weight of commands and noise of measurements, relative to the direct paths of the plant or to 1
MAX_CONDITION = 1e8  # of the eigenvectors of a controller in modal form
LEVELS, BISECTIONS = 12, 20  # decades that are looked through for an H-infinity level, and bisections of one of them
ABOVE = 1.1, 1.01, 1.0005  # levels used over the lowest one found
MAX_REQUIREMENTS = 2


@dataclass(frozen=True)
class FullOrderEstimator:
    """Full-order controller ``x' = A x + B u - L y, u = F x + D y``."""

    A: FloatArray
    B: FloatArray
    L: FloatArray
    F: FloatArray
    D: FloatArray

    @property
    def gain_matrix(self) -> FloatArray:
        """The controller as one matrix, (states + commands, states + measurements)."""
        return np.block([[self.A + self.B @ self.F, self.B @ self.D - self.L], [self.F, self.D]])


def reduced_starts(problem: Problem) -> list[FloatArray]:
    """Parameters of reduced full-order controllers for the first model, some of each kind and gain requirement.

    Empty where the structure cannot say the parameters of a given controller.
    """
    structure = problem.structure
    if not isinstance(structure, AffineStructure):
        return []
    found: list[FloatArray] = []
    for plant in _plants(problem):
        regular = _regularised(plant)
        for synthesis in (_h2, _hinf):
            try:
                reduced = [_reduced(full, plant, structure.order) for full in synthesis(regular)]
                starts = [_parameters(structure, *matrices) for matrices in reduced if matrices is not None]
            except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
                continue
            found += [x for x in starts if x is not None and np.all(np.isfinite(x))]
    return found


def predictor_starts(
    model: System, requirements: Sequence[TuningRequirement], structure: Structure
) -> list[FloatArray]:
    """Parameters of discrete LQG controllers that predict by one sample, for H2 gains without weights.

    They are the optimum of all strictly proper controllers. Empty where the structure has another order than the model
    or cannot say the parameters of a given controller.
    """
    if not isinstance(structure, AffineStructure) or structure.order != model.order:
        return []
    gains = [r for r in requirements if isinstance(r, H2Gain) and r.weight_in is None and r.weight_out is None]
    measured, commanded = (tuple(p.name for p in ports) for ports in (structure.inputs, structure.outputs))
    found = []
    for gain in gains[:MAX_REQUIREMENTS]:
        try:
            P = _regularised(extended_plant(model, measured, commanded, 0, gain))
            X = linalg.solve_discrete_are(P.A, P.B2, P.C1.T @ P.C1, P.D12.T @ P.D12, s=P.C1.T @ P.D12)
            Y = linalg.solve_discrete_are(P.A.T, P.C2.T, P.B1 @ P.B1.T, P.D21 @ P.D21.T, s=P.B1 @ P.D21.T)
            F = -linalg.solve(P.D12.T @ P.D12 + P.B2.T @ X @ P.B2, P.B2.T @ X @ P.A + P.D12.T @ P.C1)
            L = -linalg.solve(P.D21 @ P.D21.T + P.C2 @ Y @ P.C2.T, P.C2 @ Y @ P.A.T + P.D21 @ P.B1.T).T
        except (ValueError, ArithmeticError):  # matrices near overflow or without a solution
            continue
        A = P.A + P.B2 @ F + L @ (P.C2 + P.D22 @ F)
        x = _taken(structure, A, -L, F, np.zeros((len(F), L.shape[1])), model.dt)
        found += [] if x is None else [x]
    return found


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


def _regularised(plant: ExtendedPlant) -> ExtendedPlant:
    """The plant with a small noise on each measurement and a small weight on each command."""
    (n, nu), ny = plant.B2.shape, len(plant.C2)
    effort = REGULARISED * (float(np.abs(plant.D12).max(initial=0.0)) or 1.0)
    noise = REGULARISED * (float(np.abs(plant.D21).max(initial=0.0)) or 1.0)
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


def lqg(plant: ExtendedPlant) -> FullOrderEstimator | None:
    """Controller with the least H2 norm, D11 left out; None where an equation has no solution."""
    X = riccati(plant.A, plant.B2, plant.C1.T @ plant.C1, plant.D12.T @ plant.D12, plant.C1.T @ plant.D12)
    Y = riccati(plant.A.T, plant.C2.T, plant.B1 @ plant.B1.T, plant.D21 @ plant.D21.T, plant.B1 @ plant.D21.T)
    if X is None or Y is None:
        return None
    try:
        F = -regular_solve(plant.D12.T @ plant.D12, plant.B2.T @ X + plant.D12.T @ plant.C1)
        L = -regular_solve(plant.D21 @ plant.D21.T, plant.C2 @ Y + plant.D21 @ plant.B1.T).T
    except linalg.LinAlgError:
        return None
    D = np.zeros((len(F), L.shape[1]))
    return FullOrderEstimator(plant.A + L @ plant.C2, plant.B2 + L @ plant.D22, L, F, D)


def _hinf(plant: ExtendedPlant) -> list[FullOrderEstimator]:
    """Central controllers at levels a little above the lowest one that is found."""
    level = lowest_level(plant)
    found = [] if level is None else [central(plant, above * level[1]) for above in ABOVE]
    return [full for full in found if full is not None]


def lowest_level(plant: ExtendedPlant) -> tuple[float, float] | None:
    """Levels of the H-infinity norm without and with a controller, close to each other; None where none is found."""
    high = 1.0
    for _ in range(LEVELS):
        if central(plant, high) is not None:
            break
        high *= 10.0
    else:
        return None
    for _ in range(LEVELS):
        if central(plant, high / 10.0) is None:
            break
        high /= 10.0
    else:
        return None
    low = high / 10.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if central(plant, middle) is not None else (middle, high)
    return low, high


def central(plant: ExtendedPlant, level: float) -> FullOrderEstimator | None:
    """Central controller at a level; None where the equations have no solution that is one."""
    try:
        return _central(plant, level)
    except linalg.LinAlgError:  # at the least level the coupling of both solutions is singular
        return None


def _central(plant: ExtendedPlant, level: float) -> FullOrderEstimator | None:
    K = _parrott(plant, level)
    shifted = None if K is None else _without_direct_path(_with_static_gain(plant, K), level)
    if K is None or shifted is None:
        return None
    A, B1, B2, C1, C2 = shifted.A, shifted.B1, shifted.B2, shifted.C1, shifted.C2
    nw, nz = B1.shape[1], len(C1)
    D1, D2 = np.hstack([np.zeros((nz, nw)), shifted.D12]), np.vstack([np.zeros((nz, nw)), shifted.D21])
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    R = D1.T @ D1 - linalg.block_diag(level**2 * np.eye(nw), np.zeros((B2.shape[1],) * 2))
    S = D2 @ D2.T - linalg.block_diag(level**2 * np.eye(nz), np.zeros((len(C2),) * 2))
    X, Y = riccati(A, B, C1.T @ C1, R, C1.T @ D1), riccati(A.T, C.T, B1 @ B1.T, S, B1 @ D2.T)
    if X is None or Y is None:
        return None
    F = -regular_solve(R, B.T @ X + D1.T @ C1)
    L = -regular_solve(S, C @ Y + D2 @ B1.T).T
    # X is positive semidefinite exactly where A + B2 F2 is stable: it solves a Lyapunov equation of this matrix, and a
    # mode of it that is not stable, with X >= 0, would be one of the closed loop. Y likewise; rounding hardly matters.
    if not (is_stable(A + B2 @ F[nw:]) and is_stable(A + L[:, nz:] @ C2)):
        return None
    product = X @ Y / level**2
    if float(np.abs(linalg.eigvals(product)).max(initial=0.0)) >= 1.0:
        return None
    ZL = regular_solve(np.eye(len(X)) - product.T, L[:, nz:])
    seen = C2 + shifted.D21 @ F[:nw]
    into = B2 + ZL @ shifted.D22
    return FullOrderEstimator(A + B1 @ F[:nw] + ZL @ seen, into, ZL + into @ K, F[nw:], K)


def _parrott(plant: ExtendedPlant, level: float) -> FloatArray | None:
    """Static gain with which the direct path from disturbance to error is below a level; None where there is none."""
    nu, ny = plant.D12.shape[1], len(plant.D21)
    U, sizes, V = linalg.svd(plant.D12)
    Q, widths, W = linalg.svd(plant.D21)
    D = np.vstack([U[:, nu:].T, U[:, :nu].T]) @ plant.D11 @ np.hstack([W[ny:].T, W[:ny].T])
    z, w = len(D) - nu, D.shape[1] - ny
    a, b, c, d = D[:z, :w], D[:z, w:], D[z:, :w], D[z:, w:]
    if max(_gain(D[:z]), _gain(D[:, :w])) >= level:
        return None
    inner = -c @ regular_solve(level**2 * np.eye(w) - a.T @ a, a.T @ b) if z and w else np.zeros_like(d)
    gain = V.T @ ((inner - d) / sizes[:, None] / widths) @ Q.T
    return np.asarray(gain @ _inverse(np.eye(len(plant.D22)) + plant.D22 @ gain))  # of what the commands add to y


def _inverse(matrix: FloatArray) -> FloatArray:
    return regular_solve(matrix, np.eye(len(matrix)))


def _inverse_root(matrix: FloatArray) -> FloatArray:
    """Inverse of the square root of a positive definite matrix."""
    values, vectors = linalg.eigh(matrix)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _gain(matrix: FloatArray) -> float:
    return float(linalg.norm(matrix, 2)) if matrix.size else 0.0


def _with_static_gain(plant: ExtendedPlant, K: FloatArray) -> ExtendedPlant:
    """The plant behind ``u = K y + v``, with v as command."""
    closed = plant.closed(K)
    inner = _inverse(np.eye(len(K)) - K @ plant.D22)
    return ExtendedPlant(
        closed.A,
        closed.B,
        closed.left,
        closed.C,
        closed.right,
        closed.D,
        closed.left_z,
        closed.right_w,
        plant.D22 @ inner,
    )


def _without_direct_path(plant: ExtendedPlant, level: float) -> ExtendedPlant | None:
    """A plant without D11 whose controllers at this level are the same; None where D11 is not below it."""
    D = plant.D11 / level
    if _gain(D) >= 1.0:
        return None
    left, right = np.eye(len(D)) - D @ D.T, np.eye(D.shape[1]) - D.T @ D
    through = D.T @ _inverse(left) / level
    root_left, root_right = (_inverse_root(M) for M in (left, right))
    return ExtendedPlant(
        plant.A + plant.B1 @ through @ plant.C1,
        plant.B1 @ root_right,
        plant.B2 + plant.B1 @ through @ plant.D12,
        root_left @ plant.C1,
        plant.C2 + plant.D21 @ through @ plant.C1,
        np.zeros_like(D),
        root_left @ plant.D12,
        plant.D21 @ root_right,
        plant.D22 + plant.D21 @ through @ plant.D12,
    )


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
        if values[0] < MAX_CONDITION * values[-1]:
            forms.append((blocks, linalg.solve(V, B), C @ V))
    return next((x for form in forms if (x := _taken(structure, *form, D)) is not None), None)


def _taken(
    structure: AffineStructure, A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float = 0.0
) -> FloatArray | None:
    try:
        return structure.parameters_of(System(A, B, C, D, structure.inputs, structure.outputs, dt=dt))
    except ValueError:  # fixed entries that this controller does not have
        return None
