"""Limits of the devices are those of the telescope's file, in runs that have them."""

from pathlib import Path

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import announced

from titop_plant.interface import FSM_ANGLE, MIRROR, TRUTH
from titop_plant.telescope.load import load_telescope


def test_a_run_has_the_limits_of_its_telescope(tmp_path: Path) -> None:
    """The mirror follows a step no faster than its rate, and its gauges round; without `nonlinear` neither."""
    file = tmp_path / "slow.toml"
    file.write_text("base = 'reference'\n[device_limits]\nmirror_rate = 0.01\ngauge_step = 1e-6\n")
    angles: dict[bool, list[float]] = {}
    for nonlinear in (True, False):
        parts = RunParts(RunConfig(parameters=str(file), nonlinear=nonlinear, noise=False, loop="fsm"))
        plant, command = parts.plant(), np.zeros(parts.ports.commands)
        measured, truth = np.zeros(parts.ports.measurements), np.zeros(TRUTH)
        angles[nonlinear] = []
        for tick in range(40):
            command[MIRROR] = 1e-3 * (tick > 0)
            plant.step(command, measured, truth)
            angles[nonlinear].append(measured[FSM_ANGLE][0])
    slow = np.array(angles[True])
    np.testing.assert_allclose(slow / 1e-6, np.round(slow / 1e-6), atol=1e-6)
    assert slow[-1] < 0.5e-3 < angles[False][-1]
    assert load_telescope(file).digest == load_telescope().digest, "no design depends on them"


def test_the_plant_of_a_run_is_told_apart_by_limits_that_act(tmp_path: Path) -> None:
    file = tmp_path / "slow.toml"
    file.write_text("base = 'reference'\n[device_limits]\nmirror_rate = 0.01\n")
    for nonlinear in (True, False):
        plants = [announced(RunParts(RunConfig(parameters=p, nonlinear=nonlinear)))["plant"] for p in (None, str(file))]
        assert (plants[0] != plants[1]) == nonlinear
