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

from lftkit.arrays import FloatArray, IntArray
from titop_plant.simulation.compiled import compiled
from titop_plant.simulation.kernel_arrays import (
    ControllerArrays,
    Course,
    ObserverArrays,
    SensorArrays,
    StepArrays,
    TickRecord,
)


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
def _coordinates(
    pairs: int,
    diagonal: FloatArray,
    cross: FloatArray,
    driven: FloatArray,
    block: FloatArray,
    values: FloatArray,
    driving: FloatArray,
    later: FloatArray,
) -> None:
    """Replace the coordinates in `values` by the next ones, with the numbers of a `StepArrays`.

    `driving` are the values behind the coordinates; `later` (n,) is overwritten.
    """
    plain, n = len(diagonal), later.size
    for i in range(pairs):
        later[i] = diagonal[i] * values[i] + cross[i] * values[pairs + i]
    for i in range(pairs, 2 * pairs):
        later[i] = diagonal[i] * values[i] + cross[i] * values[i - pairs]
    for i in range(2 * pairs, plain):
        later[i] = diagonal[i] * values[i] + 0.0
    _add(driven, 0, driving, later)
    if n > plain:
        _product(block, values[plain : plain + len(block)], later[plain:])
    for i in range(n):
        values[i] = later[i]


@compiled
def advance(step: StepArrays, values: FloatArray, later: FloatArray, sums: FloatArray) -> None:
    """Tick of a plant with constant parameters.

    Outputs from `values` (coordinates, commands, phasors), and the next coordinates in their place.

    Parameters
    ----------
    step : StepArrays
    values : ndarray, shape (n + c + 2 K,)
        Read, and the coordinates written.
    later : ndarray, shape (n,)
        Overwritten.
    sums : ndarray, shape (m + 2,)
        Outputs; written.
    """
    _product(step.outputs, values, sums)
    _coordinates(step.pairs, step.own, step.cross, step.driven, step.block, values, values[later.size :], later)


@compiled
def turn(factors: FloatArray, phasors: FloatArray) -> None:
    """Phasors (2 K,) of the next tick, real and imaginary parts in turn, by the factors ``turn`` of a `StepArrays`."""
    for k in range(factors.shape[1]):
        re, im = phasors[2 * k], phasors[2 * k + 1]
        phasors[2 * k] = re * factors[0, k] - im * factors[1, k]
        phasors[2 * k + 1] = re * factors[1, k] + im * factors[0, k]


@compiled
def between(
    nodes: FloatArray, place: float, values: FloatArray, later: FloatArray, other: FloatArray, sums: FloatArray
) -> None:
    """Tick between two nodes of a profile, linear in the place: next states, and outputs (m + 2,).

    Parameters
    ----------
    nodes : ndarray, shape (N, n + c + 2 K, n + m + 2)
        Columns of the step matrix at each node.
    place : float
        Number of the node and share of the way to the next.
    values, later, other, sums
        States, commands and phasors; two vectors (n + m + 2,); outputs.
    """
    k = int(place)
    n, last = len(later) - len(sums), len(nodes) - 1
    _product(nodes[min(k, last)], values, later)
    if k < last:
        share = place - k
        _product(nodes[k + 1], values, other)
        for i in range(len(later)):
            later[i] += (other[i] - later[i]) * share
    for i in range(n):
        values[i] = later[i]
    for i in range(len(sums)):
        sums[i] = later[n + i]


@compiled
def _limit(command: FloatArray, limits: FloatArray, out: FloatArray) -> None:
    """Write the command, limited to [-limits, limits], into `out`."""
    for i in range(len(command)):
        v = command[i]
        if v > limits[i]:
            v = limits[i]
        if v < -limits[i]:
            v = -limits[i]
        out[i] = v


@compiled
def _hold(
    parts: IntArray, columns: IntArray, measurement: FloatArray, held: FloatArray, values: FloatArray, first: int
) -> None:
    """Inputs of K_FSM, from `first` on in `values`; a sensor that is held keeps its values until all are finite."""
    for i in range(len(measurement)):
        values[first + i] = measurement[i]
    for part in range(len(parts) - 1):
        finite = True
        for k in range(parts[part], parts[part + 1]):
            x = measurement[columns[k]]
            finite = finite and x - x == 0.0
        if finite:
            for k in range(parts[part], parts[part + 1]):
                held[k] = measurement[columns[k]]
    for k in range(len(held)):
        values[first + columns[k]] = held[k]


@compiled
def _law(columns: FloatArray, values: FloatArray, order: int, sums: FloatArray) -> None:
    """Tick of a law: `sums` from its state and inputs, and its next state in `values`."""
    _product(columns, values, sums)
    for i in range(order):
        values[i] = sums[i]


@compiled
def loop(
    step: StepArrays,
    values: FloatArray,
    limits: FloatArray,
    course: Course,
    sensors: SensorArrays,
    observer: ObserverArrays,
    controller: ControllerArrays,
    record: TickRecord,
) -> None:
    """Ticks of plant, observer and controller; a row of each array of `record` for each of them.

    Parameters
    ----------
    step : StepArrays
    values : ndarray, shape (n + c + 2 K,)
        Coordinates, commands and phasors of the plant; written.
    limits : ndarray, shape (c,)
        Largest commands of its actuators.
    course : Course
    sensors : SensorArrays
    observer : ObserverArrays
    controller : ControllerArrays
    record : TickRecord
    """
    # arrays are taken from their tuples once: to do so counts references
    pairs, diagonal, cross, driven, block, outputs, factors, nodes = step
    places, phasors = course
    noise, bias, absent = sensors
    fsm, fsm_values, parts, held_columns, held = observer
    pma, pma_values, platform, closed, gain, authority, command = controller
    measurement, truth, estimate, commands = record
    varying, size, mirror = len(nodes) > 0, measurement.shape[1], estimate.shape[1]
    order, width = len(diagonal) + block.shape[1], size + truth.shape[1]
    driving, acting = values[order:], values[order : order + len(command)]
    turning = values[order + len(command) :]
    later, sums = np.empty(order + width if varying else order), np.empty(width)
    other = np.empty_like(later)
    fsm_order, pma_order = fsm.shape[1] - mirror, pma.shape[1] - (len(command) - mirror)
    fsm_sums, pma_sums = np.empty(fsm.shape[1]), np.empty(pma.shape[1])
    for row in range(len(measurement)):
        _limit(command, limits, acting)
        y = measurement[row]
        if varying:
            turning[:] = phasors[row]
            between(nodes, places[row], values, later, other, sums)
        else:
            _product(outputs, values, sums)
            _coordinates(pairs, diagonal, cross, driven, block, values, driving, later)
            turn(factors, turning)
        for i in range(size):
            y[i] = np.nan if absent[row, i] else (sums[i] + noise[row, i]) + bias[i]
        for i in range(size, width):
            truth[row, i - size] = sums[i]
        _hold(parts, held_columns, y, held, fsm_values, fsm_order)
        _law(fsm, fsm_values, fsm_order, fsm_sums)
        if closed[1]:
            for i in range(len(pma_values) - pma_order):
                pma_values[pma_order + i] = y[platform + i]
            _law(pma, pma_values, pma_order, pma_sums)
        for i in range(mirror):
            estimate[row, i] = fsm_sums[fsm_order + i]
            command[i] = estimate[row, i] * gain if closed[0] else 0.0
        for i in range(mirror, len(command)):
            command[i] = pma_sums[pma_order + i - mirror] if closed[1] else 0.0
        _limit(command, authority, command)
        for i in range(len(command)):
            commands[row, i] = command[i]
    if varying:
        turning[:] = phasors[len(measurement)]


__all__ = ["advance", "between", "loop", "turn"]
