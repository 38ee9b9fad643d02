"""A campaign leaves nothing in the temporary folder and no process, however it ends."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.config.run_config import RunConfig
from los_testbed.run.identity import identity

PROGRAM = """
import signal
from los_testbed.cli.app import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts tests in the background ignores it
main()
"""
OPTIONS = ["campaign", "--samples=200", "--duration=1.1", "--loop=isolator", "--scenario=imbalance", "--workers=1"]


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    pytest.importorskip("distributed")
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_another_campaign_in_the_folder_is_refused_without_a_cluster(temporary: Path, tmp_path: Path) -> None:
    """Told in one line by a process that has ended afterwards, and the folder is as it was."""
    output = tmp_path / "c"
    base = RunConfig(mode="inprocess", duration=1.1, loop="isolator", scenario="imbalance")
    ResultFolder(output).open(Campaign.of(base, "uniform", 100, 1, "time", identity(base)), False)
    manifest = (output / "campaign.json").read_bytes()
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, *OPTIONS, f"--output={output}", "--resume"],
        capture_output=True,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
        check=False,
    )
    message = (
        f"los-testbed: output must be a new folder or one of the same campaign, got {output}, "
        "which holds another: samples must be 100 as there, got 200\n"
    )
    assert (process.returncode, process.stdout, process.stderr) == (2, "", message)
    assert list(temporary.iterdir()) == [] and (output / "campaign.json").read_bytes() == manifest


def processes_of(variable: str) -> Iterator[int]:
    """Processes with this in their environment."""
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdigit() and variable.encode() in (entry / "environ").read_bytes().split(b"\0"):
                yield int(entry.name)


@pytest.mark.parametrize("started", ["folder", pytest.param("rows", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name",
    ["SIGINT", *(pytest.param(name, marks=pytest.mark.slow) for name in ("keyboard", "SIGTERM", "SIGHUP", "SIGKILL"))],
)
def test_after_a_signal(name: str, started: str, temporary: Path, tmp_path: Path) -> None:
    """While the workers start, and while members are computed; a key of a terminal reaches workers, too."""
    output, variable = tmp_path / "c", f"TMPDIR={temporary}"
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *OPTIONS, f"--output={output}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
        start_new_session=True,
    )
    pattern = {"folder": (temporary, "los_testbed_campaign_*"), "rows": (output, "rows/part-*.parquet")}[started]
    while not list(pattern[0].glob(pattern[1])):
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.01)
    if name == "keyboard":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=600)
    end = time.monotonic() + 60.0
    while (list(temporary.iterdir()) or list(processes_of(variable))) and time.monotonic() < end:
        assert name == "SIGKILL", "others leave nothing when they have ended"
        time.sleep(0.05)
    assert list(temporary.iterdir()) == [] and list(processes_of(variable)) == []
    if name == "SIGKILL":
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert err.splitlines()[-1] == "los-testbed: interrupted" and "Traceback" not in err
