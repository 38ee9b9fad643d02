"""Speed of lockstep runs beside the same messages between three processes that compute nothing.

    python benchmarks/lockstep.py --seconds 20 --json

`run` is a lockstep run with its recorder, `messages` the same topics with the same sizes and the testbed's own
publishers and readers, but without plant, observer, controller, checks and recorder: what three hops of the middleware
leave; `messages_real_time` are the same with the priorities and processors of a run in real time, which a lockstep run
does not take. All figures are simulated seconds per second; `microseconds` is the time of a tick.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from los_testbed.bags.cdr import codec_for, stamp_of
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import (
    COMMAND_TOPICS,
    FSM_COMMAND,
    ISOLATOR_ACCEL,
    LOS_ESTIMATE,
    PMA_COMMAND,
    SENSORS,
    TRUTH_LOS,
    TopicDefinition,
)
from los_testbed.run.loop.scheduling import CPU_INDEX, PRIORITIES, become_real_time
from los_testbed.run.processes.node_launch import environment
from los_testbed.run.runner import Runner

TICK_NS, WAIT_NS, WARM_UP = 1_000_000, 50_000_000, 500
FAST = tuple(topic for topic in SENSORS if not topic.framed)
ROLES: dict[str, tuple[tuple[TopicDefinition, ...], tuple[TopicDefinition, ...]]] = {
    "plant": (COMMAND_TOPICS, (*FAST, TRUTH_LOS)),
    "estimator": (FAST, (LOS_ESTIMATE,)),
    "controller": ((ISOLATOR_ACCEL, LOS_ESTIMATE), (FSM_COMMAND, PMA_COMMAND)),
}
"""Topics in and out; the last one in wakes the process."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time of each run (default 20)")
    parser.add_argument("--domain", type=int, default=88, help="ROS domain (default 88)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--role", choices=ROLES, help=argparse.SUPPRESS)
    parser.add_argument("--real-time", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role:
        print(json.dumps(messages_of(args.role, round(args.seconds * 1000), args.real_time)))
        return
    config = RunConfig(mode="lockstep", duration=args.seconds, domain=args.domain, wait_for_recorder=True)
    speeds = {"run": run(config), "messages": messages(config), "messages_real_time": messages(config, ["--real-time"])}
    result = {
        name: {"times_real_time": round(speed, 3), "microseconds": round(1000.0 / speed, 1)}
        for name, speed in speeds.items()
    }
    if args.json:
        print(json.dumps(result))
    else:
        for name, found in result.items():
            print(f"{name:18} {found['times_real_time']:6.2f} times real time, {found['microseconds']:6.1f} us a tick")


def run(config: RunConfig) -> float:
    """Simulated seconds per second of a run, from its first report of ticks to its last one."""
    seen: list[tuple[float, int]] = []
    with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as folder:
        Runner(replace(config, output=f"{folder}/bag"), lambda ticks: seen.append((time.monotonic(), ticks))).run()
    running = [entry for entry in seen if entry[1] >= WARM_UP]
    (begin, first), (end, last) = running[0], next(entry for entry in running if entry[1] == running[-1][1])
    return 1e-3 * (last - first) / (end - begin)


def messages(config: RunConfig, options: Sequence[str] = ()) -> float:
    """The same for the processes that only send and receive."""
    with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as folder:
        started = {
            role: subprocess.Popen(
                [sys.executable, __file__, "--seconds", str(config.duration), "--role", role, *options],
                env=environment(config.domain, Path(folder)),
                stdout=subprocess.PIPE,
            )
            for role in ROLES
        }
        answer, _ = started["plant"].communicate()
        for process in started.values():
            process.kill()
            process.wait()
    return float(json.loads(answer))


def messages_of(role: str, ticks: int, real_time: bool) -> float:
    """Send and receive as this node does; for the plant the simulated seconds per second."""
    from los_testbed.nodes.support.transport.middleware import choose_middleware

    choose_middleware(os.environ)
    import rclpy
    from los_testbed.nodes.support.transport.raw_topics import READER_DEPTH, RawPublisher, RawSubscription, Waiter
    from rclpy.node import Node

    rclpy.init()
    node = Node(role, namespace="/telescope")
    inputs, outputs = ROLES[role]
    readers = [RawSubscription(node, topic.name, topic.type_name, READER_DEPTH, True) for topic in inputs]
    writers = [(RawPublisher(node, t.name, t.type_name), codec_for(t), np.zeros(t.size)) for t in outputs]
    last = Waiter(node, readers[-1:])
    if real_time:
        become_real_time(PRIORITIES[role], CPU_INDEX[role])

    def answer(stamp: int) -> None:
        for publisher, codec, values in writers:
            publisher.publish(codec.encode(stamp, values))

    def newest() -> int:
        last.wait(WAIT_NS)
        stamp = -1
        for reader in readers:
            while (taken := reader.take()) is not None:
                stamp = stamp_of(taken[0])
        return stamp

    if role != "plant":
        while True:
            if (stamp := newest()) >= 0:
                answer(stamp)
    begin = 0.0
    for tick in range(1, ticks + WARM_UP):
        if tick == WARM_UP:
            begin = time.monotonic()
        answer(tick * TICK_NS)
        while newest() != tick * TICK_NS:
            if tick == 1:  # the others are not there yet
                answer(TICK_NS)
    return 1e-3 * ticks / (time.monotonic() - begin)


if __name__ == "__main__":
    main()
