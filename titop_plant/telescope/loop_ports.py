"""Sensors and actuators of a loop as the rows of two tables.

=============  ==================================================================================================
vector         content
=============  ==================================================================================================
measurement    values of the sensors, in the order of their rows
command        values of the actuators: ``fsm_command`` (2) [rad], then all others
=============  ==================================================================================================

The response of the loop is from the normalised disturbances, and what is added to the command, to the controlled line
of sight and the command that is applied. In it the port ``pma_force`` holds all commands but those of the mirror.

:attr:`titop_plant.telescope.telescope.Telescope.loop_ports` has all rows of a telescope.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, port_indices, port_slices, total_size
from titop_plant.interface import COLUMNS, COMMANDED, LAW_PORTS, MEASURED, TRUTH, TRUTH_PORTS
from titop_plant.sensors import CAMERA_PORT, Sensor
from titop_plant.telescope.actuators import Actuator

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
    """The rows that a loop, or one of its controllers, has.

    Parameters
    ----------
    sensors : tuple of Sensor
        In the order of the measurement.
    actuators : tuple of Actuator
        In the order of the command.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> ports = load_telescope().loop_ports
    >>> ports.measurements, ports.commands
    (22, 8)
    """

    sensors: tuple[Sensor, ...]
    actuators: tuple[Actuator, ...]

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

    @property
    def limits(self) -> FloatArray:
        """Largest commanded values, shape (commands,) [rad, N, Nm]."""
        return np.concatenate([np.full(row.port.size, row.authority) for row in self.actuators])

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

    # ---- rows of controllers ----------------------------------------------------------------------------------------

    def used_by(self, *controllers: ControllerWithPorts) -> LoopPorts:
        """Rows of a loop with these controllers: those of the stored ones, and those that they name.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> [port.name for port in load_telescope().loop_ports.used_by().commanded]
        ['fsm_command', 'pma_force']
        """
        used = {port.name for system in controllers for port in (*system.inputs, *system.outputs)}
        used |= {*MEASURED, *COMMANDED}
        return LoopPorts(
            tuple(row for row in self.sensors if row.name in used),
            tuple(row for row in self.actuators if row.name in used),
        )

    def of_law(self, name: str, sensors: Sequence[str] = (), actuators: Sequence[str] = ()) -> LoopPorts:
        """Rows of a controller: those of the stored one of its name, then further ones in the order of their names.

        Parameters
        ----------
        name : {"k_fsm", "k_pma"}
        sensors, actuators : list or tuple of str
            Further rows that it reads and commands; those of the stored one may be among them.

        Raises
        ------
        ValueError
            Not a list or tuple, a name that no row has, or one twice.
        """
        inputs, outputs = LAW_PORTS[name]
        commanded = [port.name for port in outputs if port.name in COMMANDED]
        beside_mirror = [row for row in self.actuators if row.name != COMMANDED[0]]
        return LoopPorts(
            _rows(self.sensors, [port.name for port in inputs], sensors, "sensors"),
            _rows(beside_mirror, commanded, actuators, "actuators"),
        )

    def of_design(self, name: str) -> LoopPorts:
        """Rows of a design of a controller: those of the stored one, and all sensors and actuators at places.

        Parameters
        ----------
        name : {"k_fsm", "k_pma"}
        """
        placed = [row.name for row in self.actuators if row.mount is not None] if name == "k_pma" else []
        return self.of_law(name, [row.name for row in self.sensors if row.mount is not None], placed)

    def of_system(self, name: str, system: ControllerWithPorts) -> LoopPorts:
        """Rows of a linear controller, by the names of its ports: sensors in the order of the rows.

        Ports that are no rows are left out: the controller's own check refuses them.

        Parameters
        ----------
        name : {"k_fsm", "k_pma"}
        system : ControllerWithPorts
        """
        inputs, outputs = {port.name for port in system.inputs}, [port.name for port in system.outputs]
        known = {row.name for row in self.actuators} - {COMMANDED[0]}
        return self.of_law(
            name,
            [row.name for row in self.sensors if row.name in inputs],
            [port for port in outputs if port in known],
        )

    def law_ports(self, name: str) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
        """Inputs and outputs of the controller ``k_fsm`` or ``k_pma`` with these rows."""
        return self.measured, self.commanded if name == "k_pma" else LAW_PORTS[name][1]

    def idle(self, used: Iterable[str]) -> str:
        """One line on sensors and actuators beside those of the stored controllers that are not `used`, by their names.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> load_telescope().loop_ports.idle([])
        ''
        """
        known = {*MEASURED, *COMMANDED, *used}
        left = [
            (what, [row.name for row in rows if row.name not in known])
            for what, rows in (("sensor", self.sensors), ("actuator", self.actuators))
        ]
        named = " and ".join(f"{what}{'s' * (len(names) > 1)} {', '.join(names)}" for what, names in left if names)
        return f"controllers and predictions do not use {named} of the telescope's file" if named else ""

    def unscaled(self) -> LoopPorts:
        """The same rows with commands in their units [rad], [N]: a scale of 1."""
        return replace(self, actuators=tuple(replace(row, scale=1.0) for row in self.actuators))

    # ---- columns ----------------------------------------------------------------------------------------------------

    def measured_columns(self, ports: Iterable[Port]) -> slice | IntArray:
        """Columns of some of the ports in the measurement; neighbours as a slice."""
        return _columns(self.measured, ports, "measured")

    def command_columns(self, ports: Iterable[Port]) -> slice | IntArray:
        """Columns of some of the ports in the command; neighbours as a slice."""
        return _columns(self.commanded, ports, "commanded")

    @property
    def forces(self) -> slice:
        """Columns of all commands but those of the mirror."""
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
        """Columns of the mirror, or of all other commands."""
        part = COLUMNS[port]
        return slice(part.start, self.commands) if port == COMMANDED[-1] else part


Row = TypeVar("Row", Sensor, Actuator)


def _rows(known: Sequence[Row], first: Sequence[str], names: Sequence[str], what: str) -> tuple[Row, ...]:
    """The rows `first`, then those of other names, in the order of these."""
    rows = {row.name: row for row in known}
    listed = isinstance(names, list | tuple)  # others have no order, or are one text
    if not listed or any(name not in list(rows) for name in names) or len(set(names)) < len(names):
        known_names = ", ".join(rows)
        raise InputError(
            f"{what} must be a list or tuple of distinct names of the telescope's file ({known_names}), got {names!r}"
        )
    return tuple(rows[name] for name in dict.fromkeys((*first, *names)))


def _columns(known: Sequence[Port], ports: Iterable[Port], kind: str) -> slice | IntArray:
    indices = port_indices(known, [port.name for port in ports], kind)
    if len(indices) and np.array_equal(indices, np.arange(indices[0], indices[0] + len(indices))):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


__all__ = [
    "DISTURBANCE",
    "LINE_OF_SIGHT",
    "ControllerWithPorts",
    "LoopPorts",
]
