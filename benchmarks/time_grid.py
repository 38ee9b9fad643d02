"""Wall minus stamp over a run whose plant gets no processor for 130 ms every 1.3 s: the stamps stay where they were.

    python benchmarks/time_grid.py --seconds 600

A plant that is stopped (SIGSTOP) gets no processor, as if another program had it, and no other program is disturbed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
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
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        command = [sys.executable, "-m", "los_testbed.cli.app", "run", f"--duration={given.seconds}", "--no-report"]
        command += [f"--domain={given.domain}", "--max-missed=100", f"--output={bag}"]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        stops = stop_again_and_again(run)
        found = slips(bag)
        plant = Run.open(bag).parameters["statistics"]["plant"]
    print(
        json.dumps(
            {
                "stops": stops,
                "seconds": len(found),
                "slip_ms": [round(float(found.min()), 3), round(float(found.max()), 3)],
                "lost_periods": int(plant["lost_periods"]),
                "exit_code": run.returncode,
            }
        )
    )
    return 0 if np.abs(found).max() < 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
