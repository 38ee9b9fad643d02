"""ROS 2 nodes: deserialise messages, step plant, observer or controller, serialise the outputs."""

from __future__ import annotations

import os
import sys

from los_testbed.run.processes.ros_variables import check_layer

try:
    check_layer(os.environ)  # on import rclpy would end the process with its own exit code and message
except ValueError as error:
    sys.stderr.write(f"los_testbed: {error}\n")
    raise SystemExit(2) from None
