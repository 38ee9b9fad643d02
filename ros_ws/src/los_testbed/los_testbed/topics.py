"""The one table of topics: name, type, rate, frame, columns in the loop's vectors.

Everything that publishes, records, checks or documents a topic reads this table.
"""

from __future__ import annotations

from dataclasses import dataclass

from los_testbed.config import NAMESPACE
from pointing_analysis.read.messages.message_types import ACCEL, JOINT_STATE, VECTOR3
from titop_plant.interface import COLUMNS

NODES = ("plant", "estimator", "controller", "recorder")
"""Nodes of a run, in the order in which they are started."""

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
        Vector of the loop it carries: measurement, truth, los_estimate or command.
    columns : slice
        Columns of its values in that vector.
    rate : str
        ``tick`` (1 kHz) or ``camera`` (every frame).
    unit : str
        SI unit of the values.
    """

    name: str
    type_name: str
    frame_id: str
    publisher: str
    vector: str
    columns: slice
    rate: str = "tick"
    unit: str = "rad"

    @property
    def path(self) -> str:
        """Absolute name in the default namespace."""
        return self.path_in(NAMESPACE)

    def path_in(self, namespace: str) -> str:
        """Absolute name in a namespace."""
        return f"{namespace.rstrip('/')}/{self.name}"

    @property
    def size(self) -> int:
        """Number of values in a message."""
        return int(self.columns.stop) - int(self.columns.start)


ISOLATOR_ACCEL = TopicDefinition(
    "isolator/accel", ACCEL, "isolator_payload", "plant", "measurement", COLUMNS["accel_Ip"], unit="m/s2,rad/s2"
)
M1_ACCEL = TopicDefinition("m1/accel", ACCEL, "m1", "plant", "measurement", COLUMNS["accel_M1"], unit="m/s2,rad/s2")
M2_ACCEL = TopicDefinition("m2/accel", ACCEL, "m2", "plant", "measurement", COLUMNS["accel_M2"], unit="m/s2,rad/s2")
CAMERA_LOS = TopicDefinition(
    "camera/los", VECTOR3, "line_of_sight", "plant", "measurement", COLUMNS["camera_los"], rate="camera"
)
FSM_ANGLE = TopicDefinition("fsm/strain_gauge", VECTOR3, "fsm", "plant", "measurement", COLUMNS["fsm_angle"])
TRUTH_LOS = TopicDefinition("truth/los", VECTOR3, "line_of_sight", "plant", "truth", COLUMNS["los_controlled"])
LOS_ESTIMATE = TopicDefinition(
    "los_estimate", VECTOR3, "line_of_sight", "estimator", "los_estimate", COLUMNS["los_estimate"]
)
FSM_COMMAND = TopicDefinition("fsm/command", VECTOR3, "fsm", "controller", "command", COLUMNS["fsm_command"])
PMA_COMMAND = TopicDefinition(
    "pma/command", JOINT_STATE, "pma", "controller", "command", COLUMNS["pma_force"], unit="N"
)

SENSORS = (ISOLATOR_ACCEL, M1_ACCEL, M2_ACCEL, CAMERA_LOS, FSM_ANGLE)
"""Sent by the plant in this order; the strain gauge comes last and wakes the estimator."""

COMMANDS = (FSM_COMMAND, PMA_COMMAND)
"""Sent by the controller in this order: the faster loop first; the forces come last and close the tick."""

TOPICS = (*SENSORS, TRUTH_LOS, LOS_ESTIMATE, FSM_COMMAND, PMA_COMMAND)
"""Every topic that a bag holds, in the order of its channels."""

DEPTH = 100
"""Messages that a writer keeps for reliable readers: 0.1 s at the tick rate. A lost packet is asked for
again after the next heartbeat, 20 ms later; with the usual depth of 10 it would be gone by then. With 1000, a recorder
that was stopped for half a second made the plant send so much again that it missed 200 ticks."""

DIAGNOSTICS_TOPIC = "/diagnostics"
OWN_DIAGNOSTICS = "diagnostics"
"""Topic of one node, below its name: what it publishes on /diagnostics, where anybody publishes."""

PROGRESS_TOPIC = "recorder/progress"
"""Header whose stamp is the newest tick the recorder has of every topic (0: ready, nothing yet)."""
