"""A plain ROS node named estimator, in the place of that of a run: it sends zeros, and announces nothing."""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import Vector3Stamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class ZeroEstimator(Node):
    """An estimate of zero for each sample of the strain gauge."""

    def __init__(self) -> None:
        super().__init__("estimator", namespace="/telescope", automatically_declare_parameters_from_overrides=True)
        self._output = self.create_publisher(Vector3Stamped, "los_estimate", 1000)
        self.create_subscription(Vector3Stamped, "fsm/strain_gauge", self._answer, 1000)

    def _answer(self, sample: Vector3Stamped) -> None:
        answer = Vector3Stamped()
        answer.header.stamp = sample.header.stamp
        self._output.publish(answer)


if __name__ == "__main__":
    rclpy.init(args=sys.argv)
    try:
        rclpy.spin(ZeroEstimator())
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit(0)
