"""The actuators of the loop: ports, authority, places.

The mirror and the proof-mass actuators of the isolator come first, then those of the tables ``[[actuator]]``
(:mod:`titop_plant.telescope.devices`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from titop_plant.interface import COMMAND_PORTS
from titop_plant.telescope.sections import OscillatorTable


@dataclass(frozen=True)
class ActuatorMount:
    """Place and mechanics of an actuator.

    Parameters
    ----------
    place : str
        Point of the structure.
    axis : ndarray, shape (3,)
        Unit vector of its force or torque, in the axes of the body. **A positive value acts on the structure along it,
        and on the mass of a proof-mass actuator against it.**
    position : ndarray, shape (3,)
        From the point [m].
    table : OscillatorTable, optional
        Mechanics of a proof-mass actuator; others act from outside the structure.
    torque : bool
        Whether it is a torque.
    """

    place: str
    axis: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    table: OscillatorTable | None = field(default=None, repr=False)
    torque: bool = False

    @property
    def wrench(self) -> FloatArray:
        """Force and torque on its point by a value of 1, shape (6,)."""
        if self.torque:
            return np.concatenate([np.zeros(3), self.axis])
        return np.concatenate([self.axis, np.cross(self.position, self.axis)])


@dataclass(frozen=True)
class Actuator:
    """An actuator: a row of the loop.

    Parameters
    ----------
    port : Port
        Its part of the command.
    authority : float
        Largest value, in the unit of the port.
    scale : float
        Value in the unit of the port for a value of 1 in the loop's response: of an actuator at a place its authority
        over that of the proof-mass actuators, so that one limit holds for all forces.
    mount : ActuatorMount, optional
        Of an actuator at a place.
    """

    port: Port
    authority: float = np.inf
    scale: float = 1.0
    mount: ActuatorMount | None = field(default=None, repr=False, compare=False)

    @property
    def name(self) -> str:
        """Name of its port."""
        return self.port.name


def reference_actuators(fsm: float = np.inf, pma: float = np.inf) -> tuple[Actuator, ...]:
    """Mirror and proof-mass actuators with their authority [rad], [N]."""
    mirror, forces = COMMAND_PORTS
    return Actuator(mirror, fsm), Actuator(forces, pma)
