"""Settings of the middleware (Fast DDS) for a process; to be chosen before rclpy starts.

Nodes use UDP, not shared memory: as fast for such small messages (measured), without its faults. A process that is
killed while it holds the lock of a segment blocks others, a health check delays a writer with a new or dead reader by
a third of a second, and files remain in /dev/shm.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from pathlib import Path

from los_testbed.run.processes.node_launch import (
    LAYER,
    LOCALHOST_VARIABLE,
    PROFILE_VARIABLES,
    RANGE_VARIABLE,
    TRANSPORT_VARIABLE,
)
from los_testbed.run.processes.ros_variables import LAYER_VARIABLE

_PROFILES = Path(__file__).with_name("profiles")
NETWORK_PROFILE = _PROFILES / "fastdds.xml"
LOCALHOST_PROFILE = _PROFILES / "fastdds_localhost.xml"
"""Times of discovery and resending; the second one also keeps discovery to this machine."""

WIDER_RANGES = (None, "SUBNET", "OFF", "SYSTEM_DEFAULT")
"""Ranges that the ROS layer does not take for ``LOCALHOST``, as it takes every value that it does not know."""


def choose_middleware(environment: MutableMapping[str, str]) -> None:
    """Set profile, transport and discovery range in `environment`; a profile of the user takes precedence.

    For the range ``LOCALHOST`` the ROS middleware layer adds shared memory to every participant, whatever the
    transport variable says. So that range is set by a profile, and the layer gets ``SUBNET``, which does not change
    the profile. The profile binds every socket to 127.0.0.1, so ``ROS_STATIC_PEERS`` has no effect with it.
    A middleware other than Fast DDS does not read the profile: its environment is not changed.
    """
    if not environment.get(LAYER_VARIABLE, LAYER).startswith(LAYER):
        return
    environment.setdefault(TRANSPORT_VARIABLE, "UDPv4")
    if any(variable in environment for variable in PROFILE_VARIABLES):
        return
    profile = NETWORK_PROFILE
    if environment.get(LOCALHOST_VARIABLE) == "1" or environment.get(RANGE_VARIABLE) not in WIDER_RANGES:
        profile = LOCALHOST_PROFILE
        environment[RANGE_VARIABLE] = "SUBNET"
        environment.pop(LOCALHOST_VARIABLE, None)
    environment.update(dict.fromkeys(PROFILE_VARIABLES, str(profile)))
