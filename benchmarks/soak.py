"""A long run: the memory of each process must not grow, and no sample may be lost.

    python benchmarks/soak.py --minutes 10 --json

Resident memory of the four processes (locked, so what is resident is what is used) once a second. The slope is that
of a straight line through the means of twenty blocks after a fifth of the run as warm-up, with a 95 % confidence
interval by Student's t: single readings are too much alike to count as independent. It holds if the interval's upper
end is below one mebibyte an hour, or below eight an hour for the recorder, whose index of chunks grows with the bag,
about 1 kB a second.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import NODES
from los_testbed.run.runner import Runner
from scipy.stats import t

PAGE = os.sysconf("SC_PAGE_SIZE")
BLOCKS = 20
WARM_UP = 0.2
LIMIT_MIB_PER_HOUR = {"plant": 1.0, "estimator": 1.0, "controller": 1.0, "recorder": 8.0}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the run (default 10)")
    parser.add_argument("--domain", type=int, default=88, help="ROS domain (default 88)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    load = os.getloadavg()[0]
    times: list[float] = []
    resident: list[list[float]] = []

    def progress(ticks: int) -> None:
        if not times or time.monotonic() - times[-1] >= 1.0:
            times.append(time.monotonic())
            resident.append([memory(runner.processes[name]) for name in NODES])

    with tempfile.TemporaryDirectory(prefix="los_testbed_soak_") as folder:
        seconds = round(60 * args.minutes)
        config = RunConfig(duration=seconds, output=f"{folder}/bag", domain=args.domain, wait_for_recorder=True)
        runner = Runner(config, progress)
        results = runner.run()
        size = sum(file.stat().st_size for file in Path(folder, "bag").iterdir())
    plant, recorder = results.statistics["plant"], results.statistics["recorder"]
    seconds_seen = np.array(times) - times[0]
    growth = {name: slope(seconds_seen, np.array(resident)[:, i]) for i, name in enumerate(NODES)}
    held = all(growth[name]["upper"] <= LIMIT_MIB_PER_HOUR[name] for name in NODES)
    result: dict[str, Any] = {
        "minutes": args.minutes,
        "memory_MiB_per_hour": growth,
        "memory_held": held,
        "samples_lost": int(recorder["samples_lost"]),
        "messages": int(recorder["messages"]),
        "ticks": int(plant["ticks"]),
        "missed_ticks": int(plant["missed_ticks"]),
        "latency_median_us": float(plant["latency_median_us"]),
        "latency_p999_us": float(plant["latency_p999_us"]),
        "bag_MB": round(size / 1e6, 1),
        "load_before": load,
        "warnings": results.warnings + results.failures,
    }
    print(json.dumps(result) if args.json else table(result))
    return 0 if held and not result["samples_lost"] else 1


def memory(pid: int) -> float:
    """Resident memory [MiB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 2**20


def slope(seconds: np.ndarray, mebibytes: np.ndarray) -> dict[str, float]:
    """Slope [MiB/h] with its 95 % confidence interval, and the level at the end [MiB]."""
    kept = seconds >= WARM_UP * seconds[-1]
    blocks = min(BLOCKS, max(3, kept.sum() // 3))
    x, y = (np.array([part.mean() for part in np.array_split(v[kept], blocks)]) for v in (seconds / 3600, mebibytes))
    dx = x - x.mean()
    value = float(dx @ y / (dx @ dx))
    scatter = float(np.sum((y - y.mean() - value * dx) ** 2)) / (blocks - 2)
    half = float(t.ppf(0.975, blocks - 2)) * math.sqrt(scatter / float(dx @ dx))
    names = ("slope", "lower", "upper", "level_MiB")
    return dict(zip(names, (round(v, 3) for v in (value, value - half, value + half, float(mebibytes[-1])))))


def table(result: dict[str, Any]) -> str:
    """Markdown table."""
    rows = ["| process | memory at the end [MiB] | slope [MiB/h] (95 % interval) |", "|---|---|---|"]
    for name, entry in result["memory_MiB_per_hour"].items():
        rows.append(
            f"| {name} | {entry['level_MiB']:.1f} "
            f"| {entry['slope']:.2f} ({entry['lower']:.2f} to {entry['upper']:.2f}) |"
        )
    rows += [
        "",
        f"{result['minutes']:g} min: {result['samples_lost']} of {result['messages']} samples lost, "
        f"{result['missed_ticks']} of {result['ticks']} ticks missed, "
        f"latency {result['latency_median_us']:.0f} µs median, {result['latency_p999_us']:.0f} µs at 99.9 %, "
        f"bag {result['bag_MB']} MB; load average before {result['load_before']:.1f}.",
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main())
