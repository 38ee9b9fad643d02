"""Blocks of the further sensors and actuators in the assembled telescope, and their connections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lftkit import Connection, Port, System, static_gain
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.telescope.placed.devices import (
    ACTUATOR_FORCE,
    PlacedActuator,
    actuator_ports,
    placed_actuators,
    placed_sensors,
    sensor_ports,
)
from titop_plant.telescope.placed.points import body_of, node_at

MOTOR = "pma_force"
"""Input of the block of a proof-mass actuator."""


def actuator_wrenches(parameters: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Signal of the wrench of each further actuator, and the node on which it acts."""
    found = [(one.name, node_at(one.place, parameters)) for one in placed_actuators(parameters)]
    return [(f"{name}.wrench_{node}", node) for name, node in found]


def actuator_block(actuator: PlacedActuator, node: str) -> System:
    """A further actuator, driven by the motion of its node: ``accel_<node>`` -> ``wrench_<node>``."""
    table = actuator.table
    data = ProofMassActuator(
        table["moving_mass"], table["casing_mass"], np.diag(table["inertia"]), table["stiffness"], table["damping"]
    )
    block = proof_mass_actuator(data).select(outputs=["wrench_P"])
    return mounted(block, "P", node, position=actuator.position, dcm=spin_frame(actuator.axis))


def actuator_blocks(parameters: Mapping[str, Any], *, driven: bool) -> dict[str, System]:
    """The actuators by name, and what parts the input `ACTUATOR_FORCE` where they are driven."""
    actuators = placed_actuators(parameters)
    blocks = {one.name: actuator_block(one, node_at(one.place, parameters)) for one in actuators}
    if not (driven and actuators):
        return {
            name: block.select(inputs=[p.name for p in block.inputs if p.name != MOTOR])
            for name, block in blocks.items()
        }
    forces = [Port(one.name, 1, "N") for one in actuators]
    on_masses = -np.eye(len(forces))  # a positive force of the port is on the structure
    return {**blocks, "actuator_split": static_gain(on_masses, actuator_ports(parameters), forces)}


def actuator_wires(parameters: Mapping[str, Any], systems: Mapping[str, System]) -> list[Connection]:
    """Motion of the nodes to the actuators, and their forces where they are driven."""
    wires: list[Connection] = []
    for one in placed_actuators(parameters):
        node = node_at(one.place, parameters)
        wires.append((_motion(node), f"{one.name}.accel_{node}"))
        if "actuator_split" in systems:
            wires.append((f"actuator_split.{one.name}", f"{one.name}.{MOTOR}"))
    return [*wires, (ACTUATOR_FORCE, f"actuator_split.{ACTUATOR_FORCE}")] if "actuator_split" in systems else wires


def sensor_blocks(parameters: Mapping[str, Any]) -> dict[str, System]:
    """What makes the values of the further sensors from the twists of their nodes; nothing without any."""
    sensors = placed_sensors(parameters)
    if not sensors:
        return {}
    at = list(dict.fromkeys(node_at(one.place, parameters) for one in sensors))
    gain = np.zeros((sum(len(one.axes) for one in sensors), 6 * len(at)))
    row = 0
    for one in sensors:
        first = 6 * at.index(node_at(one.place, parameters))
        gain[row : row + len(one.axes), first : first + 6] = one.rows
        row += len(one.axes)
    return {"sensors": static_gain(gain, [ports.accel(node) for node in at], sensor_ports(parameters))}


def sensor_wires(parameters: Mapping[str, Any]) -> list[Connection]:
    """Motion of the nodes to what makes the values of the sensors."""
    at = dict.fromkeys(node_at(one.place, parameters) for one in placed_sensors(parameters))
    return [(_motion(node), f"sensors.accel_{node}") for node in at]


def _motion(node: str) -> str:
    """Signal of the acceleration of a node."""
    return f"accel_{node}" if node == "G" else f"{body_of(node)}.accel_{node}"
