"""Blocks of the sensors and actuators at places of the telescope, and their connections."""

from __future__ import annotations

import numpy as np

from lftkit import Connection, Port, System, static_gain, transform
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.sensors import SensorMount
from titop_plant.telescope.actuators import ActuatorMount
from titop_plant.telescope.places import body_of
from titop_plant.telescope.telescope import Telescope

MOTOR = "pma_force"
"""Input of the block of a proof-mass actuator."""


def actuator_wrenches(telescope: Telescope, *, driven: bool) -> list[tuple[str, str]]:
    """Signal of the wrench of each actuator at a place, and the node on which it acts."""
    return [(f"{_block(name)}.wrench_{node}", node) for name, node, _ in _actuators(telescope, driven)]


def actuator_block(mount: ActuatorMount, node: str) -> System:
    """An actuator: its command and, of a proof mass, the motion of its node to ``wrench_<node>``."""
    table = mount.table
    if table is None:
        return static_gain(mount.wrench[:, None], [Port(MOTOR, 1, "Nm" if mount.torque else "N")], [ports.wrench(node)])
    data = ProofMassActuator(
        table.moving_mass, table.casing_mass, np.diag(table.inertia), table.stiffness, table.damping
    )
    block = proof_mass_actuator(data).select(outputs=["wrench_P"])
    return mounted(block, "P", node, position=mount.position, dcm=spin_frame(mount.axis))


def actuator_blocks(telescope: Telescope, *, driven: bool) -> dict[str, System]:
    """A block for each actuator; where they are driven, with an input of the actuator's name."""
    blocks = {}
    for name, node, mount in _actuators(telescope, driven):
        block = actuator_block(mount, node)
        motor = block.input_port(MOTOR)
        if driven:
            # a positive force of the port is on the structure, that of a motor on its mass
            sign = np.full((1, 1), 1.0 if mount.table is None else -1.0)
            blocks[_block(name)] = transform(block, inputs={MOTOR: (sign, Port(name, 1, motor.unit))})
        else:
            blocks[_block(name)] = block.select(inputs=[p.name for p in block.inputs if p.name != MOTOR])
    return blocks


def actuator_wires(telescope: Telescope, *, driven: bool) -> list[Connection]:
    """Motion of the nodes to the actuators, and their commands where they are driven."""
    wires: list[Connection] = []
    for name, node, mount in _actuators(telescope, driven):
        if mount.table is not None:
            wires.append((_motion(node), f"{_block(name)}.accel_{node}"))
        if driven:
            wires.append((name, f"{_block(name)}.{name}"))
    return wires


def sensor_blocks(telescope: Telescope) -> dict[str, System]:
    """Map from the accelerations of their nodes to the values of the sensors that measure them; empty without any."""
    mounts = _accelerometers(telescope)
    if not mounts:
        return {}
    at = list(dict.fromkeys(node for node, _, _ in mounts))
    values = [port for _, port, _ in mounts]
    gain = np.zeros((sum(port.size for port in values), 6 * len(at)))
    row = 0
    for node, port, mount in mounts:
        first = 6 * at.index(node)
        gain[row : row + port.size, first : first + 6] = mount.rows
        row += port.size
    return {"sensors": static_gain(gain, [ports.accel(node) for node in at], values)}


def sensor_outputs(telescope: Telescope) -> dict[str, str]:
    """Signals of the sensors that measure accelerations, by their names."""
    return {port.name: f"sensors.{port.name}" for _, port, _ in _accelerometers(telescope)}


def sensor_wires(telescope: Telescope) -> list[Connection]:
    """Motion of the nodes to what makes the values of the sensors."""
    at = dict.fromkeys(node for node, _, _ in _accelerometers(telescope))
    return [(_motion(node), f"sensors.accel_{node}") for node in at]


def _block(name: str) -> str:
    """Name of the block of an actuator: that of the actuator may be the name of another block."""
    return f"actuator_{name}"


def _actuators(telescope: Telescope, driven: bool) -> list[tuple[str, str, ActuatorMount]]:
    """Name, node and mount of each actuator, of those that are not driven the ones with a mass."""
    with_mount = [(one.name, one.mount) for one in telescope.placed_actuators if one.mount is not None]
    return [
        (name, telescope.node_at(mount.place), mount) for name, mount in with_mount if driven or mount.table is not None
    ]


def _accelerometers(telescope: Telescope) -> list[tuple[str, Port, SensorMount]]:
    """Node, port and mount of each sensor that measures the acceleration of its node."""
    mounts = [(sensor.port, sensor.mount) for sensor in telescope.placed_sensors if sensor.mount is not None]
    return [(telescope.node_at(mount.place), port, mount) for port, mount in mounts if mount.accelerates]


def _motion(node: str) -> str:
    """Signal of the acceleration of a node."""
    return f"accel_{node}" if node == "G" else f"{body_of(node)}.accel_{node}"
