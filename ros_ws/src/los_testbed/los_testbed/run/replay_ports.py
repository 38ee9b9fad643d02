"""Rows of the loop of a replay: those of the stored controllers, and the sensors and actuators of the bag."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.config.topics import PLACED, command_topics, sensor_topics
from los_testbed.run.metadata import AUTHORITY
from pointing_analysis.files.structured_text import is_number
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
        An actuator that was not commanded in the run: its limit is not in the bag; limits that are none.
    """
    described = {sensor.topic: sensor for sensor in sensors_of(run)}
    named = [(topic.removeprefix(f"{PLACED}/"), topic) for topic in described if topic.startswith(f"{PLACED}/")]
    placed = [
        Port(name, len(described[topic].noise) or run[topic].values.shape[1], described[topic].unit)
        for name, topic in named
        if name not in MEASURED
    ]
    known = {*MEASURED, *(port.name for port in placed)}
    others = {port.name: port for law in laws for port in law.inputs if port.name not in known}
    limits = run.parameters.get(AUTHORITY, {})
    if not isinstance(limits, dict) or not all(is_number(limit) and limit > 0.0 for limit in limits.values()):
        raise BagError(f"{run.path}: {AUTHORITY} must be positive limits by the names of actuators, got {limits!r}")
    of_loop = {*COMMANDED, *(port.name for port in K_FSM_OUTPUTS)}
    commanded = {port.name: port for law in laws for port in law.outputs if port.name not in of_loop}
    if foreign := [name for name in commanded if name not in limits]:
        raise BagError(
            f"{run.path}: actuators of k_pma must be those that the run commanded, "
            f"{', '.join(limits) or 'none beside mirror and proof-mass actuators'}, got {', '.join(foreign)}"
        )
    driven = [commanded.get(name, Port(name, 1, "")) for name in limits]  # the bag states no units of commands
    beside = [_sensor(run, port, described) for port in (*placed, *others.values())]
    return LoopPorts(
        (*map(port_alone, MEASURED_SENSORS), *beside),
        (*reference_actuators(), *(Actuator(port, float(limits[port.name])) for port in driven)),
    )


def _sensor(run: Run, port: Port, described: Mapping[str, RecordedSensor]) -> Sensor:
    """Row of a sensor, at the rate of its topic in the bag."""
    topic, period = f"{PLACED}/{port.name}", DT
    if topic in described:
        period = 1.0 / described[topic].rate
    elif topic in run and len(run[topic]) > 1:
        period = run[topic].period
    ticks = max(1, round(period / DT))
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
