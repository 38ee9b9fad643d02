"""Reject an unprotected run if ROS security is requested.

The middleware of the Python wheels is built without it, and with the permissive strategy it would run
without protection after one line of warning.
"""

from __future__ import annotations

from pathlib import Path

from lftkit.errors import InputError
from los_testbed.run.processes.node_launch import security_is_asked_for

_MISSING = b"doesn't have the security libraries"


def refuse_missing_security() -> None:
    """Check the middleware that is loaded; to be called between ``rclpy.init`` and the first node.

    Raises
    ------
    ValueError
        ``ROS_SECURITY_ENABLE`` is true and the middleware cannot do it.
    """
    if not security_is_asked_for():
        return
    lines = [line for line in Path("/proc/self/maps").read_text().splitlines() if ".so" in line]
    libraries = {line.split(maxsplit=5)[-1] for line in lines}  # a path may hold spaces
    for library in sorted(libraries):
        name = Path(library).name
        if name.startswith("librmw_fastrtps_shared_cpp") and _MISSING in Path(library).read_bytes():
            raise InputError(
                "ROS_SECURITY_ENABLE must be unset with a middleware built without security, got true: use a ROS "
                "installation with SROS 2"
            )
