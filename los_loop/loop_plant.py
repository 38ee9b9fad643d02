"""The continuous plant of the loop, with the sensors and actuators of the telescope's file that its controllers use."""

from __future__ import annotations

import numpy as np

from lftkit import Port, System, transform
from los_loop.spec import NO_DEVICES, Placed
from titop_plant.interface import COMMANDED, MEASURED, TRUTH_PORTS
from titop_plant.simulation.build import control_loop_plant
from titop_plant.telescope.assembly import Telescope, build_telescope
from titop_plant.telescope.control_plant import disturbances_of, with_sensors
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.placed.devices import ACTUATOR_FORCE, placed_actuators, sensor_ports


def loop_plant(
    parameters: Parameters, placed: Placed = NO_DEVICES, *, telescope: Telescope | None = None, isolated: bool = True
) -> System:
    """The plant of the loop with the sensors and actuators of the telescope's file that the loop has.

    Parameters
    ----------
    parameters : mapping
        Of the telescope.
    placed : Placed
        None, or of this telescope (:meth:`los_loop.spec.Placed.of`). Forces of actuators stand behind the other
        commands, in their units; readings behind the line of sight.
    telescope : Telescope, optional
        Assembled without inputs for these forces, if it is known.
    isolated : bool
        Whether the payload is on its isolator.

    Returns
    -------
    System
        Of :func:`titop_plant.simulation.build.control_loop_plant` where the loop has none of them.
    """
    if not (placed.sensors or placed.actuators):
        return control_loop_plant(telescope or build_telescope(parameters, isolated=isolated), parameters)
    whole = with_sensors(build_telescope(parameters, isolated=isolated, motors=True).system, parameters)
    forces = (ACTUATOR_FORCE,) if placed.actuators else ()
    outputs = (*MEASURED, *(port.name for port in (*TRUTH_PORTS, *sensor_ports(parameters))))
    found = whole.select(inputs=(*COMMANDED, *forces, *disturbances_of(whole)), outputs=outputs)
    if not forces:
        return found
    every = [one.name for one in placed_actuators(parameters)]
    force = np.zeros((len(every), placed.forces))
    force[[every.index(port.name) for port in placed.actuators], np.arange(placed.forces)] = placed.units
    return transform(found, inputs={ACTUATOR_FORCE: (force, Port(ACTUATOR_FORCE, placed.forces, "N"))})


__all__ = ["loop_plant"]
