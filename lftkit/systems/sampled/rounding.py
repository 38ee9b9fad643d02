"""Bound of what the order of summation of a sampled system makes of its outputs."""

from __future__ import annotations

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.sampled.sampled_system import SampledSystem

UNIT = 2.0**-53
"""Unit roundoff of double precision."""
POWERS = 256
"""Ticks of a block."""


def rounding_bound(system: SampledSystem, state: FloatArray, inputs: FloatArray) -> FloatArray:
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
    inputs : ndarray, shape (k, m)

    Returns
    -------
    ndarray, shape (p,)
        In the units of the outputs; infinite where the outputs grow beyond all bounds.

    Examples
    --------
    An integrator adds up the error of each step:

    >>> total = SampledSystem([[1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)], dt=1.0)
    >>> few, many = (float(rounding_bound(total, np.zeros(1), np.ones((k, 1)))[0]) for k in (256, 2560))
    >>> few < 1e-10, round(many / few)
    (True, 100)
    """
    with np.errstate(over="ignore", invalid="ignore"):
        powers, ahead = np.eye(system.order)[None], system.A
        while len(powers) < POWERS:
            powers, ahead = np.concatenate([powers, powers @ ahead]), ahead @ ahead
        largest = _largest_sums(system, state, inputs, (powers, ahead))
        products = sum(system.B.shape)
        wrong = 4.0 * products * UNIT / (1.0 - products * UNIT) * largest
        passed, responses = np.zeros(system.C.shape), system.C @ powers
        for _ in range(0, len(inputs), POWERS):
            passed += np.abs(responses).sum(axis=0)
            responses = responses @ ahead
        found = passed @ wrong[: system.order] + wrong[system.order :]
    return np.where(np.isnan(found), np.inf, found)


def _largest_sums(
    system: SampledSystem, state: FloatArray, inputs: FloatArray, powers: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Largest ``sum |M_ij z_j|`` of each row in a run, with the powers of A up to that of a block of ticks."""
    largest: FloatArray = np.zeros(sum(system.C.shape))
    whole = np.abs(np.block([[system.A, system.B], [system.C, system.D]]))
    each, ahead = powers
    blocks = -(-len(inputs) // len(each))
    padded = np.zeros((blocks, len(each), inputs.shape[1]))
    padded.reshape(-1, inputs.shape[1])[: len(inputs)] = inputs
    forced = np.zeros((blocks, len(each) + 1, system.order))
    for j in range(len(each)):  # of all blocks at once, from zero states
        forced[:, j + 1] = forced[:, j] @ system.A.T + padded[:, j] @ system.B.T
    for block, given in zip(forced, padded):
        states = each @ state + block[:-1]
        largest = np.maximum(largest, (np.hstack([np.abs(states), np.abs(given)]) @ whole.T).max(axis=0))
        state = ahead @ state + block[-1]
    return largest
