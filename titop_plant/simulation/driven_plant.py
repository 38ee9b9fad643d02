"""The telescope under a disturbance of the user: any signal in time, held over each tick.

The tones of the scenarios are integrated exactly between ticks; a signal that is known at the ticks only is held from
one tick to the next, as the commands are (zero-order hold)::

    x+ = e^(A h) x + B_h v + E_h d,   y = C x + D v + D_d d + noise

``d`` holds the values of :func:`driven_ports`: forces and torques of the wheels on the structure, each in its wheel's
frame, torques of the array drives, and a wrench on the spacecraft's bus; 28 values for the reference telescope.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lftkit import Port, sampled
from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices, total_size
from titop_plant.interface import COMMANDED, MEASUREMENTS, TRUTH
from titop_plant.simulation.build import PlantFamily, telescope
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.simulation.sampled_plant import SampledPlant
from titop_plant.telescope.assembly import EXTERNAL_WRENCH
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.layout import disturbance_ports
from titop_plant.telescope.parameters import Parameters, load_parameters


def driven_ports(parameters: Parameters) -> tuple[Port, ...]:
    """Ports of the vector that a disturbance of the user writes."""
    return (*disturbance_ports(parameters), EXTERNAL_WRENCH)


DISTURBANCE_PORTS = driven_ports(load_parameters())
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
        order = held.shape[0] - MEASUREMENTS - TRUTH - plant.sensed.size
        self._parts = np.cumsum([order, MEASUREMENTS, TRUTH])
        self._held = np.ascontiguousarray(np.vstack([plant.coordinates(held[:order]), held[order:]]))
        self._value, self._added = np.zeros(held.shape[1]), np.zeros(held.shape[0])
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
        if not self._on:
            return
        np.matmul(self._held, self._value, out=self._added)
        pushed, measured, true, sensed = np.split(self._added, self._parts)
        self.plant.push(pushed)
        measurement += measured
        truth += true
        self.plant.sensed[:] += sensed


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
    whole = with_sensors(telescope(family.path, family.isolated).system, family.parameters)
    ports = driven_ports(family.parameters)
    outputs = [p.name for p in family.control_loop.outputs]
    driven = whole.select(inputs=(*COMMANDED, *(p.name for p in ports)), outputs=outputs)
    held = sampled(driven.at(parameter_values(config, family.parameters)), dt, method="hold")
    return np.vstack([held.B, held.D])[:, -total_size(ports) :]
