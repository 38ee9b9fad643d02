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
from titop_plant.interface import COMMANDED
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.telescope.assembly import EXTERNAL_WRENCH, assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.telescope import Telescope


def driven_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Ports of the vector that a disturbance of the user writes."""
    outside = (EXTERNAL_WRENCH,) if telescope.has_input(EXTERNAL_WRENCH.name) else ()
    return (*telescope.disturbance_ports, *outside)


def disturbance_columns(telescope: Telescope) -> dict[str, slice]:
    """Columns of each port in that vector.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> disturbance_columns(load_telescope())["external_wrench"]
    slice(22, 28, None)
    """
    return dict(port_slices(driven_ports(telescope)))


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
    held : ndarray, shape (n + m + 2, size of the ports)
        Of :func:`held_disturbance`: what a value held for a tick adds to the next state (n), the measurement (m) and
        the truth (2).
        Of sources with another number of values as many columns.
    disturbance : Disturbance
        Frequencies of its tones [rad/s], an attribute ``lines``, are added to those of the plant.
    name : str
        Of the disturbance, for the name of the configuration.
    """

    def __init__(self, held: FloatArray, disturbance: Disturbance, name: str) -> None:
        self.held, self.disturbance, self.name = held, disturbance, name
        self.lines = np.asarray(getattr(disturbance, "lines", []), dtype=float)
        self.acts = True
        self._value = np.zeros(held.shape[1])

    def value(self) -> FloatArray:
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
    ndarray, shape (n + m + 2, size of the ports)
    """
    ports = driven_ports(family.telescope)
    whole = assembled_telescope(family.telescope, family.isolated).system
    driven = with_sensors(whole, family.telescope).select(
        inputs=(*COMMANDED, *(port.name for port in ports)), outputs=[p.name for p in family.control_loop.outputs]
    )
    held = sampled(driven.at(family.known(parameter_values(config, family.telescope))), dt, method="hold")
    return np.vstack([held.B, held.D])[:, -total_size(ports) :]
