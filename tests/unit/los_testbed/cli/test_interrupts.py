"""A signal ends a command, wherever it comes."""

from __future__ import annotations

import subprocess
import sys

import pytest
from support.slow_cases import slow

CODE = """
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
        [sys.executable, "-c", prepared + CODE.replace("{name}", name)], capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr.splitlines()[-1] == "los-testbed: interrupted"
