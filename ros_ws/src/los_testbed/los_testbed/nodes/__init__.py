"""ROS 2 nodes: messages to arrays, one step of the plant, the observer or the controller, arrays to messages."""

from __future__ import annotations

import os
import sys

from los_testbed.run.processes.ros_variables import check_layer

try:
    check_layer(os.environ)  # rclpy ends the process where it is imported, with a code and words of its own
except ValueError as error:
    sys.stderr.write(f"los_testbed: {error}\n")
    raise SystemExit(2) from None
