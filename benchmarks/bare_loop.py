"""What the machine allows: a loop on each processor, at real-time priority, that only waits for its deadlines of 1 ms.

    python benchmarks/bare_loop.py --seconds 15 --json

No ROS, no communication, no computation: what is late here is late by the kernel or by the host of a virtual machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any

from los_testbed.loop.scheduling import PRIORITIES, become_real_time, disable_idle_states, sharpen_timers
from los_testbed.loop.tick_clock import TickClock

from titop_plant.interface import TICK_NS

LIMITS_US = (300, 1000)
"""Lateness that is counted [us]: a tick of the testbed has about 0.7 ms to spare for being late, and then 0."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="length (default 15)")
    parser.add_argument("--processor", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    if args.processor is not None:
        print(json.dumps(wait_only(args.seconds, args.processor)))
        return
    found = bare_loops(args.seconds)
    print(json.dumps(found) if args.json else sentence(found))


def wait_only(seconds: float, processor: int) -> dict[str, Any]:
    """One loop in this process; counts of late ticks and the largest lateness."""
    sharpen_timers()
    disable_idle_states()
    refused = become_real_time(PRIORITIES["plant"], processor)
    clock, late, largest, ticks = TickClock(TICK_NS), dict.fromkeys(LIMITS_US, 0), 0, 0
    clock.begin(time.monotonic_ns() + TICK_NS)
    while ticks + clock.skipped < 1000 * seconds:
        lateness = clock.wait()
        ticks += 1
        largest = max(largest, lateness)
        for limit in LIMITS_US:
            late[limit] += lateness > 1000 * limit
    return {
        "ticks": ticks + clock.skipped,
        "skipped_periods": clock.skipped,
        **{f"late_{limit}_us": late[limit] + clock.skipped for limit in LIMITS_US},
        "largest_us": round(largest / 1000, 1),
        "refused": refused,
    }


def bare_loops(seconds: float) -> list[dict[str, Any]]:
    """One loop on each processor that this process may use, at the same time."""
    count = len(os.sched_getaffinity(0))
    command = [sys.executable, os.path.abspath(__file__), "--seconds", str(seconds), "--processor"]
    running = [subprocess.Popen([*command, str(i)], stdout=subprocess.PIPE, text=True) for i in range(count)]
    return [json.loads(process.communicate()[0]) for process in running]


def summed_shares(runs: list[list[dict[str, Any]]]) -> dict[str, float]:
    """Shares of late ticks, summed over the processors, mean of the runs; largest lateness [us]."""
    shares: dict[str, float] = {
        f"late_{limit}_us": sum(loop[f"late_{limit}_us"] / loop["ticks"] for loops in runs for loop in loops)
        / len(runs)
        for limit in LIMITS_US
    }
    return {**shares, "largest_us": max(loop["largest_us"] for loops in runs for loop in loops)}


def sentence(loops: list[dict[str, Any]]) -> str:
    """The result in words."""
    shares = summed_shares([loops])
    late = ", ".join(f"{100 * shares[f'late_{limit}_us']:.3g} % by more than {limit} us" for limit in LIMITS_US)
    return f"{len(loops)} processors: late {late} (summed over the processors), {shares['largest_us']:g} us at most"


if __name__ == "__main__":
    main()
