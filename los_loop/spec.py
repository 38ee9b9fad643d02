"""What the loop consists of: ports of its response, the hold of the camera, the parts of its state.

Sensors and actuators are those of :mod:`titop_plant.telescope.loop_ports`, which has the rows and columns of the
response. Commands act one tick after the measurement; a value of a sensor that is slower than the tick is held until
its next one (:attr:`titop_plant.telescope.loop_ports.LoopPorts.ticks`).

======== ================ ==== ======================================================
port     name             size content
======== ================ ==== ======================================================
input    disturbance      22   wheels (20) and drives (2) of the reference, normalised by their weights
input    fsm_command      2    added to the command of the mirror [rad]
input    pma_force        6    added to the forces [N], those of a file's actuators behind them
output   los_controlled   2    line of sight [rad]
output   fsm_command      2    applied by the mirror [rad]
output   pma_force        6    applied by the actuators [N], those of a file behind them
======== ================ ==== ======================================================
"""

from __future__ import annotations

import itertools

import numpy as np

from lftkit.arrays import ComplexArray
from titop_plant.interface import COMMANDED, TRUTH
from titop_plant.telescope.loop_ports import DISTURBANCE, LINE_OF_SIGHT, LoopPorts

INPUTS, OUTPUTS = (DISTURBANCE, *COMMANDED), (LINE_OF_SIGHT, *COMMANDED)
"""Ports of the response of the loop."""

LOS_ROWS = slice(0, TRUTH)
"""Rows of the line of sight in the response of every loop."""


def held_response(z: ComplexArray, frame_ticks: int) -> ComplexArray:
    """Fundamental of a value that is held between frames, at ``z = exp(i w dt)`` (N,): mean of the delays of a period.

    Examples
    --------
    A slow signal passes; one of the frame rate is held at the same value for ever:

    >>> z = np.exp(2j * np.pi * np.array([1e-6, 1.0]) / 20.0)
    >>> np.round(np.abs(held_response(z, 20)), 6).tolist()
    [1.0, 0.0]
    """
    return np.asarray(np.mean(z[:, None] ** -np.arange(frame_ticks), axis=1), dtype=np.complex128)


def state_parts(plant: int, k_fsm: int, k_pma: int, ports: LoopPorts) -> tuple[slice, slice, slice, slice, slice]:
    """Parts of the state of the sampled loop for orders of plant and controllers and the rows of the loop.

    In this order: plant, command in force, K_FSM, K_PMA, values that are held.
    """
    ends = np.cumsum([0, plant, ports.commands, k_fsm, k_pma, ports.held.size]).tolist()
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    return parts[0], parts[1], parts[2], parts[3], parts[4]


__all__ = ["DISTURBANCE", "INPUTS", "LINE_OF_SIGHT", "LOS_ROWS", "OUTPUTS", "held_response", "state_parts"]
