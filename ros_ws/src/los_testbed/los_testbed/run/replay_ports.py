"""Rows of the loop of a replay: those of the reference, and further ones of the bag's telescope that its laws use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.config.topics import COMMANDS, ISOLATOR_ACCEL, PLACED, SENSORS, actuator_topics, sensor_topics, shifted
from los_testbed.run.metadata import FURTHER_AUTHORITY
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import LoopLayout
from titop_plant.interface import COMMANDED, DT, K_FSM_OUTPUTS, MEASURED_PORTS
from titop_plant.sensors import Sensor
from titop_plant.telescope.actuators import Actuator
from titop_plant.telescope.loop_ports import REFERENCE_PORTS, LoopPorts


def rows_of(run: Run, law: SampledSystem) -> LoopPorts:
    """Rows that a controller reads and commands, from its ports and the limits in the bag.

    Parameters
    ----------
    run : Run
    law : SampledSystem
        Its further inputs are sensors, its further outputs actuators of the telescope's file.

    Raises
    ------
    BagError
        An actuator that was not commanded in the run: its limit is not in the bag.
    """
    of_loop = {port.name for port in K_FSM_OUTPUTS} | set(COMMANDED)
    unknown = [port for port in law.inputs if port.name not in {known.name for known in MEASURED_PORTS}]
    sensors = [_sensor(run, port) for port in unknown]
    actuators = [_actuator(run, port) for port in law.outputs if port.name not in of_loop]
    first = REFERENCE_PORTS
    return LoopPorts((*first.sensors, *sensors), (*first.actuators, *actuators))


def _sensor(run: Run, port: Port) -> Sensor:
    """Row of a sensor, at the rate of its topic in the bag."""
    topic, ticks = f"{PLACED}/{port.name}", 1
    stated = [sensor.rate for sensor in sensors_of(run) if sensor.topic == topic]
    if stated or (topic in run and len(run[topic]) > 1):
        ticks = max(1, round((1.0 / stated[0] if stated else run[topic].period) / DT))
    noise, bias = np.full((2, port.size), np.nan)
    return Sensor(port, noise, bias, ticks > 1, ticks)


def _actuator(run: Run, port: Port) -> Actuator:
    limits = run.parameters.get(FURTHER_AUTHORITY, {})
    if port.name not in limits:
        raise BagError(
            f"{run.path}: actuators of k_pma must be those that the run commanded, "
            f"{', '.join(limits) or 'none beside mirror and proof-mass actuators'}, got {port.name}"
        )
    return Actuator(port, float(limits[port.name]))


def layout_of(k_fsm: LoopPorts = REFERENCE_PORTS, k_pma: LoopPorts = REFERENCE_PORTS) -> LoopLayout:
    """Topics that observer and controller read and write.

    Parameters
    ----------
    k_fsm, k_pma : LoopPorts
        Rows of each.
    """
    rows = {sensor.name: sensor for ports in (k_fsm, k_pma) for sensor in ports.further_sensors}
    standard = sorted(SENSORS, key=lambda topic: topic.columns.start)
    behind = total_size(REFERENCE_PORTS.measured)
    further = [shifted(topic, behind) for topic in sensor_topics(tuple(rows.values()))]
    commands = *COMMANDS, *actuator_topics(k_pma.further_actuators)
    return LoopLayout(
        {topic.name: topic.columns for topic in (*standard, *further)},
        tuple(topic.name for topic in (*standard, *further) if topic.framed),
        (*(topic.name for topic in standard), *_names(k_fsm.further_sensors)),
        (ISOLATOR_ACCEL.name, *_names(k_pma.further_sensors)),
        {topic.name: topic.columns for topic in commands},
    )


def _names(sensors: Sequence[Sensor]) -> tuple[str, ...]:
    return tuple(topic.name for topic in sensor_topics(sensors))
