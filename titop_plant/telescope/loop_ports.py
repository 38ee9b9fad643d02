"""Sensors and actuators of the loop as rows of one table: those of the reference, then those of a telescope's file.

=============  ==================================================================================================
vector         content
=============  ==================================================================================================
measurement    values of all sensors: 22 of the reference, then the readings of a file's sensors
command        values of all actuators: ``fsm_command`` (2) [rad], ``pma_force`` (6) [N], then one force for each
               actuator of a file
=============  ==================================================================================================

The response of the loop is from the normalised disturbances, and what is added to the command, to the controlled line
of sight and the command that is applied. In it the port ``pma_force`` holds all forces: those of a file's actuators are
behind the six. Outputs of an assembled plant have the readings behind the line of sight, which ends at row 24.

:attr:`titop_plant.telescope.telescope.Telescope.loop_ports` has all rows of a telescope. This module needs numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, port_indices, port_slices, total_size
from titop_plant.interface import (
    COLUMNS,
    COMMAND_PORTS,
    COMMANDED,
    MEASURED_PORTS,
    TRUTH,
    TRUTH_PORTS,
)
from titop_plant.sensors import CAMERA_PORT, MEASURED_SENSORS, Sensor, port_alone
from titop_plant.telescope.actuators import Actuator, reference_actuators

DISTURBANCE = "disturbance"
"""Name of the normalised disturbances together: as many as the telescope has."""

(LINE_OF_SIGHT,) = (port.name for port in TRUTH_PORTS)


class ControllerWithPorts(Protocol):
    """A controller with its ports."""

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measured quantity."""

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Commanded quantity."""


@dataclass(frozen=True)
class LoopPorts:
    """The rows that a loop has.

    Parameters
    ----------
    sensors : tuple of Sensor
        In the order of the measurement. Default: those of the reference, of unknown noise, bias and rate.
    actuators : tuple of Actuator
        In the order of the command. Default: those of the reference, without limits.

    Examples
    --------
    >>> LoopPorts().measurements, LoopPorts().commands
    (22, 8)
    >>> from titop_plant.telescope.load import load_telescope
    >>> load_telescope().loop_ports.further
    ()
    """

    sensors: tuple[Sensor, ...] = tuple(port_alone(entry) for entry in MEASURED_SENSORS)
    actuators: tuple[Actuator, ...] = reference_actuators()

    @property
    def measured(self) -> tuple[Port, ...]:
        """Ports of the measurement."""
        return tuple(row.port for row in self.sensors)

    @property
    def commanded(self) -> tuple[Port, ...]:
        """Ports of the command."""
        return tuple(row.port for row in self.actuators)

    @property
    def measurements(self) -> int:
        """Values of the measurement."""
        return total_size(self.measured)

    @property
    def commands(self) -> int:
        """Values of the command."""
        return total_size(self.commanded)

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of a sample of each measured value, shape (measurements,) [m/s2, rad/s2, rad]."""
        return np.concatenate([row.noise for row in self.sensors])

    @property
    def noise_of_ticks(self) -> FloatArray:
        """The same as if every tick had a sample: of a held value larger by the root of the ticks it is held."""
        return np.concatenate([row.noise * np.sqrt(row.ticks) for row in self.sensors])

    @property
    def bias(self) -> FloatArray:
        """Constant part of the samples of each measured value, shape (measurements,) [m/s2, rad/s2, rad]."""
        return np.concatenate([row.bias for row in self.sensors])

    @property
    def scale(self) -> FloatArray:
        """Commanded values in their units for a value of 1 in the loop's response, shape (commands,)."""
        return np.concatenate([np.full(row.port.size, row.scale) for row in self.actuators])

    # ---- samples ----------------------------------------------------------------------------------------------------

    @cached_property
    def framed(self) -> tuple[Sensor, ...]:
        """Sensors that may lack a sample at a tick; the last one is held then."""
        return tuple(row for row in self.sensors if row.framed)

    @cached_property
    def ticks(self) -> dict[str, int]:
        """Ticks from one sample to the next of each of them, by the name of its port."""
        return {row.name: row.ticks for row in self.framed}

    @cached_property
    def period(self) -> int:
        """Ticks from one tick at which every sensor has a sample to the next."""
        return math.lcm(*self.ticks.values())

    @cached_property
    def columns(self) -> Mapping[str, slice]:
        """Columns of each measured port."""
        return port_slices(self.measured)

    @cached_property
    def held_parts(self) -> Mapping[str, slice]:
        """Part of each sensor that may lack a sample in the vector of held values."""
        return port_slices(row.port for row in self.framed)

    @cached_property
    def held(self) -> IntArray:
        """Columns of the held values in the measurement."""
        columns, every = self.columns, np.arange(self.measurements)
        return np.concatenate([every[:0], *(every[columns[row.name]] for row in self.framed)])

    def with_frames(self, ticks: int) -> LoopPorts:
        """The same rows with another frame rate of the camera, of which only the rate differs.

        Parameters
        ----------
        ticks : int
            Ticks from one frame to the next.
        """
        rows = (replace(row, ticks=ticks) if row.name == CAMERA_PORT else row for row in self.sensors)
        return replace(self, sensors=tuple(rows))

    # ---- rows of a file ---------------------------------------------------------------------------------------------

    @property
    def further_sensors(self) -> tuple[Sensor, ...]:
        """Rows of sensors behind those of the reference."""
        return self.sensors[len(MEASURED_PORTS) :]

    @property
    def further_actuators(self) -> tuple[Actuator, ...]:
        """Rows of actuators behind those of the reference."""
        return self.actuators[len(COMMAND_PORTS) :]

    @property
    def further_measured(self) -> tuple[Port, ...]:
        """Ports of the further sensors."""
        return tuple(row.port for row in self.further_sensors)

    @property
    def further_commanded(self) -> tuple[Port, ...]:
        """Ports of the further actuators."""
        return tuple(row.port for row in self.further_actuators)

    @property
    def further(self) -> tuple[Port, ...]:
        """Ports behind those of the reference, sensors first; empty where a loop has none."""
        return (*self.further_measured, *self.further_commanded)

    @property
    def reference(self) -> LoopPorts:
        """The rows of the reference alone."""
        return LoopPorts(self.sensors[: len(MEASURED_PORTS)], self.actuators[: len(COMMAND_PORTS)])

    def used_by(self, *controllers: ControllerWithPorts) -> LoopPorts:
        """Rows of a loop with these controllers: those of the reference, all further sensors, the actuators they name.

        Without the further rows where no controller has a port of them.

        Examples
        --------
        >>> LoopPorts().used_by().further
        ()
        """
        names = {port.name for system in controllers for port in (*system.inputs, *system.outputs)}
        if not names & {port.name for port in self.further}:
            return self.reference
        commanded = tuple(row for row in self.further_actuators if row.name in names)
        return replace(self, actuators=(*self.reference.actuators, *commanded))

    def named(self, sensors: Sequence[str] = (), actuators: Sequence[str] = ()) -> LoopPorts:
        """The rows of the reference, then further rows of these names, in their order.

        Raises
        ------
        ValueError
            A name that no further row has, or one twice.
        """
        known = {row.name: row for row in self.further_sensors}
        driven = {row.name: row for row in self.further_actuators}
        for what, names, rows in (("sensors", sensors, [*known]), ("actuators", actuators, [*driven])):
            if isinstance(names, str) or len(set(names)) < len(names) or set(names) - set(rows):
                listed = ", ".join(rows) or "it has none"
                raise InputError(f"{what} must be distinct names of the telescope's file ({listed}), got {names!r}")
        chosen, commanded = (known[name] for name in sensors), (driven[name] for name in actuators)
        first = self.reference
        return LoopPorts((*first.sensors, *chosen), (*first.actuators, *commanded))

    def among(self, inputs: Iterable[Port], outputs: Iterable[Port]) -> LoopPorts:
        """The rows of the reference, then those that ports of a controller name.

        Sensors are in the order of the rows, actuators in that of the ports.
        """
        commanded = _named(outputs, self.further_commanded)
        return self.named(
            [port.name for port in _named(self.further_measured, inputs)], [port.name for port in commanded]
        )

    def idle(self, used: Sequence[str] = ()) -> str:
        """One line on further sensors and actuators that are not `used`, by their names; empty where all are.

        Examples
        --------
        >>> LoopPorts().idle()
        ''
        """
        groups = (("sensor", self.further_measured), ("actuator", self.further_commanded))
        left = [(what, [port.name for port in group if port.name not in used]) for what, group in groups]
        named = " and ".join(f"{what}{'s' * (len(names) > 1)} {', '.join(names)}" for what, names in left if names)
        return f"controllers and predictions do not use {named} of the telescope's file" if named else ""

    def unscaled(self) -> LoopPorts:
        """The same rows with commands in their units [rad], [N]: a scale of 1."""
        return replace(self, actuators=tuple(replace(row, scale=1.0) for row in self.actuators))

    # ---- columns ----------------------------------------------------------------------------------------------------

    def seen_by(self, controller: ControllerWithPorts, first: Sequence[Port]) -> tuple[Port, ...]:
        """Ports `first`, then those of the further sensors that a controller has among its inputs, in their order."""
        return (*first, *_named(self.further_measured, controller.inputs))

    def driven_by(self, controller: ControllerWithPorts, first: Sequence[Port]) -> tuple[Port, ...]:
        """Ports `first`, then those of the further actuators that a controller has among its outputs."""
        return (*first, *_named(self.further_commanded, controller.outputs))

    def measured_columns(self, ports: Iterable[Port]) -> slice | IntArray:
        """Columns of some of the ports in the measurement; neighbours as a slice."""
        return _columns(self.measured, ports, "measured")

    def command_columns(self, ports: Iterable[Port]) -> slice | IntArray:
        """Columns of some of the ports in the command; neighbours as a slice."""
        return _columns(self.commanded, ports, "commanded")

    def readings_of(self, used: LoopPorts) -> IntArray:
        """Columns of the further sensors of other rows among the readings, in the order of those rows.

        The readings of a plant are the values of all further sensors of its telescope.
        """
        return port_indices(self.further_measured, [port.name for port in used.further_measured], "sensor")

    @property
    def forces(self) -> slice:
        """Columns of all forces in the command."""
        return self._part(COMMANDED[-1])

    # ---- response of the loop ---------------------------------------------------------------------------------------

    @property
    def added(self) -> slice:
        """Columns of all commands in the response of the loop, behind the disturbances."""
        return slice(-self.commands, None)

    @property
    def applied(self) -> slice:
        """Rows of all commands in the response of the loop."""
        return slice(TRUTH, TRUTH + self.commands)

    def rows_of(self, port: str) -> slice:
        """Rows of the line of sight or of a port of the command in the response of the loop."""
        if port == LINE_OF_SIGHT:
            return slice(0, TRUTH)
        part = self._part(port)
        return slice(TRUTH + part.start, TRUTH + part.stop)

    def columns_of(self, port: str) -> slice:
        """Columns of the disturbances or of a port of the command in the response, counted from the last command."""
        if port == DISTURBANCE:
            return slice(0, -self.commands)
        part = self._part(port)
        return slice(part.start - self.commands, part.stop - self.commands or None)

    def _part(self, port: str) -> slice:
        """Columns of a port of the reference's command; the forces with those of further actuators."""
        part = COLUMNS[port]
        return slice(part.start, self.commands) if port == COMMANDED[-1] else part


REFERENCE_PORTS = LoopPorts()
"""Rows of the reference of which no values of a telescope are known."""


def _named(ports: Iterable[Port], wanted: Iterable[Port]) -> list[Port]:
    """Those of the ports whose names are among those of the given ones."""
    names = {port.name for port in wanted}
    return [port for port in ports if port.name in names]


def _columns(known: Sequence[Port], ports: Iterable[Port], kind: str) -> slice | IntArray:
    indices = port_indices(known, [port.name for port in ports], kind)
    if len(indices) and np.array_equal(indices, np.arange(indices[0], indices[0] + len(indices))):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


__all__ = [
    "DISTURBANCE",
    "LINE_OF_SIGHT",
    "REFERENCE_PORTS",
    "ControllerWithPorts",
    "LoopPorts",
]
