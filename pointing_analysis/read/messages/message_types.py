"""The ROS 2 message types of the testbed's recordings: names, definitions, numbers of values.

The definitions are those of ROS 2 Jazzy without comments. A bag carries them, so that any reader can decode it alone.
"""

from __future__ import annotations

ACCEL = "geometry_msgs/msg/AccelStamped"
VECTOR3 = "geometry_msgs/msg/Vector3Stamped"
JOINT_STATE = "sensor_msgs/msg/JointState"
HEADER = "std_msgs/msg/Header"
IMAGE = "sensor_msgs/msg/Image"
IMAGE_ENCODING = "mono16"
"""Of the pixels of an image: whole numbers of 16 bit, one channel."""

COLUMNS: dict[str, tuple[str, ...]] = {
    ACCEL: ("linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z"),
    VECTOR3: ("vector.x", "vector.y", "vector.z"),
    JOINT_STATE: ("effort",),
}
"""Names of the values of each type that can be read; a JointState has any number of efforts."""

UNITS = {ACCEL: "m/s2, rad/s2", VECTOR3: "rad", JOINT_STATE: "N"}

JOINT_NAMES = tuple(f"pma_{i}" for i in range(1, 7))
"""Names of the actuators in a JointState. Viewers label the efforts by them; PlotJuggler reads beyond the end of the
message if there are efforts and no names."""

SEPARATOR = "\n" + "=" * 80 + "\nMSG: "
"""Between a definition and those of the types it contains."""

TIME_DEFINITION = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
HEADER_DEFINITION = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_VECTOR3 = "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_ACCEL = "geometry_msgs/Accel\nVector3 linear\nVector3 angular\n"
_IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    "uint8[] data\n"
)
_JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"

DEFINITIONS = {
    ACCEL: SEPARATOR.join(
        ["std_msgs/Header header\nAccel accel\n", HEADER_DEFINITION, TIME_DEFINITION, _ACCEL, _VECTOR3]
    ),
    VECTOR3: SEPARATOR.join(["std_msgs/Header header\nVector3 vector\n", HEADER_DEFINITION, TIME_DEFINITION, _VECTOR3]),
    JOINT_STATE: SEPARATOR.join([_JOINT_STATE, HEADER_DEFINITION, TIME_DEFINITION]),
    IMAGE: SEPARATOR.join([_IMAGE, HEADER_DEFINITION, TIME_DEFINITION]),
}
"""Full ros2msg text of each type, dependencies included."""
