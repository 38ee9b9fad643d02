"""The program: its start and list of commands, signals, exit codes, and code of the user that ends it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from los_testbed.cli import app
from los_testbed.cli import run as run_command
from los_testbed.cli.command_group import ENTRIES
from los_testbed.run.results import Results
from support.command_line import call_command
from support.slow_cases import slow

from pointing_analysis.command.exit_codes import COMMANDS, MEANINGS, ExitCode
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


PROGRAM = """
import os, signal, sys

class Sender:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            os.kill(os.getpid(), signal.{name})

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the tests may have been started where one is ignored
signal.signal(signal.SIGHUP, signal.SIG_DFL)
sys.meta_path.insert(0, Sender())
sys.argv = ["los-testbed", "--version"]
from los_testbed.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_during_the_imports_is_one_line(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(name=name)], capture_output=True, text=True, timeout=600, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "los-testbed: interrupted\n")


def test_a_limit_of_memory_in_which_nothing_loads_is_told_before_the_imports() -> None:
    """With less, a package fails to load somewhere (an ImportError), or OpenBLAS waits for memory for ever."""
    command = ["bash", "-c", 'ulimit -v 320000 && exec "$@"', "bash", sys.executable, "-m", "los_testbed", "plant"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == (
        "los-testbed: memory of a process (ulimit -v) must be at least 600000 kB for a command, got 320000: "
        "too little memory\n"
    )


def test_an_ignored_signal_stays_ignored() -> None:
    program = PROGRAM.format(name="SIGHUP").replace(
        "sys.meta_path", "signal.signal(signal.SIGHUP, signal.SIG_IGN)\nsys.meta_path"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0 and ended.stdout.startswith("los-testbed 0") and not ended.stderr


CALLBACK = """
import os, signal, sys, time, weakref
from los_testbed.cli import app

class Thing:
    pass

def work(**_):
    thing = Thing()
    kept = weakref.ref(thing, lambda ref: os.kill(os.getpid(), signal.{name}))
    del thing  # the signal comes in a callback, which no exception leaves
    print("goes on", flush=True)
    time.sleep(60)

app.app.command(name="work")(lambda: work())
app.main(["work"])
"""


@pytest.mark.parametrize("name", ["SIGTERM", slow("SIGINT"), slow("SIGHUP")])
def test_a_signal_in_a_callback_is_not_lost(name: str) -> None:
    prepared = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # under nohup it is ignored
    )
    done = subprocess.run(
        [sys.executable, "-c", prepared + CALLBACK.replace("{name}", name)], capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr.splitlines()[-1] == "los-testbed: interrupted"


def test_the_help_imports_no_command() -> None:
    code = (
        "import sys; from los_testbed.cli.app import main; main(['--help']);"
        "print('imported', sorted({'numpy', 'scipy', 'pydantic', 'los_testbed.cli.run'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600)
    assert done.stdout.splitlines()[-1] == "imported []"
    assert all(f" {name} " in done.stdout for name in ENTRIES)


@pytest.mark.parametrize(
    ("words", "expected"),
    [("los-testbed ca", {"campaign"}), ("los-testbed bag ve", {"verify"}), ("los-testbed run --mo", {"--mode"})],
)
def test_bash_completes_commands_and_options(
    words: str, expected: set[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {"_LOS_TESTBED_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    code, out, err = call_command(capsys)
    assert code == 0 and set(out.split()) == expected, err
