"""A run that is ended at a random time, by any signal: its bag can be read or repaired, nothing is left behind."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from los_testbed.bags.repair import repair_bag
from los_testbed.run.domains import free_domain

from pointing_analysis.mcap_records import BagError
from pointing_analysis.read import Run

pytest.importorskip("rclpy")
TIMES = int(os.environ.get("SIGNAL_TRIALS", "25"))
"""Trials for each signal and mode of `make test-slow`."""
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL")


def temporary() -> set[str]:
    """Entries of the temporary folder that are ours."""
    return {name for name in os.listdir(tempfile.gettempdir()) if name.startswith(("los_testbed", ".los"))}


def names_run(entry: Path, bag: Path) -> bool:
    """Whether a process belongs to the run of this bag, by its environment."""
    try:
        return f"BAG_OF_TEST={bag}".encode() in (entry / "environ").read_bytes()
    except OSError:
        return False


def nodes_of(bag: Path) -> list[int]:
    """Processes of the run of this bag."""
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit() and names_run(entry, bag)]


def ended(folder: Path, mode: str, name: str, wait: float) -> tuple[int, str]:
    """Exit code and error output of a run that gets a signal after `wait` seconds; its processes are gone."""
    bag = folder / "bag"
    # Until its modules are imported no program can answer a signal in its own way.
    begin = "import sys, los_testbed.cli.app as app; print('begun', file=sys.stderr, flush=True); app.main()"
    command = [sys.executable, "-c", begin, "run", f"--mode={mode}", "--duration=600"]
    command += [f"--output={bag}", "--no-report", f"--domain={free_domain('/telescope')}"]
    process = subprocess.Popen(
        command, cwd=folder, env={**os.environ, "BAG_OF_TEST": str(bag)}, stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stderr is not None and process.stderr.readline() == "begun\n"
    time.sleep(wait)
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=120)
    end = time.monotonic() + 60
    while nodes_of(bag):
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


def check_bag(folder: Path) -> None:
    """The bag can be read, or repaired and then read, or holds no message yet, or is not there."""
    bag = folder / "bag"
    if not bag.exists():
        return
    run = opened(bag)
    if run is None:
        return
    if any("cut off" in problem for problem in run.problems):
        repair_bag(bag, folder / "repaired")
        run = Run.open(folder / "repaired")
    topic = run["truth/los"]
    assert len(topic) and topic.integrity.conflicts == 0


def trial(folder: Path, mode: str, name: str, seed: int) -> None:
    before = temporary()
    code, err = ended(folder, mode, name, random.Random(f"{mode} {name} {seed}").uniform(0.0, 9.0))
    assert code == (-signal.SIGKILL if name == "SIGKILL" else 130), err
    assert "Traceback" not in err
    if name != "SIGKILL":
        assert "los-testbed: interrupted" in err or (folder / "bag").exists()
    assert temporary() <= before
    check_bag(folder)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("mode", ["inprocess", "realtime"])
@pytest.mark.parametrize("name", SIGNALS)
def test_a_run_ended_at_a_random_time(tmp_path: Path, mode: str, name: str) -> None:
    for seed in range(TIMES):
        folder = tmp_path / str(seed)
        folder.mkdir()
        trial(folder, mode, name, seed)
