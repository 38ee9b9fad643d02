"""Every example of the analysis runs and prints what it promises."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("read_bag", ["998 samples", "gap of 2 samples after 0.399 s", "1 with NaN"]),
        ("pointing_verdict", ["not enough data", "20.0 s would decide", "compliant"]),
        ("pointing_spectrum", ["88.0 rad/s", "everything else: 6."]),
        ("compare_stages", ["isolator", "report of"]),
        ("replay_observer", ["of the camera alone", "ticks differ"]),
        ("pointing_budget", ["APE:", "RPE:"]),
    ],
)
def test_example(name: str, expected: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    for text in expected:
        assert text in done.stdout
