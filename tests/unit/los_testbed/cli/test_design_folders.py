"""Folders of designs: what a run takes from them, and what is refused before any work is done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from los_testbed.cli.designs.folders import name_unseen_requirements
from los_testbed.cli.designs.redesign import check_output
from los_testbed.cli.run import configure
from los_testbed.config.members import WORST_POINTS, worst_member
from los_testbed.config.run_settings import TELESCOPE_FILE, of_designs

from los_design.synthesis.store import design_file
from titop_plant.interface import STAGES
from titop_plant.telescope.load import load_telescope

SOFT = "[isolator]\nstiffness = [1.33e6, 1.33e6, 1.33e6, 0.365e6, 0.52e6, 0.8825e6]\n"


@pytest.fixture
def soft(tmp_path: Path) -> Path:
    file = tmp_path / "soft.toml"
    file.write_text(SOFT, "utf-8")
    return file


@pytest.fixture
def folder(tmp_path: Path, soft: Path) -> Path:
    """A folder of designs for the soft telescope, the controllers those that ship."""
    made = tmp_path / "designs"
    check_output(made, soft)
    for kind in ("k-fsm", "k-pma"):
        (made / f"{kind.replace('-', '_')}.json").write_bytes(design_file(kind).read_bytes())
    values = {f"wheel_{i}.speed": 100.0 * i for i in range(1, 5)}
    values |= {"solar_array.omega_1": 0.75, "solar_array.omega_2": 2.6, "solar_array.tau": 0.25}
    point = {"parameters": values, "omega": 400.0, "gamma": 0.9, "limit": 1e-7}
    stages = {stage: dict.fromkeys(("APE", "RPE", "slow", "fast"), point) for stage in STAGES}
    content = {"parameters_hash": load_telescope(soft).parameters_hash, "stages": stages}
    (made / WORST_POINTS).write_text(json.dumps(content), "utf-8")
    return made


def test_a_run_takes_controllers_telescope_and_worst_point(folder: Path) -> None:
    config = configure(None, [], {"output": "bag", "mode": "inprocess"}, designs=str(folder))
    assert config.k_fsm == str(folder / "k_fsm.json") and config.k_pma == str(folder / "k_pma.json")
    assert config.parameters == str(folder / TELESCOPE_FILE)
    assert (config.tau, config.wheel_speed) == (0.25, (100.0, 200.0, 300.0, 400.0))
    assert load_telescope(config.parameters) == load_telescope(folder / TELESCOPE_FILE)


def test_worst_points_of_another_telescope_are_not_used(folder: Path, soft: Path) -> None:
    assert worst_member("fsm", "fast", str(soft), str(folder))["omega_2"] == 2.6
    assert worst_member("fsm", "fast", "", str(folder)) == {}
    assert worst_member("fsm", "fast", str(soft)) == {}
    assert set(worst_member("fsm+pma", "RPE")) == {"tau", "wheel_speed", "omega_1", "omega_2"}


def test_a_folder_without_a_controller_is_refused(folder: Path) -> None:
    (folder / "k_pma.json").unlink()
    with pytest.raises(ValueError, match=r"designs must hold k_fsm\.json and k_pma\.json"):
        of_designs(str(folder))


def test_requirements_that_a_design_does_not_see_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name_unseen_requirements(load_telescope())
    assert capsys.readouterr().err == ""
    table = '[[requirement]]\nname = "slow"\ntext = "prob(rms RPE(250 ms) < 100 mas) >= 0.99 at 90 % confidence"\n'
    (tmp_path / "mission.toml").write_text(table)
    name_unseen_requirements(load_telescope(tmp_path / "mission.toml"))
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "the design does not consider slow (prob(rms RPE(250 ms) < 100 mas)" in said
