"""Sensors and actuators of a telescope's file that a controller of the user reads and commands.

A controller knows them by their names: a class in its attributes ``sensors`` and ``actuators``, a linear system in its
ports. Values of sensors follow the inputs that a controller has anyway, forces of actuators follow its outputs. An
observer reads only; the proof-mass law reads and commands.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lftkit.arrays import IntArray
from lftkit.systems.ports import Port

if TYPE_CHECKING:
    from titop_plant.telescope.devices import PlacedActuator, PlacedSensor
    from titop_plant.telescope.telescope import Telescope


@dataclass(frozen=True)
class Devices:
    """Further sensors and actuators, of a telescope or those that one controller uses.

    Parameters
    ----------
    sensors : tuple of PlacedSensor
    actuators : tuple of PlacedActuator
    """

    sensors: tuple[PlacedSensor, ...] = ()
    actuators: tuple[PlacedActuator, ...] = ()

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Ports of the sensors."""
        return tuple(one.port for one in self.sensors)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Ports of the actuators."""
        return tuple(one.port for one in self.actuators)

    @property
    def authority(self) -> tuple[float, ...]:
        """Largest force of each actuator [N]."""
        return tuple(one.authority for one in self.actuators)

    def named(self, sensors: Sequence[str] = (), actuators: Sequence[str] = ()) -> Devices:
        """Those of these names, in their order.

        Raises
        ------
        ValueError
            A name that is none of them, or twice.
        """
        for what, names, known in (("sensors", sensors, self.inputs), ("actuators", actuators, self.outputs)):
            if isinstance(names, str) or len(set(names)) < len(names) or set(names) - {port.name for port in known}:
                listed = ", ".join(port.name for port in known) or "none, which is what the telescope's file has"
                raise ValueError(f"{what} must be different names of {listed}, got {names!r}")
        return Devices(
            tuple(next(one for one in self.sensors if one.name == name) for name in sensors),
            tuple(next(one for one in self.actuators if one.name == name) for name in actuators),
        )

    def among(self, inputs: Iterable[Port], outputs: Iterable[Port]) -> Devices:
        """Those that ports of a system name; sensors in the order of the file, actuators in that of the ports."""
        names = {port.name for port in inputs}
        commanded = {one.name for one in self.actuators}
        return self.named(
            [one.name for one in self.sensors if one.name in names],
            [port.name for port in outputs if port.name in commanded],
        )

    def idle(self, used: Sequence[str] = ()) -> str:
        """One line on those that are not `used`, by their names; empty where all are.

        Examples
        --------
        >>> Devices().idle()
        ''
        """
        groups = (("sensor", self.sensors), ("actuator", self.actuators))
        left = [(what, [one.name for one in group if one.name not in used]) for what, group in groups]
        named = " and ".join(f"{what} {', '.join(names)}" for what, names in left if names)
        return f"controllers and predictions do not use {named} of the telescope's file" if named else ""

    def __bool__(self) -> bool:
        return bool(self.sensors or self.actuators)


def placed_devices(telescope: Telescope) -> Devices:
    """Further sensors and actuators of a telescope."""
    return Devices(telescope.placed_sensors, telescope.placed_actuators)


@dataclass(frozen=True)
class Wiring:
    """What the controllers of a loop use of the further devices.

    Parameters
    ----------
    estimator, controller : ndarray of int
        Columns of the readings that each of them sees behind its other inputs.
    actuators : int
        Forces behind the eight commands.
    """

    estimator: IntArray
    controller: IntArray
    actuators: int

    @classmethod
    def of(cls, placed: Devices, estimator: Devices, controller: Devices) -> Wiring:
        """Of the devices of a telescope, and those that each controller uses."""
        columns, first = {}, 0
        for port in placed.inputs:
            columns[port.name] = np.arange(first, first + port.size)
            first += port.size

        def seen(devices: Devices) -> IntArray:
            return np.concatenate([np.zeros(0, int), *(columns[port.name] for port in devices.inputs)])

        return cls(seen(estimator), seen(controller), len(controller.actuators))


NO_DEVICES = Devices()

NONE = Wiring(np.zeros(0, int), np.zeros(0, int), 0)
"""Of controllers that use no further device."""
