"""The telescope under a disturbance of the user: any signal in time, held over each tick.

The tones of the scenarios are integrated exactly between ticks; a signal that is known at the ticks only is held from
one tick to the next, as the commands are (zero-order hold)::

    x+ = e^(A h) x + B_h v + E_h d,   y = C x + D v + D_d d + noise

``d`` holds the values of :func:`driven_ports`: forces and torques of the wheels on the structure, each in its wheel's
frame, torques of the array drives, and a wrench on the spacecraft's bus; 28 values for the reference telescope.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from lftkit import Port, System, sampled
from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices, total_size
from titop_plant.disturbances.sources import loaded_telescope
from titop_plant.interface import COMMANDED, COMMANDS
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.telescope.actuators import Actuator
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.devices import ACTUATOR_FORCE
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope


def driven_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Ports of the vector that a disturbance of the user writes."""
    further = (EXTERNAL_WRENCH,) if telescope.has_input(EXTERNAL_WRENCH.name) else ()
    return (*telescope.disturbance_ports, *further)


DISTURBANCE_PORTS = driven_ports(load_telescope())
"""Those of the reference telescope."""

DISTURBANCE_COLUMNS = port_slices(DISTURBANCE_PORTS)
"""Columns of each port in its vector."""

DISTURBANCE_SIZE = total_size(DISTURBANCE_PORTS)
"""Size of its vector."""


class Disturbance(Protocol):
    """A disturbance as a signal in time."""

    def step(self, out: FloatArray) -> None:
        """Write the forces and torques (size of the ports,) from this tick to the next [N, Nm] into `out`."""

    def reset(self) -> None:
        """Back to the first tick: the same values again."""


class DisturbanceInput:
    """A disturbance of the user as a held input of :class:`titop_plant.simulation.plant.Plant`.

    **A positive force acts on the structure along the axis of its port's frame.** The disturbance is added to the
    tones of the plant, and switched off with them (`Plant.change`).

    Parameters
    ----------
    held : ndarray, shape (n + 24, size of the ports)
        Of :func:`held_disturbance`: what a value held for a tick adds to the next state (n), the measurement (22), the
        truth (2), and the further sensors that there are.
        Of sources with another number of values as many columns.
    disturbance : Disturbance
        Frequencies of its tones [rad/s], an attribute ``lines``, are added to those of the plant.
    name : str
        Of the disturbance, for the name of the configuration.
    """

    limits: FloatArray = np.zeros(0)

    def __init__(self, held: FloatArray, disturbance: Disturbance, name: str) -> None:
        self.held, self.disturbance, self.name = held, disturbance, name
        self.lines = np.asarray(getattr(disturbance, "lines", []), dtype=float)
        self.acts = True
        self._value = np.zeros(held.shape[1])

    def value(self, command: FloatArray) -> FloatArray:
        """Forces and torques (size of the ports,) of this tick [N, Nm]; the next call overwrites them."""
        self.disturbance.step(self._value)
        return self._value

    def reset(self) -> None:
        """Back to the first tick: the same values again."""
        self.disturbance.reset()
        self.acts = True

    def change(self, name: str, value: float) -> None:
        """Change ``disturbance``, see `Plant.change`: its time continues; other names have no effect."""
        if name == "disturbance":
            self.acts = bool(value)


class ActuatorInput:
    """Further actuators that a controller commands, as a held input of :class:`titop_plant.simulation.plant.Plant`.

    Their forces follow the eight values of a command. Each is clipped to its authority.

    Parameters
    ----------
    held : ndarray, shape (n + 24 + sensors, actuators)
        Of :func:`held_forces`.
    actuators : sequence of Actuator
    """

    name = ""
    lines: FloatArray = np.zeros(0)
    acts = True

    def __init__(self, held: FloatArray, actuators: Sequence[Actuator]) -> None:
        self.held = held
        self.limits = np.array([one.authority for one in actuators])
        self._lowest = -self.limits
        self._force = np.zeros(self.limits.size)

    def value(self, command: FloatArray) -> FloatArray:
        """Forces (actuators,) of this tick [N], of `command` (8 + actuators,); the next call overwrites them."""
        np.minimum(command[COMMANDS:], self.limits, out=self._force)
        np.maximum(self._force, self._lowest, out=self._force)
        return self._force

    def reset(self) -> None:
        """Nothing to reset: the forces are those of each command."""

    def change(self, name: str, value: float) -> None:
        """No setting of a run changes the actuators."""


def held_disturbance(family: PlantFamily, config: PlantConfig, dt: float) -> FloatArray:
    """Contribution of a disturbance held for one tick to next state, measurement and truth.

    Parameters
    ----------
    family : PlantFamily
    config : PlantConfig
        Member of the family, a telescope of constant parameters.
    dt : float
        Tick [s].

    Returns
    -------
    ndarray, shape (n + 24, size of the ports)
        More rows where the family is that with the further sensors.
    """
    ports = driven_ports(family.telescope)
    whole = assembled_telescope(family.telescope, family.isolated).system
    return _held(whole, [p.name for p in ports], family, config, dt)[:, -total_size(ports) :]


def held_forces(family: PlantFamily, config: PlantConfig, actuators: Sequence[Actuator], dt: float) -> FloatArray:
    """Contribution of a unit force of each further actuator, held for one tick: columns as `held_disturbance`.

    Parameters
    ----------
    family : PlantFamily
    config : PlantConfig
        Member of the family, a telescope of constant parameters.
    actuators : sequence of Actuator
        Of its file.
    dt : float
        Tick [s].
    """
    names = [one.name for one in family.telescope.placed_actuators]
    whole = loaded_telescope(family.telescope, family.isolated).system
    every = _held(whole, [ACTUATOR_FORCE], family, config, dt)[:, -len(names) :]
    return every[:, [names.index(one.name) for one in actuators]]


def _held(whole: System, inputs: Sequence[str], family: PlantFamily, config: PlantConfig, dt: float) -> FloatArray:
    """Next state, measurement, truth and further sensors by held commands and `inputs`."""
    outputs = [p.name for p in family.control_loop.outputs]
    driven = with_sensors(whole, family.telescope).select(inputs=(*COMMANDED, *inputs), outputs=outputs)
    held = sampled(driven.at(family.known(parameter_values(config, family.telescope))), dt, method="hold")
    return np.vstack([held.B, held.D])
