"""Wall minus stamp over a run whose plant gets no processor for 130 ms every 1.3 s: the stamps stay where they were.

    python benchmarks/time_grid.py --seconds 600
    python benchmarks/time_grid.py --seconds 90 --hog

A plant that is stopped (SIGSTOP) gets no processor, as if another program had it, and no other program is disturbed.
With --hog another program has it: one process for each processor, with a real-time priority above all nodes of the run
(or, where that is not permitted, nice -20), which takes all processors at the same time. Every other program of the
machine waits, too.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from los_testbed.bags.cdr import stamp_of
from mcap.reader import make_reader

from lftkit.arrays import FloatArray
from pointing_analysis.read.run import Run

STOP_S, PERIOD_S = 0.13, 1.3
HOG_PRIORITY = 90
"""SCHED_FIFO priority of a hog; the plant has 80."""
MOST_NICE = -20


def plants_of(run: subprocess.Popen[bytes]) -> list[int]:
    """Processes of the plant among the children of a run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            command = (folder / "cmdline").read_bytes()
        except OSError:  # it has ended
            continue
        if parent == run.pid and b"los_testbed.nodes.plant" in command:
            found.append(int(folder.name))
    return found


def stop_again_and_again(run: subprocess.Popen[bytes]) -> int:
    """Stop the plant of a run until the run is over; how often."""
    stops = 0
    while run.poll() is None:
        plants = plants_of(run)
        for number, wait in ((signal.SIGSTOP, STOP_S), (signal.SIGCONT, PERIOD_S - STOP_S)):
            for pid in plants:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
            time.sleep(wait)
        stops += len(plants)
    return stops


def hog(processor: int) -> int:
    """Take a processor for `STOP_S` at each multiple of `PERIOD_S` of the steady clock until standard input ends."""
    os.sched_setaffinity(0, {processor})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(HOG_PRIORITY))
    except PermissionError:
        os.setpriority(os.PRIO_PROCESS, 0, MOST_NICE)
    taken = 0
    while True:
        begin = (time.monotonic() // PERIOD_S + 1) * PERIOD_S
        if select.select([sys.stdin], [], [], begin - time.monotonic())[0]:
            print(taken)
            return 0
        while time.monotonic() < begin + STOP_S:
            pass
        taken += 1


def hog_again_and_again(run: subprocess.Popen[bytes]) -> int:
    """Take all processors again and again until the run is over; how often, on each."""
    command = [sys.executable, __file__, "--hog-processor"]
    hogs = [
        subprocess.Popen([*command, str(number)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for number in sorted(os.sched_getaffinity(0))
    ]
    try:
        run.wait()
    finally:
        told = [each.communicate()[0] for each in hogs]  # ends their standard input
    if any(each.returncode for each in hogs):
        raise PermissionError(f"neither SCHED_FIFO nor nice {MOST_NICE} is permitted to a hog")
    return min(int(text) for text in told)


def slips(bag: Path) -> FloatArray:
    """Median wall minus stamp of each second of a run [ms], less that of the first one."""
    with next(bag.glob("*.mcap")).open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/telescope/truth/los"])
        stamp, sent = np.array([(stamp_of(m.data), m.publish_time) for _, _, m in messages]).T
    second = (stamp - stamp[0]) // 1_000_000_000
    medians = np.array([np.median((sent - stamp)[second == k]) for k in range(int(second[-1]))])
    return np.asarray((medians - medians[0]) / 1e6)


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--domain", type=int, default=92)
    parser.add_argument("--hog", action="store_true", help="take all processors instead of stopping the plant")
    parser.add_argument("--hog-processor", type=int, metavar="NUMBER", help="of a hog: the processor that it takes")
    given = parser.parse_args()
    if given.hog_processor is not None:
        return hog(given.hog_processor)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        command = [sys.executable, "-m", "los_testbed.cli.app", "run", f"--duration={given.seconds}", "--no-report"]
        command += [f"--domain={given.domain}", "--max-missed=100", f"--output={bag}"]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        stops = (hog_again_and_again if given.hog else stop_again_and_again)(run)
        found = slips(bag)
        plant = Run.open(bag).parameters["statistics"]["plant"]
    print(
        json.dumps(
            {
                "by": "processes that take all processors" if given.hog else "SIGSTOP to the plant",
                "stops": stops,
                "seconds": len(found),
                "slip_ms": [round(float(found.min()), 3), round(float(found.max()), 3)],
                "ticks": int(plant["ticks"]),
                "missed_ticks": int(plant["missed_ticks"]),
                "lost_periods": int(plant["lost_periods"]),
                "exit_code": run.returncode,
            }
        )
    )
    return 0 if np.abs(found).max() < 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
