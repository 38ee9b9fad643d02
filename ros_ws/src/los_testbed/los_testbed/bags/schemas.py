"""Message definitions and type hashes (REP-2016) of a bag; a test compares them with the installed packages."""

from __future__ import annotations

from los_testbed.config.topics import DIAGNOSTICS
from pointing_analysis.read.messages import message_types
from pointing_analysis.read.messages.message_types import ACCEL, IMAGE, JOINT_STATE, VECTOR3

_STATUS = (
    "diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n"
    "string name\nstring message\nstring hardware_id\nKeyValue[] values\n"
)
_KEY_VALUE = "diagnostic_msgs/KeyValue\nstring key\nstring value\n"

DEFINITIONS = {
    **message_types.DEFINITIONS,
    DIAGNOSTICS: message_types.SEPARATOR.join(
        [
            "std_msgs/Header header\nDiagnosticStatus[] status\n",
            message_types.HEADER_DEFINITION,
            message_types.TIME_DEFINITION,
            _STATUS,
            _KEY_VALUE,
        ]
    ),
}
"""Full ros2msg text of each type, dependencies included."""

TYPE_HASHES = {
    ACCEL: "RIHS01_ef1df9eabae0a708cc049a061ebcddc4e2a5f745730100ba680e086a9698b165",
    VECTOR3: "RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
    JOINT_STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    IMAGE: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""Type description hash of each type."""
