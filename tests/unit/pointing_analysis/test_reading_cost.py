"""Time and memory of reading, against other readers and against the limit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def last_line(*command: str) -> str:
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=280, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_reading_is_ten_times_faster_than_other_readers() -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap_ros2")
    found = json.loads(last_line("benchmarks/bag_reading.py", "--seconds", "4", "--json"))
    assert found["equal"] is True
    assert found["ratio_rosbags"] >= 10
    assert found["ratio_mcap_ros2"] >= 10


@pytest.mark.slow
def test_ten_minutes_fit_into_500_megabytes(tmp_path: Path) -> None:
    """Nine topics at 1 kHz for 600 s, opened, judged and reported in a process of its own."""
    write = (
        f"import sys; sys.path.insert(0, 'benchmarks'); import pathlib, bag_reading as b; "
        f"print(b.synthetic(pathlib.Path({str(tmp_path)!r}), 600))"
    )
    bag = last_line("-c", write)
    measure = (
        "import resource; from pointing_analysis.read import Run; from pointing_analysis.report import write_report; "
        f"run = Run.open({bag!r}); write_report([run], {str(tmp_path / 'report.html')!r}); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    assert float(last_line("-c", measure)) < 500
