"""What a run does when its rig fails: exit code, line, and the time until mirror and forces are at zero.

    python benchmarks/device_faults.py --table

Each fault is one of the emulator's, two seconds after its first command, in a run with ROS in real time over UDP.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from los_testbed.rig.emulator import FAULTS

from pointing_analysis.formatting.tables import TextTable

DRIVER = "los_testbed.rig.udp:UdpRig"
SECONDS, AT = 4.0, 2.0
LOSS = "lost, reordered"
CASES = (LOSS, *FAULTS)


def free_address() -> str:
    """Address of this machine that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


def fly(case: str, bag: Path, domain: int) -> list[str]:
    """Row of the table: fault, exit code, what the command says, time to zero."""
    address = free_address()
    options = ["--loss=0.02", "--reorder=0.02"] if case == LOSS else [f"--fault={case}", f"--fault-at={AT}"]
    settings = json.dumps({"device_address": address})
    python = [sys.executable, "-m"]
    command = [*python, "los_testbed.cli.app", "run", f"--device={DRIVER}", f"--device-address={address}"]
    command += ["--no-report", f"--duration={SECONDS}", "--camera-latency=9", "--max-missed=100", f"--domain={domain}"]
    emulator = subprocess.Popen(
        [*python, "los_testbed.rig.emulator", "--priority", "--config", settings, *options],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert emulator.stdout is not None
        emulator.stdout.readline()
        done = subprocess.run([*command, f"--output={bag}"], capture_output=True, text=True, timeout=300)
    finally:
        emulator.terminate()
        events = [json.loads(line) for line in emulator.communicate()[0].splitlines()]
    lines = (done.stdout + done.stderr).splitlines()
    said = next((line for line in reversed(lines) if f"device {DRIVER}" in line), "")
    said = said or next((line.removeprefix("warning: ") for line in lines if "camera/los" in line), "")
    said = said.split(f"{DRIVER}: ")[-1].partition("; ")[0]
    zero = _zero(events, ended=done.returncode != 0)
    return [case, str(done.returncode), said, zero]


def _zero(events: list[dict[str, Any]], ended: bool) -> str:
    """What the emulator says of the way to zero after its fault; `ended`: that the host ended the run."""
    for event in events:
        of_fault = event["event"] == "safe" and event.get("fault_ms", -1.0) >= 0
        if of_fault and (ended or event["why"] != "asked"):
            return f"{event['after_ms']:.0f}, {event['fault_ms']:.0f}"
    last = [event for event in events if event["event"] == "closed"]
    return "at the end" if last and last[-1]["applied"] == 0.0 else "never"


def table(rows: list[list[str]]) -> str:
    """Rows as Markdown."""
    times = "ms to zero, from last command, fault"
    heads = ["`--fault`", "exit code", "message", times]
    cells = [[f"`{row[0]}`" if row[0] in FAULTS else row[0], *row[1:]] for row in rows]
    return TextTable.of(heads, cells).markdown() + "\n"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--domain", type=int, default=91)
    parser.add_argument("--table", action="store_true", help="at the end all of them as a table of Markdown")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for number, case in enumerate(given.cases):
            rows.append(fly(case, Path(folder) / str(number), given.domain))
            print(json.dumps(rows[-1]), flush=True)
    if given.table:
        print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
