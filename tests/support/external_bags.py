"""Bags of other programs, written with rosbags: its serialiser shares nothing with ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000_123_456_789
STORE = get_typestore(Stores.ROS2_JAZZY)
CUSTOM = "my_msgs/msg/LosError"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint8 OK=1\nuint8 status\nstring[] notes\nfloat32 az\nfloat32 el # up\n", CUSTOM
    )
)


def _message(kind: str, stamp: int, a: float, b: float, i: int) -> Any:
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="f"
    )
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    if kind == "geometry_msgs/msg/PointStamped":
        return types[kind](header=header, point=point(x=a, y=b, z=0.5))
    if kind == "geometry_msgs/msg/Vector3":
        return types[kind](x=a, y=b, z=0.0)
    if kind == "geometry_msgs/msg/Vector3Stamped":
        return types[kind](header=header, vector=vector(x=a, y=b, z=0.0))
    if kind == "geometry_msgs/msg/TwistStamped":
        twist = types["geometry_msgs/msg/Twist"](linear=vector(x=9.0, y=9.0, z=9.0), angular=vector(x=a, y=b, z=0.0))
        return types[kind](header=header, twist=twist)
    if kind == "sensor_msgs/msg/Imu":
        nine = np.arange(9.0)
        turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        return types[kind](header, turn, nine, vector(x=a, y=b, z=7.0), nine, vector(x=1.0, y=2.0, z=3.0), nine)
    if kind == "std_msgs/msg/Float64MultiArray":
        return types[kind](types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), np.array([a, b]))
    if kind == CUSTOM:
        # notes of changing number and length: the place of the numbers changes from message to message
        return types[kind](header, 0, ["x" * (i % 5)] * (i % 3), np.float32(a), np.float32(b))
    if kind == "std_msgs/msg/String":
        return types[kind](data="text")
    raise AssertionError(kind)


def _attitude(kind: str, stamp: int, row: list[float]) -> Any:
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="f"
    )
    turn = types["geometry_msgs/msg/Quaternion"](*row)
    if kind == "sensor_msgs/msg/Imu":
        vector, nine = types["geometry_msgs/msg/Vector3"](x=9.0, y=8.0, z=7.0), np.arange(9.0)
        return types[kind](header, turn, nine, vector, nine, vector, nine)
    if kind == "geometry_msgs/msg/PoseStamped":
        return types[kind](
            header, types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), turn)
        )
    if kind == "geometry_msgs/msg/TransformStamped":
        moved = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0), turn)
        return types[kind](header, "camera", moved)
    return types[kind](*row)


def write_external(
    path: Path,
    topics: dict[str, tuple[str, ArrayLike]],
    rate: float,
    logged: ArrayLike | None = None,
    stamps: ArrayLike | None = None,
) -> Path:
    """Write a bag: topic -> (message type, samples (n, 2), of attitudes (n, 4)); `stamps` [ns], else on the grid."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, (kind, samples) in topics.items():
            connection = writer.add_connection(name, kind, typestore=STORE)
            for i, row in enumerate(np.asarray(samples, dtype=float).tolist()):
                stamp = START + i * round(1e9 / rate) if stamps is None else int(np.asarray(stamps)[i])
                time = stamp if logged is None else int(np.asarray(logged)[i])
                message = _attitude(kind, stamp, row) if len(row) == 4 else _message(kind, stamp, *row, i)
                data = STORE.serialize_cdr(message, kind)
                writer.write(connection, time, data)
    return path
