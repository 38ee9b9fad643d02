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
from titop_plant.interface import COMMANDED, COMMANDS, MEASUREMENTS, TRUTH
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.simulation.sampled_plant import SampledPlant
from titop_plant.simulation.sources.drive import loaded_telescope
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.devices import ACTUATOR_FORCE, PlacedActuator
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope


def driven_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Ports of the vector that a disturbance of the user writes."""
    return (*telescope.disturbance_ports, EXTERNAL_WRENCH)


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


class DrivenPlant:
    """A telescope with a disturbance of the user; it has the interface of `SampledPlant`.

    **A positive force acts on the structure along the axis of its port's frame.** The disturbance is added to the
    tones of the plant, and switched off with them (`change`).

    Parameters
    ----------
    plant : SampledPlant or DrivenPlant
    held : ndarray, shape (n + 24, size of the ports)
        Of :func:`held_disturbance`: what a value held for a tick adds to the next state (n), the measurement (22), the
        truth (2), and the further sensors that there are.
        Of sources with another number of values as many columns.
    disturbance : Disturbance
        Frequencies of its tones [rad/s], an attribute ``lines``, are added to those of the plant.
    name : str
        Of the disturbance, for the name of the configuration.
    """

    dt: float
    frame_ticks: int
    limits: FloatArray
    tones: FloatArray
    parameters_hash: str

    def __init__(
        self, plant: SampledPlant | DrivenPlant, held: FloatArray, disturbance: Disturbance, name: str
    ) -> None:
        self.plant, self.disturbance = plant, disturbance
        self.dt, self.frame_ticks, self.limits = plant.dt, plant.frame_ticks, plant.limits
        self.tones = np.union1d(plant.tones, getattr(disturbance, "lines", []))
        self.parameters_hash = f"{plant.parameters_hash} with {name}"
        self._input, self._value = _HeldInput(plant, held), np.zeros(held.shape[1])
        self._on = True

    @property
    def sensed(self) -> FloatArray:
        """Values of the further sensors at the last tick, see `SampledPlant.sensed`."""
        return self.plant.sensed

    def reset(self) -> None:
        """Back to tick 0: same seed, same bits."""
        self.plant.reset()
        self.disturbance.reset()
        self._on = True

    def change(self, name: str, value: float) -> None:
        """Change a setting from the next tick on, see `SampledPlant.change`."""
        self.plant.change(name, value)
        if name == "disturbance":
            self._on = bool(value)

    def coordinates(self, states: FloatArray) -> FloatArray:
        """States in the coordinates in which the plant adds them, see `SampledPlant.coordinates`."""
        return self.plant.coordinates(states)

    def push(self, state: FloatArray) -> None:
        """Add `state` (n,) to the present state, see `SampledPlant.push`."""
        self.plant.push(state)

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) from this tick on; write `measurement` (22,) and `truth` (2,) of this tick."""
        self.disturbance.step(self._value)
        self.plant.step(command, measurement, truth)
        if self._on:
            self._input.add(self._value, measurement, truth)


class PlantWithActuators:
    """A telescope with further actuators that a controller commands; it has the interface of `SampledPlant`.

    Their forces follow the eight values of a command. Each is clipped to its authority.

    Parameters
    ----------
    plant : SampledPlant or DrivenPlant
    held : ndarray, shape (n + 24 + sensors, actuators)
        Of :func:`held_forces`.
    actuators : sequence of PlacedActuator
    """

    dt: float
    frame_ticks: int
    tones: FloatArray
    parameters_hash: str

    def __init__(
        self, plant: SampledPlant | DrivenPlant, held: FloatArray, actuators: Sequence[PlacedActuator]
    ) -> None:
        self.plant = plant
        self.dt, self.frame_ticks, self.tones = plant.dt, plant.frame_ticks, plant.tones
        self.parameters_hash = plant.parameters_hash
        authority = np.array([one.authority for one in actuators])
        self.limits = np.concatenate([plant.limits, authority])
        self._input, self._most, self._least, self._force = (
            _HeldInput(plant, held),
            authority,
            -authority,
            authority * 0,
        )

    @property
    def sensed(self) -> FloatArray:
        """Values of the further sensors at the last tick, see `SampledPlant.sensed`."""
        return self.plant.sensed

    def reset(self) -> None:
        """Back to tick 0: same seed, same bits."""
        self.plant.reset()

    def change(self, name: str, value: float) -> None:
        """Change a setting from the next tick on, see `SampledPlant.change`."""
        self.plant.change(name, value)

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8 + actuators,) from this tick on; write `measurement` (22,) and `truth` (2,)."""
        self.plant.step(command[:COMMANDS], measurement, truth)
        np.minimum(command[COMMANDS:], self._most, out=self._force)
        np.maximum(self._force, self._least, out=self._force)
        self._input.add(self._force, measurement, truth)


class _HeldInput:
    """What inputs beside the matrices of a telescope, held over a tick, add to it."""

    def __init__(self, plant: SampledPlant | DrivenPlant, held: FloatArray) -> None:
        self._plant = plant
        order = held.shape[0] - MEASUREMENTS - TRUTH - plant.sensed.size
        self._parts = np.cumsum([order, MEASUREMENTS, TRUTH])
        self._held = np.ascontiguousarray(np.vstack([plant.coordinates(held[:order]), held[order:]]))
        self._added = np.zeros(held.shape[0])

    def add(self, value: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Add the values of this tick to the next state, and to what is measured now."""
        np.matmul(self._held, value, out=self._added)
        pushed, measured, true, sensed = np.split(self._added, self._parts)
        self._plant.push(pushed)
        measurement += measured
        truth += true
        self._plant.sensed[:] += sensed


def held_disturbance(family: PlantFamily, config: PlantConfig, dt: float) -> FloatArray:
    """What a disturbance held for one tick adds to next state, measurement and truth.

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


def held_forces(family: PlantFamily, config: PlantConfig, actuators: Sequence[PlacedActuator], dt: float) -> FloatArray:
    """What a unit force of each of these further actuators, held for one tick, adds: columns as `held_disturbance`.

    Parameters
    ----------
    family : PlantFamily
    config : PlantConfig
        Member of the family, a telescope of constant parameters.
    actuators : sequence of PlacedActuator
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
    held = sampled(driven.at(parameter_values(config, family.telescope)), dt, method="hold")
    return np.vstack([held.B, held.D])
