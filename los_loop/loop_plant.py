"""The continuous plant of the loop, with the sensors and actuators of the telescope's file that its controllers use."""

from __future__ import annotations

import numpy as np

from lftkit import Port, System, transform
from los_loop.spec import NO_DEVICES, Placed
from titop_plant.interface import COMMANDED, MEASURED, TRUTH_PORTS
from titop_plant.simulation.build import control_loop_plant
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import disturbances_of, with_sensors
from titop_plant.telescope.devices import ACTUATOR_FORCE
from titop_plant.telescope.telescope import Telescope


def loop_plant(
    telescope: Telescope,
    placed: Placed = NO_DEVICES,
    *,
    isolated: bool = True,
) -> System:
    """The plant of the loop with the sensors and actuators of the telescope's file that the loop has.

    Parameters
    ----------
    telescope : Telescope
    placed : Placed
        None, or of this telescope (:meth:`los_loop.spec.Placed.of`). Forces of actuators stand behind the other
        commands, in their units; readings behind the line of sight.
    isolated : bool
        Whether the payload is on its isolator.

    Returns
    -------
    System
        Of :func:`titop_plant.simulation.build.control_loop_plant` where the loop has none of them.
    """
    if not (placed.sensors or placed.actuators):
        return control_loop_plant(telescope, isolated=isolated)
    whole = with_sensors(build_telescope(telescope, isolated=isolated, motors=True).system, telescope)
    forces = (ACTUATOR_FORCE,) if placed.actuators else ()
    outputs = (*MEASURED, *(port.name for port in (*TRUTH_PORTS, *telescope.sensor_ports)))
    found = whole.select(inputs=(*COMMANDED, *forces, *disturbances_of(whole)), outputs=outputs)
    if not forces:
        return found
    every = [one.name for one in telescope.placed_actuators]
    force = np.zeros((len(every), placed.forces))
    force[[every.index(port.name) for port in placed.actuators], np.arange(placed.forces)] = placed.units
    return transform(found, inputs={ACTUATOR_FORCE: (force, Port(ACTUATOR_FORCE, placed.forces, "N"))})


__all__ = ["loop_plant"]
