"""Campaigns take what their members differ in from the telescope: any number of wheels, arrays and appendages."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.reproduction import member_command
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import with_stage
from support.command_line import call_command

from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop_norms import weighted_gains

SMALL = Path(__file__).parents[4] / "examples" / "spacecraft" / "small_telescope.toml"
WHEEL = """
[[reaction_wheel]]
name = "w{i}"
axis = [{x:.6f}, {y:.6f}, 0.5]
position = [{x:.6f}, {y:.6f}, 0.0]
default_speed = {speed:.1f}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Parameter files by what is special of them."""
    folder = tmp_path_factory.mktemp("telescopes")
    angles = 2.0 * np.pi * np.arange(8) / 8
    wheels = "".join(
        WHEEL.format(i=i, x=0.2 * np.cos(a), y=0.2 * np.sin(a), speed=150.0 + 20.0 * i) for i, a in enumerate(angles)
    )
    texts = {"no arrays": "solar_array = []\n", "eight wheels": wheels}
    for name, text in texts.items():
        (folder / f"{name.replace(' ', '_')}.toml").write_text('base = "reference"\n' + text, "utf-8")
    made = {name: str(folder / f"{name.replace(' ', '_')}.toml") for name in texts}
    return {"small": str(SMALL), **made}


COLUMNS = {
    "small": ("wheel_speed_1", "wheel_speed_2", "wheel_speed_3", "panel.omega_1"),
    "no arrays": ("wheel_speed_1", "wheel_speed_2", "wheel_speed_3", "wheel_speed_4"),
    "eight wheels": ("tau", *(f"wheel_speed_{i}" for i in range(1, 9)), "omega_1", "omega_2"),
}


def member(parameters: str) -> dict[str, Any]:
    own = MemberParameters.of(parameters)
    point = map(float, members("uniform", 1, 4, parameters)[0])
    return {**dict(zip(own.columns, point)), "seed": int(member_seeds(1, 4)[0])}


def as_commanded(base: RunConfig, values: dict[str, Any], folder: Path, capsys: Any) -> dict[str, Any]:
    """Row of a member, whose command gives its largest relative error to the printed digits."""
    row = MemberEvaluator.of(base).row(0, values, "time")
    assert row["status"] == "ok", row["reason"]
    words = shlex.split(member_command({**values, **row}, base, "time"))[1:]
    code, out, err = call_command(capsys, *words, "--no-report", "--output", str(folder / "bag"), "--json")
    assert code == 0, err
    found = json.loads(out.splitlines()[-1])
    assert found["rpe_mas"]["windows_p997"] == float(f"{row['rpe_window_p997_mas']:.6g}")
    return row


@pytest.mark.further
@pytest.mark.parametrize("name", list(COLUMNS))
def test_the_command_of_a_member_gives_its_row(name: str, files: dict[str, str], tmp_path: Path, capsys: Any) -> None:
    """The last stage that the telescope has is the one of a campaign and of a run that name none."""
    base = RunConfig.from_mapping(with_stage({"mode": "inprocess", "duration": 1.04, "parameters": files[name]}))
    as_commanded(replace(base, scenario="design"), member(files[name]), tmp_path, capsys)


def test_the_command_of_a_member_has_every_setting_of_the_campaign(capsys: Any, tmp_path: Path) -> None:
    """Two frames late, an authority that is reached, lost samples: each of them changes the figure."""
    own = {"fsm_authority": 2e-6, "camera_latency": 40.0, "camera_dropout": 0.2, "noise": False, "old_frames": "use"}
    base = RunConfig(mode="inprocess", duration=1.2, scenario="design", **own)  # type: ignore[arg-type]
    row = as_commanded(base, member(""), tmp_path, capsys)
    plain = MemberEvaluator.of(replace(base, fsm_authority=None)).row(0, member(""), "time")
    assert plain["rpe_window_p997_mas"] != row["rpe_window_p997_mas"]


@pytest.mark.parametrize("name", ["small", *(pytest.param(n, marks=pytest.mark.further) for n in tuple(COLUMNS)[1:])])
def test_the_gain_of_a_member_at_depth_model_is_that_of_its_assembled_loop(name: str, files: dict[str, str]) -> None:
    """By the periodic solution of the loop that is closed with this member's plant."""
    parameters = files[name]
    base = RunConfig.from_mapping(with_stage({"mode": "inprocess", "parameters": parameters}))
    evaluator, values = MemberEvaluator.of(base), member(parameters)
    row = evaluator.row(0, values, "model")
    assert row["status"] == "ok", row["reason"]
    telescope, own = evaluator.family.telescope, MemberParameters.of(parameters)
    plant = evaluator.family.control_loop.at(own.checked(values))
    laws = ControlLaws(
        evaluator.controllers["k_fsm"],
        evaluator.controllers["k_pma"],
        base.loop,
        telescope.loop_ports,
        telescope.fsm.los_sensitivity,
    )
    closed = sampled_loop(plant, laws)
    near = row["rpe_peak_rad_s"] * (1.0 + np.linspace(-2e-3, 2e-3, 81))
    peak = float(weighted_gains(closed, plant, telescope, near)[1].max()) / telescope.weights.rpe_limit_fine
    assert row["rpe_fine_gain"] == pytest.approx(peak, rel=0.02)
