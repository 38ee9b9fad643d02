"""The classes of the example run as its docstring says, and do what they say."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli import app as cli
from los_testbed.config.run_config import RunConfig

from pointing_analysis.read.run import Run
from titop_plant.interface import CAMERA, MEASUREMENTS
from titop_plant.simulation.driven_plant import DISTURBANCE_SIZE

EXAMPLES = Path(__file__).parents[2] / "examples"
FILE = EXAMPLES / "classes_for_a_run.py"
TEXT = FILE.read_text("utf-8").replace("\\\n       ", "")
LINES = re.findall(r"^    los-testbed (run .*)$", TEXT, flags=re.MULTILINE)


@pytest.mark.parametrize("line", LINES)
def test_each_command_of_the_example_runs(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    bag = tmp_path / "bag"
    assert cli.main([*shlex.split(line), "--duration", "1", "--no-report", "--output", str(bag)]) == 0
    run = Run.open(bag)
    named = [v for v in run.parameters.values() if isinstance(v, str) and v.startswith("classes_for_a_run:")]
    assert len(named) == 1
    assert np.isfinite(run["truth/los"].values).all()


def test_there_is_a_command_for_each_class() -> None:
    assert len(LINES) == 4


def test_the_pulses_last_20_ms_and_come_twice_a_second() -> None:
    pulses = runpy.run_path(str(FILE))["ThrusterPulses"](RunConfig(seed=4))
    pulses.reset()
    rows = np.zeros((60_000, DISTURBANCE_SIZE))
    for row in rows:
        pulses.step(row)
    on = rows[:, 23] > 0.0
    assert not np.delete(rows, [23, 27], axis=1).any()
    edges = np.diff(np.r_[0, on.astype(int), 0])
    lengths = np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
    assert lengths[:-1].min() >= 20
    assert 80 < len(lengths) < 160  # 120 expected in a minute, less where they overlap


def test_the_observer_holds_the_frame_and_subtracts_the_mirror() -> None:
    observer, y, out = runpy.run_path(str(FILE))["CameraObserver"](), np.zeros(MEASUREMENTS), np.zeros(2)
    observer.reset()
    for tick in range(10_000):
        y[:] = 0.0
        y[CAMERA] = (3e-6, -1e-6) if tick % 20 == 0 else np.nan
        y[20:22] = 1e-5
        observer.step(y, out)
    np.testing.assert_allclose(out, [2e-6, -2e-6], rtol=1e-6)
