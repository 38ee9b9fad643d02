"""Starts of a controller of order n from the best one of order n - 1, with the same transfer function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import FloatArray, IntArray, Matrices
from lftkit.systems.ports import read_only
from lftkit.systems.system import System
from lftkit.tuning.problem import Problem
from lftkit.tuning.structures.structures import AffineStructure, gain_matrix_of


def lower_order(structure: object) -> AffineStructure | None:
    """The structure without its last state; None where that is not one of the same kind, or has no parameters."""
    if not isinstance(structure, AffineStructure) or structure.order == 0:
        return None
    last = structure.order - 1
    touching = (structure.rows == last) | (structure.columns == last)
    kept, dropped = structure.parameters[~touching], structure.parameters[touching]
    fixed = structure.base.copy()
    fixed[last, last] = 0.0
    if np.any(fixed[last]) or np.any(fixed[:, last]) or np.intersect1d(kept, dropped).size or kept.size == 0:
        return None
    smaller = structure.with_entries(~touching)
    return replace(
        smaller,
        order=last,
        base=read_only(np.delete(np.delete(structure.base, last, axis=0), last, axis=1)),
        rows=_without(smaller.rows, last),
        columns=_without(smaller.columns, last),
    )


def embedded(
    structure: AffineStructure,
    lower: AffineStructure,
    x: FloatArray,
    problem: Problem,
    quantiles: Sequence[float] = (0.1, 0.5, 0.9),
) -> list[FloatArray]:
    """Parameters of controllers with the transfer function of `lower` at `x`: the new state decays and acts on nothing.

    It decays at `quantiles` of the sizes of the plant's poles. Its input is not zero, so that its effect has a slope.
    Empty where the structure cannot take the new state.
    """
    n, K = lower.order, lower.gain_matrix(x)
    rng = np.random.default_rng(n)
    starts = []
    sizes = np.abs(linalg.eigvals(problem.models[0].A)) if len(problem.models[0].A) else np.ones(1)
    sizes = sizes[sizes > 0] if np.any(sizes > 0) else np.ones(1)
    for speed in [float(s) for s in np.quantile(sizes, quantiles)]:
        matrices = with_decaying_state(K, n, speed, rng)
        try:
            model = System(*matrices, structure.inputs, structure.outputs)
            starts.append(structure.parameters_of(model))
        except ValueError:  # fixed entries that such a state does not have
            return []
    return starts


def with_decaying_state(
    K: FloatArray, n: int, speed: float, rng: np.random.Generator, entering: float = 0.3
) -> Matrices:
    """A, B, C, D of a controller of order n with the gain matrix `K` and one state more, which acts on nothing.

    The state decays at `speed` [rad/s]; its input is not zero, so that its effect has a slope: of the size `entering`,
    relative to the gain of the controller.
    """
    A = linalg.block_diag(K[:n, :n], np.array([[-speed]]))
    size = entering * speed * max(float(np.abs(K[n:, n:]).max(initial=0.0)), 1e-3) ** 0.5
    B = np.vstack([K[:n, n:], size * rng.standard_normal((1, K.shape[1] - n))])
    return A, B, np.hstack([K[n:, :n], np.zeros((K.shape[0] - n, 1))]), K[n:, n:]


def with_decaying_states(system: System, speeds: ArrayLike, seed: int) -> System:
    """A controller without uncertain parts with a state more for each of the speeds [rad/s], and the same response."""
    rng = np.random.default_rng(seed)
    for speed in np.asarray(speeds, dtype=float):
        more = with_decaying_state(gain_matrix_of(system), system.order, float(speed), rng)
        system = System(*more, system.inputs, system.outputs, system.name)
    return system


def _without(index: IntArray, last: int) -> IntArray:
    return np.where(index > last, index - 1, index).astype(np.intp)
