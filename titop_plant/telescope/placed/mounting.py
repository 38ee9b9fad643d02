"""Blocks of the further sensors and actuators in the assembled telescope, and their connections."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lftkit import Connection, Port, System, connect, static_gain
from lftkit.systems.ports import total_size
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.sensors import Sensor, SensorMount
from titop_plant.telescope.actuators import ActuatorMount
from titop_plant.telescope.devices import ACTUATOR_FORCE, PLACED_SENSORS
from titop_plant.telescope.places import body_of
from titop_plant.telescope.telescope import Telescope

MOTOR = "pma_force"
"""Input of the block of a proof-mass actuator."""


def actuator_wrenches(telescope: Telescope, *, driven: bool) -> list[tuple[str, str]]:
    """Signal of the wrench of each further actuator, and the node on which it acts."""
    return [(f"{name}.wrench_{node}", node) for name, node, _ in _actuators(telescope, driven)]


def actuator_block(mount: ActuatorMount, node: str) -> System:
    """A further actuator: its command and, of a proof mass, the motion of its node to ``wrench_<node>``."""
    table = mount.table
    if table is None:
        return static_gain(mount.wrench[:, None], [Port(MOTOR, 1, "Nm" if mount.torque else "N")], [ports.wrench(node)])
    data = ProofMassActuator(
        table.moving_mass, table.casing_mass, np.diag(table.inertia), table.stiffness, table.damping
    )
    block = proof_mass_actuator(data).select(outputs=["wrench_P"])
    return mounted(block, "P", node, position=mount.position, dcm=spin_frame(mount.axis))


def actuator_blocks(telescope: Telescope, *, driven: bool) -> dict[str, System]:
    """The actuators by name, and what parts the input `ACTUATOR_FORCE` where they are driven."""
    actuators = telescope.placed_actuators
    blocks = {name: actuator_block(mount, node) for name, node, mount in _actuators(telescope, driven)}
    if not (driven and actuators):
        return {
            name: block.select(inputs=[p.name for p in block.inputs if p.name != MOTOR])
            for name, block in blocks.items()
        }
    values = [one.port for one in actuators]
    # a positive force of the port is on the structure, that of a motor on its mass
    signs = [-1.0 if one.mount is not None and one.mount.table is not None else 1.0 for one in actuators]
    return {**blocks, "actuator_split": static_gain(np.diag(signs), telescope.actuator_ports, values)}


def actuator_wires(telescope: Telescope, systems: Mapping[str, System]) -> list[Connection]:
    """Motion of the nodes to the actuators, and their forces where they are driven."""
    wires: list[Connection] = []
    driven = "actuator_split" in systems
    for name, node, mount in _actuators(telescope, driven):
        if mount.table is not None:
            wires.append((_motion(node), f"{name}.accel_{node}"))
        if driven:
            wires.append((f"actuator_split.{name}", f"{name}.{MOTOR}"))
    return [*wires, (ACTUATOR_FORCE, f"actuator_split.{ACTUATOR_FORCE}")] if driven else wires


def sensor_blocks(telescope: Telescope) -> dict[str, System]:
    """Map from the accelerations of their nodes to the values of the sensors that measure them; empty without any."""
    mounts = _mounts(telescope)
    if not mounts:
        return {}
    at = list(dict.fromkeys(node for node, _ in mounts))
    (port,) = acceleration_ports(telescope)
    gain = np.zeros((port.size, 6 * len(at)))
    row = 0
    for node, mount in mounts:
        first = 6 * at.index(node)
        gain[row : row + len(mount.axes), first : first + 6] = mount.rows
        row += len(mount.axes)
    return {"sensors": static_gain(gain, [ports.accel(node) for node in at], [port])}


def acceleration_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Output with the values of the further sensors that measure accelerations; none where there are none."""
    units = [s.port.unit for s in telescope.placed_sensors if _accelerates(s) for _ in range(s.port.size)]
    return (Port(PLACED_SENSORS, len(units), ",".join(units)),) if units else ()


def with_placed_sensors(system: System, telescope: Telescope) -> System:
    """The telescope with the values of all further sensors, in the order of the file, at `PLACED_SENSORS`.

    Raises
    ------
    ValueError
        A plant of a file without an output that one of them measures.
    """
    sensors = telescope.placed_sensors
    if all(_accelerates(one) for one in sensors):
        return system
    sources = [_source(one) or PLACED_SENSORS for one in sensors]
    names = list(dict.fromkeys(sources))
    inputs = [system.output_port(name) for name in names]
    first = dict(zip(names, np.cumsum([0, *(port.size for port in inputs)]).tolist()))
    gain, row, seen = np.zeros((total_size(telescope.sensor_ports), total_size(inputs))), 0, 0
    for one, source in zip(sensors, sources):
        size, begin = one.port.size, first[source]
        rows = np.eye(size)
        if source == PLACED_SENSORS:
            begin, seen = begin + seen, seen + size
        elif one.mount is not None:
            rows = one.mount.rows
        gain[row : row + size, begin : begin + rows.shape[1]] = rows
        row += size
    block = static_gain(gain, inputs, telescope.sensor_ports)
    outputs: dict[str, str | tuple[str, ...]] = {port.name: f"telescope.{port.name}" for port in system.outputs}
    return connect(
        {"telescope": system, "sensors": block},
        [
            *((p.name, f"telescope.{p.name}") for p in system.inputs),
            *((f"telescope.{n}", f"sensors.{n}") for n in names),
        ],
        inputs=system.inputs,
        outputs={**outputs, PLACED_SENSORS: f"sensors.{PLACED_SENSORS}"},
    )


def _source(sensor: Sensor) -> str:
    return sensor.mount.source if sensor.mount is not None else ""


def _accelerates(sensor: Sensor) -> bool:
    return not _source(sensor)


def sensor_wires(telescope: Telescope) -> list[Connection]:
    """Motion of the nodes to what makes the values of the sensors."""
    at = dict.fromkeys(node for node, _ in _mounts(telescope))
    return [(_motion(node), f"sensors.accel_{node}") for node in at]


def _actuators(telescope: Telescope, driven: bool) -> list[tuple[str, str, ActuatorMount]]:
    """Name, node and mount of each further actuator, of those that are not driven the ones with a mass."""
    with_mount = [(one.name, one.mount) for one in telescope.placed_actuators if one.mount is not None]
    return [
        (name, telescope.node_at(mount.place), mount) for name, mount in with_mount if driven or mount.table is not None
    ]


def _mounts(telescope: Telescope) -> list[tuple[str, SensorMount]]:
    """Node and mount of each further sensor."""
    of_accelerations = filter(_accelerates, telescope.placed_sensors)
    mounts = [sensor.mount for sensor in of_accelerations if sensor.mount is not None]
    return [(telescope.node_at(mount.place), mount) for mount in mounts]


def _motion(node: str) -> str:
    """Signal of the acceleration of a node."""
    return f"accel_{node}" if node == "G" else f"{body_of(node)}.accel_{node}"
