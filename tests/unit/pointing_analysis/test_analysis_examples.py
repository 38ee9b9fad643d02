"""Every example of the analysis runs and prints what it promises."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("without_pictures")
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
def test_example(
    name: str, expected: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [f"{name}.py"])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    shown = capsys.readouterr().out
    assert all(text in shown for text in expected)
