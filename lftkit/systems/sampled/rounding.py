"""Bound of what the order of summation of a sampled system makes of its outputs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.sampled.sampled_system import SampledSystem

UNIT = 2.0**-53
"""Unit roundoff of double precision."""


def rounding_bound(
    system: SampledSystem, state: FloatArray, inputs: Iterable[FloatArray], block: int = 256
) -> FloatArray:
    r"""Largest difference of two evaluations of a system from one state on the same inputs, in any orders of summation.

    A row of ``[[A, B], [C, D]]`` times ``z = (x, u)`` with m products is wrong by at most ``m u / (1 - m u)`` times
    ``sum |M_ij z_j|`` in each evaluation, with the unit roundoff u. What a step makes of the states goes on to the
    outputs of later ones by ``C A^j``. The sums of absolute values are those of the run; twice as much is allowed, for
    that they differ between the evaluations.

    Parameters
    ----------
    system : SampledSystem
    state : ndarray, shape (n,)
        At the first tick.
    inputs : iterable of ndarray, shapes (k, m)
        One part of the ticks after another, so that a long run need not be in memory.
    block : int
        Ticks that are evaluated together: a power of two.

    Returns
    -------
    ndarray, shape (p,)
        In the units of the outputs; infinite where the outputs grow beyond all bounds.

    Examples
    --------
    An integrator adds up the error of each step:

    >>> total = SampledSystem([[1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)], dt=1.0)
    >>> few, many = (float(rounding_bound(total, np.zeros(1), [np.ones((k, 1))])[0]) for k in (256, 2560))
    >>> few < 1e-10, round(many / few)
    (True, 100)
    """
    with np.errstate(over="ignore", invalid="ignore"):
        powers, ahead = np.eye(system.order)[None], system.A
        while len(powers) < block:
            powers, ahead = np.concatenate([powers, powers @ ahead]), ahead @ ahead
        largest: FloatArray = np.zeros(sum(system.C.shape))
        ticks = 0
        for part in inputs:
            sums, state = _largest_sums(system, state, part, np.concatenate([powers, ahead[None]]))
            largest, ticks = np.maximum(largest, sums), ticks + len(part)
        products = sum(system.B.shape)
        wrong = 4.0 * products * UNIT / (1.0 - products * UNIT) * largest
        passed, responses = np.zeros(system.C.shape), system.C @ powers
        for _ in range(0, ticks, block):
            passed += np.abs(responses).sum(axis=0)
            responses = responses @ ahead
        bound = passed @ wrong[: system.order] + wrong[system.order :]
    return np.where(np.isnan(bound), np.inf, bound)


def _largest_sums(
    system: SampledSystem, state: FloatArray, inputs: FloatArray, powers: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Largest ``sum |M_ij z_j|`` of each row in a part of a run, and the states after it; `powers`: A^0, A, ..."""
    size = len(powers) - 1
    largest: FloatArray = np.zeros(sum(system.C.shape))
    whole = np.abs(np.block([[system.A, system.B], [system.C, system.D]]))
    blocks = -(-len(inputs) // size)
    padded = np.zeros((blocks, size, inputs.shape[1]))
    padded.reshape(-1, inputs.shape[1])[: len(inputs)] = inputs
    forced = np.zeros((blocks, size + 1, system.order))
    for j in range(size):  # of all blocks at once, from zero states
        forced[:, j + 1] = forced[:, j] @ system.A.T + padded[:, j] @ system.B.T
    for first, of_block, inputs_of_block in zip(range(0, len(inputs), size), forced, padded):
        count = min(size, len(inputs) - first)
        states = powers @ state + of_block
        sums = np.hstack([np.abs(states[:count]), np.abs(inputs_of_block[:count])]) @ whole.T
        largest, state = np.maximum(largest, sums.max(axis=0)), states[count]
    return largest, state
