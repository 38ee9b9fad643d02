"""What the loop consists of: ports of its response, devices of a file, the hold of the camera, the parts of its state.

Sensors are those of :mod:`titop_plant.telescope.sensors`. Commands act one tick after the measurement; a value of a
sensor that is slower than the tick is held until its next one (:func:`titop_plant.interface.sample_ticks`).

======== ================ ==== ======================================================
port     name             size content
======== ================ ==== ======================================================
input    disturbance      22   wheels (20) and drives (2) of the reference, normalised by their weights
input    fsm_command      2    added to the command of the mirror [rad]
input    pma_force        6    added to the forces [N]
output   los_controlled   2    line of sight [rad]
output   fsm_command      2    applied by the mirror [rad]
output   pma_force        6    applied by the actuators [N]
======== ================ ==== ======================================================
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from lftkit.arrays import ComplexArray, IntArray
from lftkit.systems.ports import Port, port_slices, total_size
from titop_plant.interface import (
    COMMAND_PORTS,
    COMMANDS,
    FORCES,
    HELD,
    MEASUREMENTS,
    TRUTH_PORTS,
)
from titop_plant.telescope.telescope import Telescope

DISTURBANCE = "disturbance"
"""Name of the normalised disturbances together: as many as the telescope has."""

(LINE_OF_SIGHT,) = (port.name for port in TRUTH_PORTS)

INPUTS: Mapping[str, slice] = MappingProxyType(
    {
        DISTURBANCE: slice(0, -COMMANDS),
        **{
            name: slice(s.start - COMMANDS, s.stop - COMMANDS or None) for name, s in port_slices(COMMAND_PORTS).items()
        },
    }
)
OUTPUTS: Mapping[str, slice] = MappingProxyType(port_slices((*TRUTH_PORTS, *COMMAND_PORTS)))
"""Columns and rows of each port in the response of the loop; columns are counted from the last command."""

ADDED = slice(-COMMANDS, None)
APPLIED = slice(OUTPUTS[LINE_OF_SIGHT].stop, OUTPUTS[COMMAND_PORTS[-1].name].stop)
"""Columns and rows of all commands."""


class ControllerWithPorts(Protocol):
    """A controller with its ports."""

    @property
    def inputs(self) -> tuple[Port, ...]:
        """What it measures."""

    @property
    def outputs(self) -> tuple[Port, ...]:
        """What it commands."""


@dataclass(frozen=True)
class Placed:
    """Sensors and actuators of a telescope's file: readings behind the measurement, forces behind the command.

    The port of the forces holds those of the actuators, too: they are among its rows and columns in every response.

    Parameters
    ----------
    sensors, actuators : tuple of Port
    noise : tuple of float
        Standard deviation of a sample of each reading.
    units : tuple of float
        Force [N] of each actuator for a value of 1 in the loop: its authority over that of the proof-mass actuators,
        so that one limit holds for all forces. Empty: 1 N.
    """

    sensors: tuple[Port, ...] = ()
    actuators: tuple[Port, ...] = ()
    noise: tuple[float, ...] = ()
    units: tuple[float, ...] = ()

    @classmethod
    def of(cls, telescope: Telescope, *controllers: ControllerWithPorts) -> Placed:
        """All of a telescope; with controllers the actuators that they command, and nothing if they use nothing.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> Placed.of(load_telescope()).commands
        8
        """
        sensors, actuators = telescope.placed_sensors, telescope.placed_actuators
        if controllers:
            names = {port.name for system in controllers for port in (*system.inputs, *system.outputs)}
            actuators = tuple(one for one in actuators if one.name in names)
            if not actuators and not names & {one.name for one in sensors}:
                return NO_DEVICES
        noise = (one.noise for one in sensors for _ in one.axes)
        whole = telescope.pma.authority
        return cls(
            tuple(one.port for one in sensors),
            tuple(one.port for one in actuators),
            tuple(noise),
            tuple(one.authority / whole for one in actuators),
        )

    @property
    def commands(self) -> int:
        """Values of all commands."""
        return COMMANDS + self.forces

    @property
    def measurements(self) -> int:
        """Values of all measurements."""
        return MEASUREMENTS + self.readings

    @property
    def added(self) -> slice:
        """Columns of all commands in the response of the loop, behind the disturbances."""
        return slice(-self.commands, None)

    @property
    def applied(self) -> slice:
        """Rows of all commands in the response of the loop."""
        return slice(APPLIED.start, APPLIED.stop + self.forces)

    @property
    def force_columns(self) -> slice:
        """Forces among the commands."""
        return slice(FORCES.start, self.commands)

    def rows(self, port: str) -> slice:
        """Rows of a port in the response of the loop."""
        own = OUTPUTS[port]
        return slice(own.start, own.stop + self.forces) if port == COMMAND_PORTS[-1].name else own

    def columns_of(self, port: str) -> slice:
        """Columns of a port in the response of the loop, as :data:`INPUTS` counts them."""
        own = INPUTS[port]
        if port == DISTURBANCE:
            return slice(0, -self.commands)
        return slice(own.start - self.forces, None if own.stop is None else own.stop - self.forces)

    @property
    def readings(self) -> int:
        """Values of all sensors."""
        return total_size(self.sensors)

    @property
    def forces(self) -> int:
        """Values of all actuators."""
        return total_size(self.actuators)

    def columns(self, base: slice, named: Sequence[Port], placed: Sequence[Port], first: int) -> slice | IntArray:
        """Columns of a controller: `base`, then those of the `placed` ports that it has, which begin at `first`."""
        names = {port.name for port in named}
        at = port_slices(placed)
        further = [np.arange(at[port.name].start, at[port.name].stop) for port in placed if port.name in names]
        if not further:
            return base
        own: IntArray = np.arange(base.start, base.stop)
        return np.concatenate([own, first + np.concatenate(further)], dtype=int)


NO_DEVICES = Placed()


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


def state_parts(
    plant: int, k_fsm: int, k_pma: int, commands: int = COMMANDS
) -> tuple[slice, slice, slice, slice, slice]:
    """Parts of the state of the sampled loop for orders of plant and controllers and the number of commands.

    In this order: plant, command in force, K_FSM, K_PMA, values that are held.
    """
    ends = np.cumsum([0, plant, commands, k_fsm, k_pma, HELD.size]).tolist()
    parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
    return parts[0], parts[1], parts[2], parts[3], parts[4]


__all__ = [
    "ADDED",
    "APPLIED",
    "DISTURBANCE",
    "INPUTS",
    "LINE_OF_SIGHT",
    "NO_DEVICES",
    "OUTPUTS",
    "Placed",
    "held_response",
    "state_parts",
]
