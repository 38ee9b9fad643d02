"""Rows of the loop of a replay: those of the stored controllers, and the sensors and actuators of the bag."""

from __future__ import annotations

import numpy as np

from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.config.topics import PLACED, command_topics, sensor_topics
from los_testbed.run.metadata import AUTHORITY
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.recorded_sensors import RecordedSensor, sensors_of
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import LoopLayout
from titop_plant.interface import COMMANDED, DT, K_FSM_OUTPUTS, MEASURED
from titop_plant.sensors import MEASURED_SENSORS, Sensor, port_alone
from titop_plant.telescope.actuators import Actuator, reference_actuators
from titop_plant.telescope.loop_ports import LoopPorts


def recorded_ports(run: Run, *laws: SampledSystem) -> LoopPorts:
    """Rows of a recorded loop, in the order of the run.

    Parameters
    ----------
    run : Run
    laws : SampledSystem
        Inputs that the bag does not describe are sensors at places, too.

    Raises
    ------
    BagError
        An actuator that was not commanded in the run: its limit is not in the bag.
    """
    placed = [
        Port(sensor.topic.removeprefix(f"{PLACED}/"), _size(run, sensor), sensor.unit)
        for sensor in sensors_of(run)
        if sensor.topic.startswith(f"{PLACED}/")
    ]
    measured = {port.name: port for port in (*placed, *(port for law in laws for port in law.inputs))}
    measured |= {port.name: port for port in placed}
    limits = run.parameters.get(AUTHORITY, {})
    of_loop = {*COMMANDED, *(port.name for port in K_FSM_OUTPUTS)}
    commanded = {port.name: port for law in laws for port in law.outputs if port.name not in of_loop}
    if foreign := [name for name in commanded if name not in limits]:
        raise BagError(
            f"{run.path}: actuators of k_pma must be those that the run commanded, "
            f"{', '.join(limits) or 'none beside mirror and proof-mass actuators'}, got {', '.join(foreign)}"
        )
    driven = [commanded.get(name, Port(name, 1, "")) for name in limits]  # the bag states no units of commands
    beside = [_sensor(run, port) for name, port in measured.items() if name not in MEASURED]
    return LoopPorts(
        (*map(port_alone, MEASURED_SENSORS), *beside),
        (*reference_actuators(), *(Actuator(port, float(limits[port.name])) for port in driven)),
    )


def _size(run: Run, sensor: RecordedSensor) -> int:
    """How many values a sample has."""
    return len(sensor.noise) or int(run[sensor.topic].values.shape[1])


def _sensor(run: Run, port: Port) -> Sensor:
    """Row of a sensor, at the rate of its topic in the bag."""
    topic, ticks = f"{PLACED}/{port.name}", 1
    stated = [sensor.rate for sensor in sensors_of(run) if sensor.topic == topic]
    if stated or (topic in run and len(run[topic]) > 1):
        ticks = max(1, round((1.0 / stated[0] if stated else run[topic].period) / DT))
    noise, bias = np.full((2, port.size), np.nan)
    return Sensor(port, noise, bias, ticks > 1, ticks)


def layout_of(k_fsm: LoopPorts, k_pma: LoopPorts) -> LoopLayout:
    """Topics that observer and controller read and write.

    Parameters
    ----------
    k_fsm, k_pma : LoopPorts
        Rows of each.
    """
    rows = {row.name: row for ports in (k_fsm, k_pma) for row in ports.sensors}
    topics = {topic.port: topic for topic in sensor_topics(tuple(rows.values()))}
    mirror = [row for row in reference_actuators() if row.name == COMMANDED[0]]
    return LoopLayout(
        {topic.name: topic.columns for topic in topics.values()},
        tuple(topic.name for topic in topics.values() if topic.framed),
        tuple(topics[row.name].name for row in k_fsm.sensors),
        tuple(topics[row.name].name for row in k_pma.sensors),
        {topic.name: topic.columns for topic in command_topics((*mirror, *k_pma.actuators))},
    )
