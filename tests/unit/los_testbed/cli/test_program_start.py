"""The first moments of the program, while it imports its packages."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
