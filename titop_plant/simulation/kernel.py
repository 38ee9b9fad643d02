"""The ticks of plant, observer and controllers in compiled code: the bits of the numpy code, a twentieth of its time.

The order of operations is that of :mod:`titop_plant.simulation.plant_step` for the plant, of
:meth:`lftkit.SampledSystem.step` for the laws. Eight columns are added to all rows at a time: the rows stay in vector
registers, and each of them is still added up from left to right. The compiler may neither reorder sums nor fuse a
product with a sum (`fastmath` is off, and no instruction carries the flag `contract`).

numba is optional. It is imported with this module, which :func:`titop_plant.simulation.compilation.kernel` does when
a run is long enough. All compiled code is in this file, since its cache follows the changes of one file only.
"""

from __future__ import annotations

import numpy as np

from lftkit.arrays import BoolArray, FloatArray, IntArray
from lftkit.support.compiled import compiled


@compiled
def _add(columns: FloatArray, first: int, values: FloatArray, sums: FloatArray) -> None:
    """Add columns `first`, `first` + 1, ... times their values to the sums, one after the other."""
    count, rows = columns.shape
    j = first
    while j + 8 <= count:
        a, b, c, d = values[j], values[j + 1], values[j + 2], values[j + 3]
        e, f, g, h = values[j + 4], values[j + 5], values[j + 6], values[j + 7]
        for i in range(rows):
            t = ((sums[i] + columns[j, i] * a) + columns[j + 1, i] * b) + columns[j + 2, i] * c
            t = ((t + columns[j + 3, i] * d) + columns[j + 4, i] * e) + columns[j + 5, i] * f
            sums[i] = (t + columns[j + 6, i] * g) + columns[j + 7, i] * h
        j += 8
    while j < count:
        a = values[j]
        for i in range(rows):
            sums[i] += columns[j, i] * a
        j += 1


@compiled
def _product(columns: FloatArray, values: FloatArray, sums: FloatArray) -> None:
    """`columns` times `values`, added up from left to right."""
    if not len(values):
        sums[:] = 0.0
        return
    a = values[0]
    for i in range(columns.shape[1]):
        sums[i] = columns[0, i] * a
    _add(columns, 1, values, sums)


@compiled
def advance(
    pairs: int,
    own: FloatArray,
    cross: FloatArray,
    driven: FloatArray,
    block: FloatArray,
    outputs: FloatArray,
    values: FloatArray,
    later: FloatArray,
    sums: FloatArray,
) -> None:
    """Tick of a plant of constant parameters, see :class:`titop_plant.simulation.plant_step.PlantStep`.

    Outputs (24,) from `values` (coordinates, commands, phasors), and the next coordinates in their place.
    """
    plain, n = len(own), later.size
    _product(outputs, values, sums)
    for i in range(pairs):
        later[i] = own[i] * values[i] + cross[i] * values[pairs + i]
    for i in range(pairs, 2 * pairs):
        later[i] = own[i] * values[i] + cross[i] * values[i - pairs]
    for i in range(2 * pairs, plain):
        later[i] = own[i] * values[i] + 0.0
    _add(driven, 0, values[n:], later[:plain])
    if n > plain:
        _product(block, values[plain : plain + len(block)], later[plain:])
    values[:n] = later


@compiled
def _turn(turn: FloatArray, phasors: FloatArray) -> None:
    """Phasors, real and imaginary parts in turn, of the next tick."""
    for k in range(turn.shape[1]):
        re, im = phasors[2 * k], phasors[2 * k + 1]
        phasors[2 * k] = re * turn[0, k] - im * turn[1, k]
        phasors[2 * k + 1] = re * turn[1, k] + im * turn[0, k]


@compiled
def between(
    nodes: FloatArray, place: float, values: FloatArray, later: FloatArray, other: FloatArray, sums: FloatArray
) -> None:
    """Tick between two nodes of a profile, linear in the place: next states, and outputs (24,).

    Parameters
    ----------
    nodes : ndarray, shape (N, n + 8 + 2 K, n + 24)
        Columns of the step matrix at each node.
    place : float
        Number of the node and share of the way to the next.
    values, later, other, sums
        States, commands and phasors; two vectors (n + 24,); outputs.
    """
    k = int(place)
    n, last = len(later) - len(sums), len(nodes) - 1
    _product(nodes[min(k, last)], values, later)
    if k < last:
        share = place - k
        _product(nodes[k + 1], values, other)
        for i in range(len(later)):
            later[i] += (other[i] - later[i]) * share
    sums[:] = later[n:]
    values[:n] = later[:n]


@compiled
def loop(
    pairs: int,
    own: FloatArray,
    cross: FloatArray,
    driven: FloatArray,
    block: FloatArray,
    outputs: FloatArray,
    turn: FloatArray,
    nodes: FloatArray,
    places: FloatArray,
    phasors: FloatArray,
    values: FloatArray,
    order: int,
    limits: FloatArray,
    noise: FloatArray,
    bias: FloatArray,
    absent: BoolArray,
    fsm: FloatArray,
    fsm_values: FloatArray,
    parts: IntArray,
    held_columns: IntArray,
    held: FloatArray,
    pma: FloatArray,
    pma_values: FloatArray,
    platform: int,
    closed: IntArray,
    gain: float,
    authority: FloatArray,
    command: FloatArray,
    measurement: FloatArray,
    truth: FloatArray,
    estimate: FloatArray,
    commands: FloatArray,
) -> None:
    """Ticks of plant, observer and controller; a row of `measurement`, ..., `commands` for each of them.

    Parameters
    ----------
    pairs ... turn
        Of the :class:`titop_plant.simulation.plant_step.PlantStep`.
    nodes, places, phasors
        Of a plant whose parameters vary: as in :func:`between`, place of each tick, phasors of each and of the one
        after them; without nodes none.
    values, order
        Coordinates (n), commands, phasors of the plant; n.
    limits, noise, bias, absent
        Of its actuators (8,); of the samples (rows, 22), (22,); samples that are not there (rows, 22).
    fsm, fsm_values, parts, held_columns, held
        Columns of K_FSM, its state and inputs; where each sensor that is held begins in the columns that are held, and
        the end; their columns; their values.
    pma, pma_values, platform
        Columns of K_PMA, its state and inputs; first column of its inputs in the measurement.
    closed, gain, authority
        Whether mirror and forces are closed; from estimate to mirror; limits (8,).
    command
        Of the last tick (8,), in and out.
    """
    later = np.empty(order if not len(nodes) else order + measurement.shape[1] + truth.shape[1])
    other = np.empty_like(later)
    sums = np.empty(measurement.shape[1] + truth.shape[1])
    size, fsm_order, pma_order = measurement.shape[1], fsm.shape[1] - 2, pma.shape[1] - 6
    fsm_sums, pma_sums = np.empty(fsm.shape[1]), np.empty(pma.shape[1])
    mirror = 2
    for row in range(len(measurement)):
        for i in range(len(command)):
            v = command[i]
            if v > limits[i]:
                v = limits[i]
            if v < -limits[i]:
                v = -limits[i]
            values[order + i] = v
        y = measurement[row]
        if len(nodes):
            values[order + len(command) :] = phasors[row]
            between(nodes, places[row], values, later, other, sums)
        else:
            advance(pairs, own, cross, driven, block, outputs, values, later, sums)
            _turn(turn, values[order + len(command) :])
        for i in range(size):
            y[i] = np.nan if absent[row, i] else (sums[i] + noise[row, i]) + bias[i]
        truth[row, :] = sums[size:]
        for part in range(len(parts) - 1):
            finite = True
            for k in range(parts[part], parts[part + 1]):
                x = y[held_columns[k]]
                finite = finite and x - x == 0.0
            if finite:
                for k in range(parts[part], parts[part + 1]):
                    held[k] = y[held_columns[k]]
        fsm_values[fsm_order:] = y
        for k in range(len(held)):
            fsm_values[fsm_order + held_columns[k]] = held[k]
        _product(fsm, fsm_values, fsm_sums)
        fsm_values[:fsm_order] = fsm_sums[:fsm_order]
        estimate[row, :] = fsm_sums[fsm_order:]
        if closed[1]:
            pma_values[pma_order:] = y[platform : platform + 6]
            _product(pma, pma_values, pma_sums)
            pma_values[:pma_order] = pma_sums[:pma_order]
        for i in range(len(command)):
            v = 0.0
            if i < mirror and closed[0]:
                v = estimate[row, i] * gain
            if i >= mirror and closed[1]:
                v = pma_sums[pma_order + i - mirror]
            if v > authority[i]:
                v = authority[i]
            if v < -authority[i]:
                v = -authority[i]
            command[i] = v
            commands[row, i] = v
    if len(nodes):
        values[order + len(command) :] = phasors[len(measurement)]


__all__ = ["advance", "between", "loop"]
