"""Commands and parts beside the goals of the project's speed, and beside what they took before.

    python benchmarks/goals.py [--verify] [--design] [--hours 3] [--json]

Processor seconds (user and system, children included), which other programs on the machine change by some tens of per
cent where two share a core; wall seconds beside them. Each entry has ``before`` (on the machine and with the code of
version 0.1, where known), ``now``, ``ratio`` (before over now), ``goal`` and whether it is ``met``. ``--verify`` and
``--design`` add the verification and the design of the reference (minutes), ``--hours`` a recorded run in one process
and the report of its bag, with the most memory of each.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

RUN = ["run", "--mode", "inprocess", "--duration", "1"]
BEFORE = {
    "tick": 35.0,
    "run_without_bag": 28.0,
    "run_with_bag": 22.0,
    "member_design": 0.25,
    "member_worst_case": 1.25,
    "member_model": 0.0245,
    "worst_tone": 0.95,
    "short_run": 3.4,
    "report": 2.4,
    "verify": 217.0,
    "design": 528.0,
}
"""Least of what was measured, in the units of :data:`GOALS`."""
GOALS = {
    "tick": (2.5, "us"),
    "run_without_bag": (400.0, "times real time"),
    "run_with_bag": (100.0, "times real time"),
    "member_design": (0.06, "CPU s"),
    "member_worst_case": (0.12, "CPU s"),
    "member_model": (0.015, "CPU s"),
    "worst_tone": (0.1, "CPU s"),
    "help": (0.3, "CPU s"),
    "short_run": (1.5, "CPU s"),
    "report": (None, "CPU s"),
    "verify": (60.0, "CPU s"),
    "design": (300.0, "CPU s"),
    "long_run": (60.0, "CPU s"),
    "long_report": (60.0, "CPU s"),
}
"""Goal and unit; ``times real time`` is better where it is larger. Those of the last two are for three hours."""
LONG_HOURS = 3.0


def entry(name: str, now: float, **more: float) -> dict[str, Any]:
    """One line of the table; of a shorter recording the goal is as much less as it is shorter."""
    goal, unit = GOALS[name]
    if goal is not None and "hours" in more:
        goal = float(f"{goal * more['hours'] / LONG_HOURS:.4g}")
    before, larger = BEFORE.get(name), unit == "times real time"
    found: dict[str, Any] = {
        "now": float(f"{now:.4g}"),
        "unit": unit,
        **{k: float(f"{v:.4g}") for k, v in more.items()},
    }
    if before is not None:
        found |= {"before": before, "ratio": float(f"{(now / before if larger else before / now):.3g}")}
    if goal is not None:
        found |= {"goal": goal, "met": bool(now >= goal if larger else now <= goal)}
    return found


def command(*arguments: str, repeats: int = 3, **where: Any) -> dict[str, float]:
    """Processor and wall seconds of a command, the least of some, and the most memory [MB] of its processes.

    ``cwd`` and ``env`` of the process may be given.
    """
    found = []
    for _ in range(repeats):
        begin = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-m", "los_testbed.cli.app", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            **where,
        )
        assert process.stderr is not None
        said = process.stderr.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{' '.join(arguments)}: {said.decode()[-300:]}")
        found.append((used.ru_utime + used.ru_stime, time.monotonic() - begin, used.ru_maxrss / 1024.0))
    return {"now": min(f[0] for f in found), "wall_s": min(f[1] for f in found), "memory_mb": max(f[2] for f in found)}


def parts() -> dict[str, Any]:
    """Ticks, members and worst tone, in this process."""
    import campaign
    import tick
    from los_testbed.config.run_config import RunConfig

    base = RunConfig(mode="inprocess", scenario="design", duration=10.0)
    ticks, bag = tick.tick("design", 20000), tick.with_bag([20.0, 80.0])
    members = {scenario: tick.member(scenario, 10.0) for scenario in ("design", "worst_case")}
    tone = members["worst_case"]["preparation_cpu_s"] - members["design"]["preparation_cpu_s"]
    return {
        "tick": entry("tick", ticks["compiled_us"], dense_us=ticks["dense_us"]),
        "run_without_bag": entry("run_without_bag", ticks["times_real_time"]),
        "run_with_bag": entry("run_with_bag", bag["times_real_time"]),
        "member_design": entry("member_design", members["design"]["cpu_s"]),
        "member_worst_case": entry("member_worst_case", members["worst_case"]["cpu_s"]),
        "member_model": entry("member_model", campaign.cost(base, 5)["model"]),
        "worst_tone": entry("worst_tone", tone),
    }


def commands(folder: Path) -> dict[str, Any]:
    """Start of the command line, a short run, a report."""
    bags = (str(folder / f"bag{k}") for k in range(100))
    runs = []
    for _ in range(3):
        bag = next(bags)
        runs.append(command(*RUN, "--no-report", "--output", bag, repeats=1))
    return {
        "help": entry("help", **command("--help")),
        "short_run": entry("short_run", **min(runs, key=lambda found: found["now"])),
        "report": entry("report", **command("report", bag)),
    }


def long_run(folder: Path, hours: float) -> dict[str, Any]:
    """A recorded run in one process, and the report of its bag."""
    bag = str(folder / "long")
    seconds = str(3600.0 * hours)
    run = command("run", "--mode", "inprocess", "--duration", seconds, "--no-report", "--output", bag, repeats=1)
    size = sum(path.stat().st_size for path in Path(bag).rglob("*") if path.is_file())
    found = {"long_run": entry("long_run", **run, hours=hours, bag_gb=size / 1e9)}
    return found | {"long_report": entry("long_report", **command("report", bag, repeats=1), hours=hours)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--verify", action="store_true")
    parser.add_argument("--design", action="store_true")
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        result = commands(folder)  # before this process grows: a child's memory begins with its parent's
        if arguments.verify:
            result["verify"] = entry("verify", **command("design", "verify", "--workers", "1", repeats=1))
        if arguments.design:
            output = str(folder / "designs")
            result["design"] = entry(
                "design", **command("design", "all", "--output", output, "--workers", "1", repeats=1)
            )
            shutil.rmtree(output)
        if arguments.hours:
            result |= long_run(folder, arguments.hours)
    result |= parts()
    print(json.dumps(result) if arguments.json else json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
