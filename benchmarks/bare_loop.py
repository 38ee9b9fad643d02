"""What the machine allows: a loop on each processor, at real-time priority, that only waits for its deadlines of 1 ms.

    python benchmarks/bare_loop.py --seconds 15 --json
    python benchmarks/bare_loop.py --seconds 15 --histogram    # where it is installed, cyclictest (rt-tests) beside it

No ROS, no communication, no computation: what is late here is late by the kernel or by the host of a virtual machine.
"""

from __future__ import annotations

import argparse
import bisect
import json
import os
import shutil
import subprocess
import sys
import time
from typing import Any

import numpy as np
from los_testbed.run.loop.scheduling import PRIORITIES, become_real_time, disable_idle_states, sharpen_timers
from los_testbed.run.loop.tick_clock import TickClock

from titop_plant.interface import TICK_NS

EDGES_US = (5, 10, 20, 50, 100, 200, 300, 500, 1000, 2000, 5000, 10000)
"""Upper bounds of the cells of a histogram; the last cell has what is beyond."""
LIMITS_US = (300, 1000)
"""Lateness that is counted [us]: a tick of the testbed has about 0.7 ms to spare for being late, and then 0."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="length (default 15)")
    parser.add_argument("--processor", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--histogram", action="store_true", help="a table of all latenesses, with that of cyclictest")
    args = parser.parse_args()
    if args.processor is not None:
        print(json.dumps(wait_only(args.seconds, args.processor)))
        return
    found = bare_loops(args.seconds)
    if args.histogram:
        columns = {"loop": np.sum([loop["histogram"] for loop in found], axis=0).tolist()}
        if shutil.which("cyclictest"):
            columns["cyclictest"] = cyclictest(args.seconds)
        print(json.dumps({"edges_us": EDGES_US, **columns}) if args.json else histogram(columns))
        return
    print(json.dumps({"processors": found}) if args.json else sentence(found))


def wait_only(seconds: float, processor: int) -> dict[str, Any]:
    """One loop in this process; counts of late ticks and the largest lateness."""
    sharpen_timers()
    disable_idle_states()
    refused = become_real_time(PRIORITIES["plant"], processor)
    clock, late, largest, ticks = TickClock(TICK_NS), dict.fromkeys(LIMITS_US, 0), 0, 0
    cells = [0] * (len(EDGES_US) + 1)
    clock.begin(time.monotonic_ns() + TICK_NS)
    while ticks + clock.skipped < 1000 * seconds:
        lateness = clock.wait()
        ticks += 1
        largest = max(largest, lateness)
        cells[bisect.bisect_left(EDGES_US, lateness / 1000)] += 1
        for limit in LIMITS_US:
            late[limit] += lateness > 1000 * limit
    return {
        "ticks": ticks + clock.skipped,
        "skipped_periods": clock.skipped,
        **{f"late_{limit}_us": late[limit] + clock.skipped for limit in LIMITS_US},
        "largest_us": round(largest / 1000, 1),
        "histogram": cells,
        "refused": refused,
    }


def bare_loops(seconds: float) -> list[dict[str, Any]]:
    """One loop on each processor that this process may use, at the same time."""
    count = len(os.sched_getaffinity(0))
    command = [sys.executable, os.path.abspath(__file__), "--seconds", str(seconds), "--processor"]
    running = [subprocess.Popen([*command, str(i)], stdout=subprocess.PIPE, text=True) for i in range(count)]
    return [json.loads(process.communicate()[0]) for process in running]


def cyclictest(seconds: float) -> list[int]:
    """Latenesses of cyclictest with the same period and priority, a thread on each processor, in the same cells."""
    options = ["-q", "-m", f"-p{PRIORITIES['plant']}", f"-i{TICK_NS // 1000}", f"-D{max(1, round(seconds))}", "-S"]
    done = subprocess.run(["cyclictest", *options, f"-h{EDGES_US[-1] + 1}"], capture_output=True, text=True, check=True)
    cells = [0] * (len(EDGES_US) + 1)
    for line in done.stdout.splitlines():
        if line[:1].isdigit():
            lateness, *counts = map(int, line.split())
            cells[bisect.bisect_left(EDGES_US, lateness)] += sum(counts)
        elif line.startswith("# Histogram Overflows:"):
            cells[-1] += sum(map(int, line.partition(":")[2].split()))
    return cells


def histogram(columns: dict[str, list[int]]) -> str:
    """Cells as text, a line for each."""
    names = [*(f"to {edge} us" for edge in EDGES_US), "beyond"]
    heads = f"{'lateness':<14}" + "".join(f"{name:>12}" for name in columns)
    rows = (f"{name:<14}" + "".join(f"{cells[k]:>12}" for cells in columns.values()) for k, name in enumerate(names))
    return "\n".join([heads, *rows])


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
