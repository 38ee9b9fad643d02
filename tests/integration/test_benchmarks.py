"""The benchmarks of ``make bench`` that need no nodes run and print one JSON object each (slow)."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NODES = {"real_time_loop.py", "image_camera.py", "soak.py"}


def calls() -> list[str]:
    """Script and options of the lines of the target."""
    (target,) = re.findall(r"^bench:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    return re.findall(r"benchmarks/(\S+\.py.*)$", target, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("call", [c for c in calls() if c.split()[0] not in NODES], ids=lambda c: c.split()[0])
def test_it_prints_one_object(call: str) -> None:
    script, *options = call.split()
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / script, *options], capture_output=True, text=True, cwd=ROOT, timeout=1800
    )
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout), dict)


def test_the_target_has_benchmarks_of_both_kinds() -> None:
    assert {call.split()[0] for call in calls()} > NODES
