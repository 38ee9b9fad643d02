"""What the loop consists of: the ports of its response.

======== ================ ==== ======================================================
port     name             size content
======== ================ ==== ======================================================
input    disturbance      22   wheels (20) and drives (2), normalised by their weights
input    fsm_command      2    added to the command of the mirror [rad]
input    pma_force        6    added to the forces [N]
output   los_controlled   2    line of sight [rad]
output   fsm_command      2    applied by the mirror [rad]
output   pma_force        6    applied by the actuators [N]
======== ================ ==== ======================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from lftkit.systems.ports import Port, port_slices
from titop_plant.interface import COMMAND_PORTS, TRUTH_PORTS
from titop_plant.simulation.disturbances import CHANNELS

DISTURBANCE = "disturbance"
"""Name of the 22 normalised disturbances together."""

(LINE_OF_SIGHT,) = (port.name for port in TRUTH_PORTS)

INPUTS: Mapping[str, slice] = MappingProxyType(port_slices((Port(DISTURBANCE, CHANNELS), *COMMAND_PORTS)))
OUTPUTS: Mapping[str, slice] = MappingProxyType(port_slices((*TRUTH_PORTS, *COMMAND_PORTS)))
"""Columns and rows of each port in the response of the loop."""

ADDED = slice(INPUTS[DISTURBANCE].stop, INPUTS[COMMAND_PORTS[-1].name].stop)
APPLIED = slice(OUTPUTS[LINE_OF_SIGHT].stop, OUTPUTS[COMMAND_PORTS[-1].name].stop)
"""Columns and rows of all commands."""

__all__ = ["ADDED", "APPLIED", "DISTURBANCE", "INPUTS", "LINE_OF_SIGHT", "OUTPUTS"]
