"""Message definitions and type hashes that a bag carries, so that any reader can decode it alone.

The texts are the ROS 2 Jazzy definitions without comments; the hashes are theirs (REP-2016).
A test compares both with the installed message packages.
"""

from __future__ import annotations

from los_testbed.topics import ACCEL, DIAGNOSTICS, JOINT_STATE, VECTOR3

_SEPARATOR = "\n" + "=" * 80 + "\nMSG: "

_TIME = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_VECTOR3 = "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_ACCEL = "geometry_msgs/Accel\nVector3 linear\nVector3 angular\n"
_STATUS = (
    "diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n"
    "string name\nstring message\nstring hardware_id\nKeyValue[] values\n"
)
_KEY_VALUE = "diagnostic_msgs/KeyValue\nstring key\nstring value\n"

DEFINITIONS = {
    ACCEL: _SEPARATOR.join(
        ["std_msgs/Header header\nAccel accel\n", _HEADER, _TIME, _ACCEL, _VECTOR3],
    ),
    VECTOR3: _SEPARATOR.join(["std_msgs/Header header\nVector3 vector\n", _HEADER, _TIME, _VECTOR3]),
    JOINT_STATE: _SEPARATOR.join(
        [
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
            _HEADER,
            _TIME,
        ]
    ),
    DIAGNOSTICS: _SEPARATOR.join(
        ["std_msgs/Header header\nDiagnosticStatus[] status\n", _HEADER, _TIME, _STATUS, _KEY_VALUE]
    ),
}
"""Full ros2msg text of each type, dependencies included."""

TYPE_HASHES = {
    ACCEL: "RIHS01_ef1df9eabae0a708cc049a061ebcddc4e2a5f745730100ba680e086a9698b165",
    VECTOR3: "RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
    JOINT_STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""Type description hash of each type."""
