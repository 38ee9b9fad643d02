"""A run in one process with further sensors and a driven actuator: what its bag holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

from pointing_analysis.read.run import Run

TEXT = """
[[sensor]]
name = "on_m1"
place = "M1"
noise = 0.0

[[sensor]]
name = "limited"
place = "A1"
axes = [[0.0, 0.0, 1.0]]
range = 1e-3

[[actuator]]
name = "shaker"
place = "A1"
axis = [0.0, 0.0, 1.0]

[[disturbance]]
name = "sine"
kind = "cooler"
place = "shaker"
frequency = 40.0
harmonics = [{ order = 1, force = [0.0, 0.0, 2.0] }]
"""


def test_a_bag_has_the_sensors_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(TEXT)
    config = RunConfig(
        duration=1.0, loop="fsm", scenario="imbalance", noise=False, start="rest", parameters=str(tmp_path / "own.toml")
    )
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    own, loop = run["sensor/on_m1"], run["m1/accel"]
    assert own.values.shape == (1000, 3) and np.array_equal(own.stamp, loop.stamp)
    assert own.values == pytest.approx(loop.values[:, :3], abs=1e-12)  # also what the source adds
    limited = run["sensor/limited"].values[:, 0]
    assert np.abs(limited).max() == 1e-3
    assert [topic.unit for topic in RunParts(config).topics[-2:]] == ["m/s2", "m/s2"]


def test_an_actuator_has_one_source_and_its_limit(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(TEXT)
    config = RunConfig(duration=1.0, scenario="imbalance", parameters=str(tmp_path / "own.toml"))
    (source,) = RunParts(config).sources
    assert source.limit == 31.6
    again = TEXT[TEXT.index("[[disturbance]]") :].replace('"sine"', '"other"')
    (tmp_path / "own.toml").write_text(TEXT + again)
    with pytest.raises(ValueError, match="actuator shaker must have one source, got 2"):
        _ = RunParts(config).sources
