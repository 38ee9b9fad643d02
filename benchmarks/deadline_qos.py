"""What deadline and liveliness of the middleware cost at 1 kHz on nine topics, beside the same without them.

    python benchmarks/deadline_qos.py --seconds 4 --json

Nine publishers and nine best-effort readers in two participants of one process, as many messages as a run has. `none`
has neither; `deadline` is offered by the publishers (20 ms), in `deadline_both` the readers ask for it as well;
`liveliness` is a lease of 1 s that the middleware renews by itself. `publish_us` is the median time to publish the nine
messages of a tick, `processor` the share of one processor. The kinds take turns, so that all see the same machine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from statistics import median

import numpy as np
from los_testbed.bags.cdr import codec_for
from los_testbed.config.topics import TRUTH_LOS
from los_testbed.nodes.support.transport.middleware import choose_middleware
from los_testbed.nodes.support.transport.raw_topics import MESSAGES
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy

TOPICS, PERIOD_S, DEADLINE_MS, LEASE_MS = 9, 1e-3, 20, 1000
KINDS = "none", "deadline", "deadline_both", "liveliness"


def quality(kind: str, reader: bool) -> QoSProfile:
    """Quality of service of a publisher or a reader."""
    profile = QoSProfile(depth=100)
    if kind == "deadline_both" or (kind == "deadline" and not reader):
        profile.deadline = Duration(nanoseconds=DEADLINE_MS * 1_000_000)
    if kind == "liveliness" and not reader:
        profile.liveliness = LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(nanoseconds=LEASE_MS * 1_000_000)
    if reader:
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    return profile


def measure(kind: str, seconds: float, domain: int) -> dict[str, float]:
    """Times of one kind."""
    contexts = [Context(), Context()]
    for context in contexts:
        context.init(domain_id=domain)
    sender, receiver = (Node(name, context=c) for name, c in zip(("sender", "receiver"), contexts))
    message, data = MESSAGES[TRUTH_LOS.type_name], bytes(codec_for(TRUTH_LOS).encode(0, np.zeros(2)))
    outputs = [sender.create_publisher(message, f"t{i}", quality(kind, False)) for i in range(TOPICS)]
    inputs = [
        receiver.create_subscription(message, f"t{i}", lambda _: None, quality(kind, True), raw=True)
        for i in range(TOPICS)
    ]
    time.sleep(1.0)
    count, times = 0, []
    begin, used = time.monotonic(), time.process_time()
    for k in range(round(seconds / PERIOD_S)):
        time.sleep(max(0.0, begin + k * PERIOD_S - time.monotonic()))
        start = time.perf_counter()
        for output in outputs:
            output.publish(data)
        times.append(time.perf_counter() - start)
        for source in inputs:
            with source.handle:
                while source.handle.take_message(message, True):
                    count += 1
    share = (time.process_time() - used) / (time.monotonic() - begin)
    for node, context in zip((sender, receiver), contexts):
        node.destroy_node()
        context.shutdown()
    return {"publish_us": 1e6 * median(times), "processor": share, "received": count}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0, help="time of each kind (default 4)")
    parser.add_argument("--domain", type=int, default=89, help="ROS domain (default 89)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    choose_middleware(os.environ)
    found = {kind: measure(kind, args.seconds, args.domain) for kind in KINDS}
    if args.json:
        sys.stdout.write(json.dumps({"benchmark": "deadline_qos", **found}) + "\n")
        return
    for kind, row in found.items():
        sys.stdout.write(f"{kind:14s} {row['publish_us']:7.1f} us a tick, {100 * row['processor']:5.1f} % processor\n")


if __name__ == "__main__":
    main()
