"""Scalings of a structured singular value test: Newton steps along the centres of a barrier problem."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from lftkit.proofs.state_space.barrier import FULL, BarrierBlock, BarrierProblem, Scalings, newton_step
from lftkit.proofs.state_space.dense_barrier import DenseBarrierProblem
from lftkit.proofs.state_space.scalar_barrier import ScalarBarrierProblem

GROWTH = 8.0
"""Factor by which the weight of the objective grows from one centre to the next."""
CENTRED = 0.3
"""Newton decrement at which a point counts as centred."""
DENSE = 20_000
"""Most entries of all forms with which they are kept as matrices."""


def barrier_problem(blocks: Sequence[BarrierBlock], penalty: float = 0.0) -> BarrierProblem:
    """The barrier problem of some blocks, in the form that is fastest for their sizes."""
    problem = BarrierProblem(blocks, penalty)
    if problem.count * problem.N**2 <= DENSE:
        return DenseBarrierProblem(blocks, penalty)
    single = all(block.kind == FULL or len(block.Z) == 1 for block in blocks)
    return ScalarBarrierProblem(blocks, penalty) if single else problem


def find_scalings(
    blocks: Sequence[BarrierBlock],
    *,
    iterations: int = 80,
    until: float = np.inf,
    precision: float = 1e-7,
    penalty: float = 0.0,
) -> Scalings:
    """Scalings of trace one with a margin as large as it gets, or as soon as the sign of it is certain.

    Parameters
    ----------
    blocks : sequence of BarrierBlock
        N is the same for all; together the W have rank N.
    iterations : int
        Most Newton steps.
    until : float
        ``time.monotonic()`` after which it stops.
    precision : float
        Smallest distance to the optimal margin that is worth a step.
    penalty : float
        Of :class:`lftkit.proofs.state_space.barrier.BarrierProblem`.
    """
    problem = barrier_problem(blocks, penalty)
    y = problem.start()
    weight = -2.0 * float(problem.derivatives(y, 0.0)[0][0])
    for _ in range(iterations):
        if time.monotonic() > until:
            break
        slope, curvature = problem.derivatives(y, weight)
        step = newton_step(curvature, -slope, problem.trace)
        decrement = math.sqrt(max(float(-slope @ step), 0.0))
        y = problem.line_search(y, step, weight, decrement)
        gap = problem.degree / weight
        if y[0] < 0.0 and gap < 0.5 * -y[0]:
            break
        if decrement > CENTRED:
            continue
        if y[0] - 2.0 * gap > 0.0 or gap < precision:
            break
        weight *= GROWTH
    return problem.result(y)
