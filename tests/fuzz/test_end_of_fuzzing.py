"""`make fuzz`: its time and signals end it after the example that runs, with a line that sums up and an exit code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

BEGIN = """
import os, signal, time
from pathlib import Path
from fuzz.fuzz_profile import examples, over
from hypothesis import given, strategies as st

FOLDER = Path(__file__).parent

def tell(name):
    with (FOLDER / name).open("a") as file:
        file.write("x")

@given(number=st.integers())
@examples(1)
def test_one(number):
    # the code that is fuzzed answers signals in its own way
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, lambda *_: None)
    tell("one")
"""
END = """

@given(number=st.integers())
@examples(1)
def test_two(number):
    tell("two")
"""
WAIT = "    while not over():\n        time.sleep(0.01)\n"


def started(folder: Path, minutes: float, body: str, *options: str) -> subprocess.Popen[str]:
    """The fuzzing of a file of two tests, of which the first does this."""
    (folder / "test_fuzz_one.py").write_text(BEGIN + body + END)
    script = Path(__file__).with_name("fuzz_for.py")
    return subprocess.Popen(
        [sys.executable, str(script), str(minutes), *options, str(folder / "test_fuzz_one.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=script.parents[2],
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def examples_of(folder: Path, name: str) -> int:
    """How many examples of a test have started."""
    file = folder / name
    return len(file.read_text()) if file.exists() else 0


def await_first(folder: Path, process: subprocess.Popen[str]) -> None:
    while not examples_of(folder, "one"):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)


def test_no_example_begins_after_the_time(tmp_path: Path) -> None:
    process = started(tmp_path, 1e-3, WAIT)
    out, _ = process.communicate(timeout=250)
    assert process.returncode == 0, out
    examples = examples_of(tmp_path, "one")
    assert examples <= 1 and not examples_of(tmp_path, "two")  # none if the time was over before
    assert f"\n{examples} examples in " in f"\n{out}" and "nothing found\n" in out, out


@pytest.mark.parametrize(
    "name", ["SIGTERM", *(pytest.param(name, marks=pytest.mark.slow) for name in ("SIGINT", "SIGHUP"))]
)
def test_a_signal_ends_it_after_the_example_that_runs(tmp_path: Path, name: str) -> None:
    process = started(tmp_path, 60, WAIT)
    await_first(tmp_path, process)
    process.send_signal(getattr(signal, name))
    out, _ = process.communicate(timeout=250)
    assert process.returncode == 130, out
    assert examples_of(tmp_path, "one") == 1 and not examples_of(tmp_path, "two")
    assert "1 examples in 1 rounds" in out and f"nothing found\nended by {name} before" in out, out


def test_a_second_signal_ends_an_example_that_does_not_end(tmp_path: Path) -> None:
    process = started(tmp_path, 60, "    tell(str(os.getpid()))\n    while True:\n        time.sleep(0.01)\n")
    await_first(tmp_path, process)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=250)
    assert process.returncode == 130 and "ended by SIG" in out, out
    (number,) = (int(path.name) for path in tmp_path.iterdir() if path.name.isdigit())
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("    raise ValueError('a mistake')\n", "something was found"),
        ("    os.kill(os.getpid(), signal.SIGKILL)\n", "something was found: the tests ended by SIGKILL"),
    ],
)
def test_what_is_found_ends_it(tmp_path: Path, body: str, words: str) -> None:
    process = started(tmp_path, 60, body)
    out, _ = process.communicate(timeout=250)
    assert process.returncode == 1 and words in out, out
    assert not examples_of(tmp_path, "two")
