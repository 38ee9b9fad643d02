"""Table of the topics: name, type, rate, frame, columns in the loop's vectors.

Everything that publishes, records, checks or documents a topic reads this table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from lftkit.systems.ports import port_slices
from los_testbed.config.run_config import NAMESPACE
from pointing_analysis.read.messages.message_types import ACCEL, IMAGE, JOINT_STATE, VECTOR3
from titop_plant.interface import COLUMNS
from titop_plant.sensors import CAMERA_PORT, GAUGE_PORT, MEASURED_SENSORS, PLATFORM_PORT, SensorEntry

if TYPE_CHECKING:
    from titop_plant.sensors import Sensor
    from titop_plant.telescope.actuators import Actuator

NODES = ("plant", "estimator", "controller", "recorder")
"""Nodes of a run, in the order in which they are started."""

BOTH_LAWS = "estimator_controller"
"""Program with estimator and controller in one process."""

IMAGE_VECTOR = "image"
"""Vector of the pixels of a frame, row by row."""

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True)
class TopicDefinition:
    """One stream of messages of the loop.

    Parameters
    ----------
    name : str
        Relative to the namespace, by default ``/telescope``.
    type_name : str
        ROS message type.
    frame_id : str
        What the header carries.
    publisher : str
        Node that sends it: plant, estimator or controller.
    vector : str
        Vector of the loop it carries: measurement, truth, los_estimate or command; image.
    columns : slice
        Columns of its values in that vector.
    port : str
        Name of its port.
    framed : bool
        Whether it has messages at some ticks only; a sample of it may be lost (NaN).
    unit : str
        SI unit of the values.
    """

    name: str
    type_name: str
    frame_id: str
    publisher: str
    vector: str
    columns: slice
    port: str
    unit: str = "rad"
    framed: bool = False

    @property
    def path(self) -> str:
        """Absolute name in the default namespace."""
        return self.path_in(NAMESPACE)

    def path_in(self, namespace: str) -> str:
        """Absolute name in a namespace."""
        return f"{namespace.rstrip('/')}/{self.name}"

    def every(self, ticks: Mapping[str, int]) -> int:
        """Ticks from one message to the next, by those of the sensors (`LoopPorts.ticks`)."""
        return ticks.get(self.port, 1)

    @property
    def size(self) -> int:
        """Number of values in a message."""
        return int(self.columns.stop) - int(self.columns.start)


def _topic(name: str, type_name: str, frame_id: str, publisher: str, vector: str, port: str) -> TopicDefinition:
    return TopicDefinition(name, type_name, frame_id, publisher, vector, COLUMNS[port], port)


def _of_sensor(entry: SensorEntry) -> TopicDefinition:
    """Topic of a sensor: a twist or a vector."""
    port, units = entry.port, ",".join(dict.fromkeys(entry.port.unit.split(",")))
    kind = VECTOR3 if port.size <= 3 else ACCEL
    columns = COLUMNS[port.name]
    return TopicDefinition(
        entry.topic, kind, entry.frame_id, "plant", "measurement", columns, port.name, units, entry.framed
    )


_BY_PORT = {entry.port.name: _of_sensor(entry) for entry in MEASURED_SENSORS}
_WAKES = [entry.port.name for entry in MEASURED_SENSORS if not entry.framed][-1]

SENSORS = (*(topic for port, topic in _BY_PORT.items() if port != _WAKES), _BY_PORT[_WAKES])
"""Sent by the plant in this order; one that comes at every tick is the last and wakes the estimator."""

ISOLATOR_ACCEL, CAMERA_LOS, FSM_ANGLE = (_BY_PORT[port] for port in (PLATFORM_PORT, CAMERA_PORT, GAUGE_PORT))
TRUTH_LOS = _topic("truth/los", VECTOR3, "line_of_sight", "plant", "truth", "los_controlled")
LOS_ESTIMATE = _topic("los_estimate", VECTOR3, "line_of_sight", "estimator", "los_estimate", "los_estimate")
FSM_COMMAND = _topic("fsm/command", VECTOR3, "fsm", "controller", "command", "fsm_command")
PMA_COMMAND = replace(_topic("pma/command", JOINT_STATE, "pma", "controller", "command", "pma_force"), unit="N")

COMMAND_TOPICS = (FSM_COMMAND, PMA_COMMAND)
"""Sent by the controller in this order: the faster loop first; the forces come last and close the tick."""

TOPICS = (*SENSORS, TRUTH_LOS, LOS_ESTIMATE, FSM_COMMAND, PMA_COMMAND)
"""Every topic that a bag holds, in the order of its channels."""

IMAGE_NAME = "camera/image"
"""Topic of the frames of a camera that takes images, with the stamp of the angles that they give."""


def image_topic(window: int) -> TopicDefinition:
    """Topic of the frames; a bag with it has it last.

    Parameters
    ----------
    window : int
        Pixels along each axis.
    """
    columns = slice(0, window**2)
    return TopicDefinition(IMAGE_NAME, IMAGE, "guide_camera", "plant", IMAGE_VECTOR, columns, CAMERA_PORT, "e-", True)


BUNDLES = {"plant": "loop/measurements", "controller": "loop/commands"}
"""Topic, by its node, of one message with all samples or all commands of a tick; a bag has it not: the topics of the
table hold the same."""

PLACED, DRIVEN = "sensor", "actuator"
"""Sensors and actuators at places have their topics below these names."""


def sensor_topics(sensors: Sequence[Sensor]) -> tuple[TopicDefinition, ...]:
    """Topics of sensors, in their order, with their columns in the vector of all their values.

    Parameters
    ----------
    sensors : sequence of Sensor
    """
    topics = []
    for one, columns in zip(sensors, port_slices(row.port for row in sensors).values(), strict=True):
        known = _BY_PORT.get(one.name)
        if known is None:
            known = _placed_sensor(one.name, columns, one.port.unit)
        topics.append(replace(known, columns=columns, framed=one.framed))
    return tuple(topics)


def command_topics(actuators: Sequence[Actuator]) -> tuple[TopicDefinition, ...]:
    """Topics of the commands of actuators, in their order, with their columns in the vector of all their values.

    Parameters
    ----------
    actuators : sequence of Actuator
    """
    topics = []
    for one, columns in zip(actuators, port_slices(row.port for row in actuators).values(), strict=True):
        known = next((topic for topic in COMMAND_TOPICS if topic.port == one.name), None)
        topics.append(_placed_actuator(one.name, columns, one.port.unit) if known is None else known)
    return tuple(topics)


def placed_topics(sizes: Mapping[str, int]) -> tuple[TopicDefinition, ...]:
    """Topics of sensors and actuators at places among those of a bag.

    Parameters
    ----------
    sizes : mapping of str to int
        Values of each topic, named without namespace.
    """
    topics = []
    for name, size in sizes.items():
        match name.split("/"):
            case [group, sensor] if group == PLACED:
                topics.append(_placed_sensor(sensor, slice(0, size)))
            case [group, actuator, "command"] if group == DRIVEN:
                topics.append(_placed_actuator(actuator, slice(0, size)))
    return tuple(topics)


def _placed_sensor(name: str, columns: slice, unit: str = "") -> TopicDefinition:
    return TopicDefinition(f"{PLACED}/{name}", VECTOR3, name, "plant", "measurement", columns, name, unit)


def _placed_actuator(name: str, columns: slice, unit: str = "") -> TopicDefinition:
    return TopicDefinition(f"{DRIVEN}/{name}/command", VECTOR3, name, "controller", "command", columns, name, unit)


DEPTH = 100
"""Messages that a writer keeps for reliable readers: 0.1 s at the tick rate. A lost packet is asked for
again after the next heartbeat, 20 ms later; with the usual depth of 10 it would be lost. With 1000, a recorder that
was stopped for half a second made the plant resend so much that it missed 200 ticks."""

DIAGNOSTICS_TOPIC = "/diagnostics"
OWN_DIAGNOSTICS = "diagnostics"
"""Topic of one node, below its name: its messages on /diagnostics, which any node may publish."""

REPORT_DEADLINE_S = 3.0
"""A node reports once a second on its own topic; the recorder counts longer intervals [s]."""

LATE_REPORTS, LIVELINESS_LOST = "late_reports_", "liveliness_lost_"
"""Names of these counts in the statistics of the recorder, with the node behind."""

UNSENT_TICKS = "ticks"
"""Suffix of :data:`~pointing_analysis.read.unsent.UNSENT` in the plant's count of lost periods between samples; of
a topic that does not come at every tick its name is."""

PROGRESS_TOPIC = "recorder/progress"
"""Header whose stamp is the newest tick the recorder has of every topic (0: ready, nothing yet)."""
