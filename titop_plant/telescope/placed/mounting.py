"""Blocks of the further sensors and actuators in the assembled telescope, and their connections."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lftkit import Connection, Port, System, static_gain
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.telescope.devices import ACTUATOR_FORCE, PlacedActuator
from titop_plant.telescope.places import body_of
from titop_plant.telescope.telescope import Telescope

MOTOR = "pma_force"
"""Input of the block of a proof-mass actuator."""


def actuator_wrenches(telescope: Telescope) -> list[tuple[str, str]]:
    """Signal of the wrench of each further actuator, and the node on which it acts."""
    found = [(one.name, telescope.node_at(one.place)) for one in telescope.placed_actuators]
    return [(f"{name}.wrench_{node}", node) for name, node in found]


def actuator_block(actuator: PlacedActuator, node: str) -> System:
    """A further actuator, driven by the motion of its node: ``accel_<node>`` -> ``wrench_<node>``."""
    table = actuator.table
    data = ProofMassActuator(
        table.moving_mass, table.casing_mass, np.diag(table.inertia), table.stiffness, table.damping
    )
    block = proof_mass_actuator(data).select(outputs=["wrench_P"])
    return mounted(block, "P", node, position=actuator.position, dcm=spin_frame(actuator.axis))


def actuator_blocks(telescope: Telescope, *, driven: bool) -> dict[str, System]:
    """The actuators by name, and what parts the input `ACTUATOR_FORCE` where they are driven."""
    actuators = telescope.placed_actuators
    blocks = {one.name: actuator_block(one, telescope.node_at(one.place)) for one in actuators}
    if not (driven and actuators):
        return {
            name: block.select(inputs=[p.name for p in block.inputs if p.name != MOTOR])
            for name, block in blocks.items()
        }
    forces = [Port(one.name, 1, "N") for one in actuators]
    on_masses = -np.eye(len(forces))  # a positive force of the port is on the structure
    return {**blocks, "actuator_split": static_gain(on_masses, telescope.actuator_ports, forces)}


def actuator_wires(telescope: Telescope, systems: Mapping[str, System]) -> list[Connection]:
    """Motion of the nodes to the actuators, and their forces where they are driven."""
    wires: list[Connection] = []
    for one in telescope.placed_actuators:
        node = telescope.node_at(one.place)
        wires.append((_motion(node), f"{one.name}.accel_{node}"))
        if "actuator_split" in systems:
            wires.append((f"actuator_split.{one.name}", f"{one.name}.{MOTOR}"))
    return [*wires, (ACTUATOR_FORCE, f"actuator_split.{ACTUATOR_FORCE}")] if "actuator_split" in systems else wires


def sensor_blocks(telescope: Telescope) -> dict[str, System]:
    """What makes the values of the further sensors from the twists of their nodes; nothing without any."""
    sensors = telescope.placed_sensors
    if not sensors:
        return {}
    at = list(dict.fromkeys(telescope.node_at(one.place) for one in sensors))
    gain = np.zeros((sum(len(one.axes) for one in sensors), 6 * len(at)))
    row = 0
    for one in sensors:
        first = 6 * at.index(telescope.node_at(one.place))
        gain[row : row + len(one.axes), first : first + 6] = one.rows
        row += len(one.axes)
    return {"sensors": static_gain(gain, [ports.accel(node) for node in at], telescope.sensor_ports)}


def sensor_wires(telescope: Telescope) -> list[Connection]:
    """Motion of the nodes to what makes the values of the sensors."""
    at = dict.fromkeys(telescope.node_at(one.place) for one in telescope.placed_sensors)
    return [(_motion(node), f"sensors.accel_{node}") for node in at]


def _motion(node: str) -> str:
    """Signal of the acceleration of a node."""
    return f"accel_{node}" if node == "G" else f"{body_of(node)}.accel_{node}"
