"""A plant of a user in plain rclpy: message objects, stamps of acquisition beside the grid, a camera with read-out.

    python plain_plant.py DOMAIN TICKS      prints a JSON object when it is over

A tick begins when the command of the one before has come, or after ten seconds: what is tried is what the loop does
with the stamps, not how fast it is. Of each ten frames of the camera the fifth is lost; the others come 7 ticks late.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped, Vector3Stamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

MS = 1_000_000
OFFSET_NS, JITTER_NS, FRAME_TICKS, READ_OUT_TICKS = 300_000, 80_000, 20, 7


class PlainPlant(Node):
    """Publishers of the sensors, and what came back."""

    def __init__(self) -> None:
        super().__init__("plant", namespace="/telescope")
        self.accelerations = [self.create_publisher(AccelStamped, f"{n}/accel", 100) for n in ("isolator", "m1", "m2")]
        self.gauge = self.create_publisher(Vector3Stamped, "fsm/strain_gauge", 100)
        self.camera = self.create_publisher(Vector3Stamped, "camera/los", 100)
        self.answered: dict[str, set[int]] = {"fsm": set(), "pma": set()}
        self.angles: dict[int, float] = {}
        self.create_subscription(Vector3Stamped, "fsm/command", lambda m: self.take("fsm", m), 100)
        self.create_subscription(JointState, "pma/command", lambda m: self.take("pma", m), 100)
        self.reports: dict[str, str] = {}
        self.create_subscription(DiagnosticArray, "estimator/diagnostics", self.hear, 100)
        self.random = np.random.default_rng(1)

    def take(self, name: str, message: Vector3Stamped | JointState) -> None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        self.answered[name].add(stamp)
        if name == "fsm":
            self.angles[stamp] = message.vector.x

    def hear(self, message: DiagnosticArray) -> None:
        self.reports |= {pair.key: pair.value for status in message.status for pair in status.values}

    def send(self, tick: int) -> None:
        """The samples of a tick; the one that wakes the estimator last."""
        acquired = tick * MS + OFFSET_NS + int(self.random.integers(-JITTER_NS, JITTER_NS))
        frame, late = divmod(tick, FRAME_TICKS)
        if late == READ_OUT_TICKS and frame % 10 != 5:
            self.camera.publish(stamped(Vector3Stamped(), frame * FRAME_TICKS * MS, 1e-5))
        self.gauge.publish(stamped(Vector3Stamped(), acquired, 0.0))
        for publisher in self.accelerations:
            publisher.publish(stamped(AccelStamped(), acquired))

    def tick(self, number: int, timeout: float = 10.0) -> bool:
        self.send(number)
        end = time.monotonic() + timeout
        while not all(number * MS in stamps for stamps in self.answered.values()) and time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.05)
        return all(number * MS in stamps for stamps in self.answered.values())


def stamped(message, stamp: int, x: float = 0.0):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    if isinstance(message, Vector3Stamped):
        message.vector.x = x
    return message


def main() -> None:
    domain, ticks = int(sys.argv[1]), int(sys.argv[2])
    rclpy.init(domain_id=domain)
    plant = PlainPlant()
    first, end = 1_000_000, time.monotonic() + 60
    while not plant.tick(first, 0.3) and time.monotonic() < end:  # until the nodes have found each other
        first += 1
    answered = [plant.tick(k) for k in range(first + 1, first + 1 + ticks)]
    heard, end = "ticks", time.monotonic() + 10
    while int(plant.reports.get(heard, "0")) < ticks and time.monotonic() < end:
        rclpy.spin_once(plant, timeout_sec=0.1)
    angles = [plant.angles[k] for k in sorted(plant.angles)]
    told = {"answered": sum(answered), "reports": plant.reports, "angle": angles[-1] if angles else None}
    sys.stdout.write(json.dumps(told) + "\n")
    plant.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
