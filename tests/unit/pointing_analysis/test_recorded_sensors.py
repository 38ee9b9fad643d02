"""Sensors that a recording describes: read back exactly, and nothing where the description cannot be read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.recorded_sensors import METADATA, RecordedSensor, sensors_of
from pointing_analysis.read.run import Run
from pointing_analysis.report.signal_files import signals_of
from pointing_analysis.requirements.summary import summarise

GUIDE = RecordedSensor("guide/los", "rad", 10.0, True, (3e-8, 4e-8))
LOST = RecordedSensor("lost/los", "rad", 10.0, True, (1e-8,))


def recording(folder: Path, entries: Any, frames: np.ndarray) -> Run:
    signals = {"truth/los": 1e-7 * np.random.default_rng(1).standard_normal((3000, 2)), "guide/los": frames}
    return Run.open(write_bag(folder, signals, periods={"guide/los": 100}, parameters={METADATA: json.dumps(entries)}))


def test_what_is_written_is_read_and_only_for_topics_that_are_there(tmp_path: Path) -> None:
    frames = np.zeros((30, 2))
    frames[3] = np.nan
    run = recording(tmp_path / "bag", [sensor.to_mapping() for sensor in (GUIDE, LOST)], frames)
    assert sensors_of(run) == (GUIDE,)
    found = summarise(run, transient=0.0)
    assert found.sensors == (GUIDE,) and found.camera_dropped == 1
    assert found.problems == ("guide/los: 1 frame dropped (NaN)",)
    assert found.as_dict()["sensors"] == [GUIDE.to_mapping()]


@pytest.mark.parametrize(
    "change",
    [
        {"rate_hz": 0.0},
        {"rate_hz": "fast"},
        {"rate_hz": float("inf")},
        {"noise": ["loud"]},
        {"noise": 3.0},
        {"noise": [float("nan")]},
        {"held": 1},
        {"topic": 5},
        {"unit": None},
    ],
)
def test_a_description_that_cannot_be_read_is_none(tmp_path: Path, change: dict[str, Any]) -> None:
    entry = {**GUIDE.to_mapping(), **change}
    with pytest.raises(ValueError, match=r"a sensor must have|rate_hz and noise of a sensor must be finite"):
        RecordedSensor.from_mapping(entry)
    assert sensors_of(recording(tmp_path / "bag", [GUIDE.to_mapping(), entry], np.zeros((30, 2)))) == ()


def test_samples_have_the_unit_of_their_description(tmp_path: Path) -> None:
    """A gyroscope has the message type of an angle."""
    gyro = RecordedSensor("guide/los", "rad/s", 10.0, True, (1e-6, 1e-6))
    run = recording(tmp_path / "bag", [gyro.to_mapping()], np.zeros((30, 2)))
    assert (run["guide/los"].unit, run["truth/los"].unit) == ("rad/s", "rad")
    assert signals_of(run, ["guide/los"])[0].heads[0] == "guide/los x [rad/s]"
