"""Lines of stepper drives in the line of sight: from the model of the open plant, and from a run under them alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.source_alone import errors_of_source

from titop_plant.disturbances.drive_lines import fixed_lines, stepper_lines
from titop_plant.interface import DT
from titop_plant.telescope.load import load_telescope

FILE = Path(__file__).parents[2] / "examples/spacecraft/moving_rotors.toml"
SEED = 3


def test_without_steppers_the_drives_are_those_of_the_reference() -> None:
    telescope = load_telescope(str(FILE))
    assert len(telescope.motors) == 2 and not telescope.without_steppers().motors
    assert telescope.without_steppers().sadm == load_telescope().sadm


@pytest.mark.slow
def test_the_lines_make_the_error_of_a_run() -> None:
    """RPE of 20 ms by the lines against that of the simulated open plant under the drives alone, both of this seed."""
    telescope = load_telescope(str(FILE))
    config = RunConfig(
        mode="inprocess",
        loop="isolator",
        scenario="imbalance",
        wheel_speed=(0.0, 0.0, 0.0, 0.0),
        duration=20.0,
        seed=SEED,
        parameters=str(FILE),
    )
    parts = RunParts(config)
    index = [one.name for one in parts.sources].index("array drive")
    los = errors_of_source(parts, index, 20_000)
    ticks = round(0.02 / DT)
    windows = los[: len(los) // ticks * ticks].reshape(-1, ticks, 2)
    run = math.sqrt(float(np.square(windows - windows.mean(axis=1, keepdims=True)).sum(axis=2).mean()))
    lines = stepper_lines(telescope, SEED)
    part = 1.0 - np.square(np.sinc(lines.omega * 0.02 / (2.0 * np.pi)))
    assert run == pytest.approx(math.sqrt(float((lines.size**2 * part).sum() / 2.0)), rel=0.03)
    fixed = fixed_lines(telescope)
    np.testing.assert_allclose(fixed.omega, telescope.sadm.step_frequency * np.arange(1, 6), rtol=1e-12)
