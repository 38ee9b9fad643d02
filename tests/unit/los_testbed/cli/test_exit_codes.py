"""The page of exit codes and the table in the code; code of the user that ends the program."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from los_testbed.cli import app
from los_testbed.cli import run as run_command
from los_testbed.config.exit_codes import COMMANDS, MEANINGS, ExitCode
from los_testbed.run.results import Results

from pointing_analysis.read.run import Run

ROOT = Path(__file__).parents[4]
ROW = re.compile(r"^\| (\d+) \| (.*) \| (.*) \|$", re.MULTILINE)

LEAVING = """
import ctypes, os, signal

class Leaving:
    def reset(self):
        self.tick = 0
    def step(self, out):
        out[:] = 0.0
        self.tick += 1
        if self.tick == 1234:
            {end}
"""


def test_the_page_has_the_table_of_the_code():
    rows = ROW.findall((ROOT / "docs" / "reference.md").read_text())
    assert [int(code) for code, _, _ in rows] == sorted(ExitCode)
    for code, meaning, commands in rows:
        own = ExitCode(int(code))
        assert meaning.startswith(MEANINGS[own]), code
        assert commands == COMMANDS.get(own, "all"), code


def run_with(tmp_path, end, *options):
    (tmp_path / "leaving.py").write_text(LEAVING.format(end=end))
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", "--mode=inprocess", "--duration=2", "--no-report"]
    command += ["--disturbance=leaving:Leaving", f"--output={tmp_path / 'bag'}", *options]
    variables = {**os.environ, "PYTHONPATH": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=variables, timeout=600)


@pytest.mark.further
@pytest.mark.parametrize(
    ("end", "how"),
    [
        pytest.param("os._exit(0)", "exit code 0", marks=pytest.mark.slow),
        pytest.param("os._exit(3)", "exit code 3", marks=pytest.mark.slow),
        ("os.kill(os.getpid(), signal.SIGKILL)", "signal 9"),
        pytest.param("ctypes.string_at(0)", f"signal {signal.SIGSEGV.value}", marks=pytest.mark.slow),
    ],
)
def test_code_of_the_user_that_ends_the_program_is_named_with_what_was_recorded(tmp_path, end, how):
    done = run_with(tmp_path, end)
    assert done.returncode == 1, done.stderr
    words = f"los-testbed: the process of the run ended in user code ({how}): disturbance_source leaving:Leaving"
    assert done.stderr.splitlines()[-1].startswith(words), done.stderr
    if (tmp_path / "bag").exists():
        assert f"los-testbed bag repair {tmp_path / 'bag'}" in done.stderr


@pytest.mark.further
def test_an_interrupt_of_the_program_reaches_the_run(tmp_path):
    done = run_with(tmp_path, "os.kill(os.getppid(), signal.SIGTERM)", "--duration=600")
    assert done.returncode == 130
    assert "interrupted" in done.stderr.splitlines()[-1]


def ended_with(arguments):
    """Exit code of the program."""
    try:
        return app.main(arguments)
    except SystemExit as stop:
        return stop.code


@pytest.mark.parametrize(
    ("left", "code"),
    [
        ({"failures": ["plant ended unexpectedly (signal 15); it was restarted"]}, ExitCode.RESTARTED),
        ({}, ExitCode.FINISHED),
    ],
)
def test_what_is_left_of_a_run_may_be_too_short_to_be_evaluated(tmp_path, monkeypatch, capsys, left, code):
    """That is said; a mistake of the user it is not, since the work is done."""
    done = run_command.execute

    def execute(parts, nodes):
        return Results(bag=done(parts, nodes).bag, **left)

    monkeypatch.setattr(run_command, "execute", execute)
    options = ["--mode=inprocess", "--duration=0.5", "--start=rest", "--no-report", f"--output={tmp_path / 'bag'}"]
    assert ended_with(["run", *options]) == code
    told = capsys.readouterr()
    assert "not evaluated" in told.out + told.err
    assert "the run must be longer than its start-up transient" in " ".join((told.out + told.err).split())
    assert len(Run.open(tmp_path / "bag")["truth/los"]) == 500
