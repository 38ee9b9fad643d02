"""The continuous plant of the loop, with the sensors and actuators of the telescope's file that the loop has."""

from __future__ import annotations

import numpy as np

from lftkit import Port, System, transform
from titop_plant.interface import COMMANDED, MEASURED, TRUTH_PORTS
from titop_plant.simulation.build import control_loop_plant
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import disturbances_of, with_sensors
from titop_plant.telescope.devices import ACTUATOR_FORCE
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope


def loop_plant(telescope: Telescope, ports: LoopPorts, *, isolated: bool = True) -> System:
    """The plant of a loop with some of the telescope's sensors and actuators.

    Parameters
    ----------
    telescope : Telescope
    ports : LoopPorts
        Rows that the loop has, with all further sensors of the telescope or none. Forces of further actuators stand
        behind the other commands, in units of their scale; readings behind the line of sight.
    isolated : bool
        Whether the payload is on its isolator.

    Returns
    -------
    System
        Of :func:`titop_plant.simulation.build.control_loop_plant` where the loop has no further rows.
    """
    if not ports.further:
        return control_loop_plant(telescope, isolated=isolated)
    whole = with_sensors(build_telescope(telescope, isolated=isolated, motors=True).system, telescope)
    driven = ports.further_actuators
    forces = (ACTUATOR_FORCE,) if driven else ()
    outputs = (*MEASURED, *(port.name for port in (*TRUTH_PORTS, *telescope.sensor_ports)))
    found = whole.select(inputs=(*COMMANDED, *forces, *disturbances_of(whole)), outputs=outputs)
    if not driven:
        return found
    every = [one.name for one in telescope.placed_actuators]
    force = np.zeros((len(every), len(driven)))
    for column, row in enumerate(driven):
        force[every.index(row.name), column] = row.scale
    return transform(found, inputs={ACTUATOR_FORCE: (force, Port(ACTUATOR_FORCE, len(driven), "N"))})


__all__ = ["loop_plant"]
