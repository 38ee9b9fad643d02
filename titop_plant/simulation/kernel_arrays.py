"""Arrays that the compiled ticks read and write, by name. No numba is needed to make them.

They are the arguments of :mod:`titop_plant.simulation.kernel`. Compiled code takes a named tuple of arrays as such, and
its types follow from those of the arrays.
"""

from __future__ import annotations

from typing import NamedTuple

from lftkit.arrays import BoolArray, FloatArray, IntArray


class StepArrays(NamedTuple):
    """Numbers of a tick of the plant: n coordinates, k of them pairs and real poles, d in the block, K tones.

    Parameters
    ----------
    pairs : int
    own, cross : ndarray, shape (k,)
    driven : ndarray, shape (c or c + 2 K, k)
    block : ndarray, shape (d + c or d + c + 2 K, d)
    outputs : ndarray, shape (n + c + 2 K, m + 2)
    turn : ndarray, shape (2, K)
        Of a plant with constant parameters, see :class:`titop_plant.simulation.plant_step.PlantStep`.
    nodes : ndarray, shape (N, n + c + 2 K, n + m + 2)
        Columns of the step matrix at each node of a profile; N = 0 for constant parameters.
    """

    pairs: int
    own: FloatArray
    cross: FloatArray
    driven: FloatArray
    block: FloatArray
    outputs: FloatArray
    turn: FloatArray
    nodes: FloatArray


class Course(NamedTuple):
    """Parameters of a time-varying plant at some consecutive ticks; empty for constant parameters.

    Parameters
    ----------
    places : ndarray, shape (rows,)
        Number of the node and share of the way to the next, of each tick.
    phasors : ndarray, shape (rows + 1, 2 K)
        Of each tick and of the one after them, real and imaginary parts in turn.
    """

    places: FloatArray
    phasors: FloatArray


class SensorArrays(NamedTuple):
    """Sensor errors added to the true values at some consecutive ticks.

    Parameters
    ----------
    noise : ndarray, shape (rows, m)
    bias : ndarray, shape (m,)
    absent : ndarray of bool, shape (rows, m)
        Samples that are not there: a sensor slower than the tick, a frame that is lost.
    """

    noise: FloatArray
    bias: FloatArray
    absent: BoolArray


class ObserverArrays(NamedTuple):
    """The observer K_FSM of order n, and the values of sensors that it holds.

    Parameters
    ----------
    columns : ndarray, shape (n + m, n + 2)
        Columns of its matrix.
    values : ndarray, shape (n + m,)
        State and inputs; written.
    parts : ndarray of int
        Where each sensor that is held begins in `held_columns`, and the end.
    held_columns : ndarray of int, shape (h,)
        Columns of the measurement that are held.
    held : ndarray, shape (h,)
        Their last finite values; written.
    """

    columns: FloatArray
    values: FloatArray
    parts: IntArray
    held_columns: IntArray
    held: FloatArray


class ControllerArrays(NamedTuple):
    """The proof-mass law K_PMA of order n, the mirror law, and the limits of both.

    Parameters
    ----------
    columns : ndarray, shape (n + 6, n + 6)
        Columns of the matrix of K_PMA.
    values : ndarray, shape (n + 6,)
        Its state and inputs; written.
    platform : int
        First column of its inputs in the measurement.
    closed : ndarray of int, shape (2,)
        Whether the loops of mirror and forces are closed.
    gain : float
        From estimate to command of the mirror [rad/rad].
    authority : ndarray, shape (c,)
        Commands are limited to [-authority, authority].
    command : ndarray, shape (c,)
        That of the last tick [rad, N]; written.
    """

    columns: FloatArray
    values: FloatArray
    platform: int
    closed: IntArray
    gain: float
    authority: FloatArray
    command: FloatArray


class TickRecord(NamedTuple):
    """Signals of some consecutive ticks, a row for each; all are written.

    Parameters
    ----------
    measurement : ndarray, shape (rows, m)
    truth, estimate : ndarray, shape (rows, 2)
    command : ndarray, shape (rows, c)
    """

    measurement: FloatArray
    truth: FloatArray
    estimate: FloatArray
    command: FloatArray


__all__ = ["ControllerArrays", "Course", "ObserverArrays", "SensorArrays", "StepArrays", "TickRecord"]
