"""Interrupt of ``los-testbed design all`` in several processes: code 130, one line, no process left, it goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMMAND = """
import sys
from los_design.synthesis import synthesis
from los_design.synthesis.rounds import Effort
from los_design.search.worst_case_search import SearchOptions
from los_testbed.cli.app import main

search = SearchOptions(frequencies=40, points=8, ascents=4, iterations=2, patience=0)
synthesis.SHORT_EFFORT = Effort(rounds=1000, points=1, first=6, iterations=6, target=0.8, searches=(search,))
sys.exit(main(["design", "all", "--effort", "short", "--workers", "2", "--output", sys.argv[1]]))
"""
"""The command with a design of small effort: rounds that do not end within a minute, because nothing is below 0.8."""


def started(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(folder)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "LOS_TESTBED_QUIET": ""},  # the lines of rounds say when to interrupt
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def until_line(process: subprocess.Popen[str], text: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(text):
            return
    pytest.fail(f"the command ended without a line {text!r}, code {process.wait()}")


def members(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
def test_an_interrupted_design_ends_at_once_and_goes_on(tmp_path: Path) -> None:
    """The second round is interrupted, with worker processes of the first one's search; then the continued design."""
    process = started(tmp_path)
    until_line(process, "round 2, step")
    assert len(members(process.pid)) >= 3, "this process and two workers"
    end_by_interrupt(process)
    assert [p.name for p in tmp_path.iterdir()] == ["rounds.json"]
    number = json.loads((tmp_path / "rounds.json").read_text())["state"]["number"]

    again = started(tmp_path)
    until_line(again, f"goes on after {number} rounds")
    until_line(again, f"round {number + 1}:")
    end_by_interrupt(again)
    assert json.loads((tmp_path / "rounds.json").read_text())["state"]["number"] > number


def end_by_interrupt(process: subprocess.Popen[str]) -> None:
    """Code 130, one line beside those of the rounds, and no process left."""
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=600)[1].splitlines()
    assert process.returncode == 130
    told = [line for line in errors if not line.startswith(("round ", "design: "))]
    assert told[0].startswith("rounds and designs so far are stored") and told[1:] == ["los-testbed: interrupted"]
    until = time.monotonic() + 60.0
    while members(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert members(process.pid) == []
