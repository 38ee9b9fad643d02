"""A run that is ended at a random time, by any signal: its bag can be read or repaired, nothing is left behind."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from los_testbed.bags.check import check_bag as check_of_bag
from los_testbed.bags.repair import repair_bag
from support.marked_processes import processes_with

from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

TIMES = int(os.environ.get("SIGNAL_TRIALS", "25"))
"""Trials for each signal and mode of `make test-slow`."""
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL")


BEGIN = """
import signal, sys
import los_testbed.cli.app as app

made = app.typer.main.get_command

def get_command(program):
    print("begun", file=sys.stderr, flush=True)
    return made(program)

app.typer.main.get_command = get_command  # called when the program answers signals
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts tests in the background ignores it
app.main()
"""


def temporary(folder: Path) -> list[Path]:
    """Entries of the temporary folder of a run."""
    return sorted((folder / "temporary").iterdir())


def nodes_of(bag: Path, command: str = "") -> list[int]:
    """Processes of the run of this bag."""
    return processes_with(f"BAG_OF_TEST={bag}", command)


def started(folder: Path, mode: str, duration: float) -> subprocess.Popen[str]:
    """A run that answers signals: until its modules are imported no program can in its own way."""
    bag = folder / "bag"
    (folder / "temporary").mkdir()
    command = [sys.executable, "-c", BEGIN, "run", f"--mode={mode}", f"--duration={duration:g}"]
    command += [f"--output={bag}", "--no-report", "--domain=free"]
    variables = {**os.environ, "BAG_OF_TEST": str(bag), "TMPDIR": str(folder / "temporary")}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=variables,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None and process.stderr.readline() == "begun\n"
    return process


def output_of(process: subprocess.Popen[str]) -> tuple[str, str]:
    """What a run wrote; it must end by itself."""
    try:
        return process.communicate(timeout=240)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        raise AssertionError(f"the run goes on\n{out}\n{err}") from None


def ended(folder: Path, mode: str, name: str, wait: float) -> tuple[int, str]:
    """Exit code and error output of a run that gets a signal after `wait` seconds; its processes are gone."""
    process = started(folder, mode, 600.0)
    time.sleep(wait)
    process.send_signal(getattr(signal, name))
    err = output_of(process)[1]
    end = time.monotonic() + 60
    while nodes_of(folder / "bag"):
        assert time.monotonic() < end, "processes are left"
        time.sleep(0.2)
    return process.returncode, err


def opened(bag: Path) -> Run | None:
    """The bag; None if no message was written yet."""
    try:
        return Run.open(bag)
    except BagError as error:
        if "must hold" in str(error) or "must begin with" in str(error):
            return None
        raise


def check_bag(folder: Path, bag: Path) -> None:
    """The bag can be read, or repaired and then read, or holds no message yet, or is not there."""
    if not bag.exists():
        return
    run = opened(bag)
    if run is None:
        return
    if any("truncated" in problem for problem in run.problems):
        repair_bag(bag, folder / "repaired")
        run = Run.open(folder / "repaired")
    topic = run["truth/los"]
    assert len(topic) and topic.integrity.conflicts == 0


def trial(folder: Path, mode: str, name: str, seed: int) -> None:
    code, err = ended(folder, mode, name, random.Random(f"{mode} {name} {seed}").uniform(0.0, 9.0))
    assert code == (-signal.SIGKILL if name == "SIGKILL" else 130), err
    assert "Traceback" not in err
    if name != "SIGKILL":
        assert "los-testbed: interrupted" in err or (folder / "bag").exists()
    assert not temporary(folder)
    check_bag(folder, folder / "bag")


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("mode", ["inprocess", "realtime"])
@pytest.mark.parametrize("name", SIGNALS)
def test_a_run_ended_at_a_random_time(tmp_path: Path, mode: str, name: str) -> None:
    for seed in range(TIMES):
        folder = tmp_path / str(seed)
        folder.mkdir()
        trial(folder, mode, name, seed)


@pytest.mark.parametrize("mode", ["realtime", pytest.param("lockstep", marks=pytest.mark.slow)])
def test_the_bag_of_a_killed_program_says_that_its_run_ended_early(tmp_path: Path, mode: str) -> None:
    """The nodes end in order when their program is gone: the file is whole, the run is not."""
    process = started(tmp_path, mode, 600.0)
    end = time.monotonic() + 120
    while not list(tmp_path.glob("bag/*.mcap")):
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.1)
    process.kill()
    output_of(process)
    while nodes_of(tmp_path / "bag"):
        assert time.monotonic() < end, "processes are left"
        time.sleep(0.2)
    found = check_of_bag(tmp_path / "bag")
    (row,) = [row for row in found.rows if row.state == "early"]
    assert found.code == 0 and re.fullmatch(r"the run ended early: after \d+ of 600000 ticks", row.found)
    assert found.title == f"whole; {row.found}"
    assert row.found in summarise(Run.open(tmp_path / "bag")).problems
