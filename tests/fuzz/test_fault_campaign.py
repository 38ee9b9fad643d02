"""The judge of the fault campaign finds what it is to find: processes left, damaged bags, wrong exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fuzz import fault_campaign
from fuzz.fault_campaign import MARK, PAUSE_TICKS, Case, orphans, unreadable, wrong_end

from pointing_analysis.indices.synthetic import write_bag


def case_in(folder: Path, allowed: dict[int, str]) -> Case:
    return Case("kind", "text", folder, allowed)


def test_a_process_that_is_left_is_found_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_campaign, "LEFT_S", 0.2)
    case = case_in(tmp_path, {})
    assert not orphans(case)
    waiting = "import sys; print(flush=True); sys.stdin.read()"
    marked = {**os.environ, MARK: str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", waiting], env=marked, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert orphans(case) == [process.pid]


def test_a_bag_that_cannot_be_read_is_found_and_one_without_a_message_is_none(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes(b"")
    assert unreadable(case_in(tmp_path, {})) == []
    (bag / "bag_0.mcap").write_bytes(bytes(range(256)) * 8)
    assert unreadable(case_in(tmp_path, {}))


@pytest.mark.parametrize(
    ("code", "out", "words"),
    [
        (1, "los-testbed: recorder ended unexpectedly (signal 9)", ""),
        (1, "los-testbed: something else", "without the words"),
        (2, "los-testbed: recorder ended unexpectedly (signal 9)", "exit code 2"),
        (0, "", "without a whole bag"),
        (0, "recorder ended unexpectedly (signal 9)", "in spite of the fault"),
        (1, "Traceback: recorder ended unexpectedly (signal 9)", "traceback"),
    ],
)
def test_exit_codes_and_words_are_judged(tmp_path: Path, code: int, out: str, words: str) -> None:
    found = wrong_end(case_in(tmp_path, {0: "", 1: r"recorder ended unexpectedly \(signal 9\)"}), code, out)
    assert words in found and bool(found) == bool(words)


@pytest.mark.parametrize("missing", [0, PAUSE_TICKS - 10, PAUSE_TICKS + 10])
def test_a_node_that_was_killed_and_is_not_told_of_is_found_by_its_commands(tmp_path: Path, missing: int) -> None:
    """Exit code 0 is right where the signal came after the last tick."""
    truth, commands = np.zeros((2000, 2)), np.zeros((2000, 2))
    write_bag(tmp_path / "bag", {"truth/los": truth, "fsm/command": commands[: 2000 - missing]})
    case = case_in(tmp_path, {0: ""})
    assert not wrong_end(case, 0, ""), "nothing was killed"
    case.crashed = "controller"
    assert ("commands in a row are missing" in wrong_end(case, 0, "")) == (missing > PAUSE_TICKS)
    assert not wrong_end(case, 0, "controller was restarted before the run began")
