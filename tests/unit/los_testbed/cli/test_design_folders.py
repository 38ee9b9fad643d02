"""Folders of designs: what a run takes from them, the telescope with its files, what is proven, what is refused."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from los_testbed.api import designs
from los_testbed.api.designs import design, prove_designs, unseen_requirements
from los_testbed.cli.run import configure
from los_testbed.config.members import worst_member
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import telescope_digest
from support.command_line import call_command

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.support.workers import Workers
from los_design.files import CONTROLLERS, ROUNDS, TELESCOPE, WORST_POINTS
from los_design.folder import load_folder, store_telescope
from los_design.synthesis.store import design_file
from titop_plant.interface import STAGES
from titop_plant.structures.modal_file import write_modal_data
from titop_plant.telescope.bodies import build_payload
from titop_plant.telescope.guide_camera import STORED_CURVES
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

SOFT = "[isolator]\nstiffness = [1.33e6, 1.33e6, 1.33e6, 0.365e6, 0.52e6, 0.8825e6]\n"


@pytest.fixture
def soft(tmp_path: Path) -> Path:
    file = tmp_path / "soft.toml"
    file.write_text('base = "reference"\n' + SOFT, "utf-8")
    return file


@pytest.fixture
def folder(tmp_path: Path, soft: Path) -> Path:
    """A folder of designs for the soft telescope, the controllers those that ship."""
    made = tmp_path / "designs"
    store_telescope(made, soft)
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
    assert config.parameters == str(folder / TELESCOPE)
    assert (config.tau, config.wheel_speed) == (0.25, (100.0, 200.0, 300.0, 400.0))
    assert load_telescope(config.parameters) == load_telescope(folder / TELESCOPE)


def test_worst_points_of_another_telescope_are_not_used(folder: Path, soft: Path) -> None:
    assert worst_member("fsm", "fast", str(soft), str(folder))["omega_2"] == 2.6
    assert worst_member("fsm", "fast", "", str(folder)) == {}
    assert worst_member("fsm", "fast", str(soft)) == {}
    assert set(worst_member("fsm+pma", "RPE")) == {"tau", "wheel_speed", "omega_1", "omega_2"}


def test_a_folder_without_a_controller_is_refused(folder: Path) -> None:
    (folder / "k_pma.json").unlink()
    with pytest.raises(ValueError, match=r"designs must hold k_fsm\.json and k_pma\.json"):
        of_designs(str(folder))


def test_requirements_that_a_design_does_not_see_are_named(tmp_path: Path) -> None:
    assert not unseen_requirements(load_telescope())
    table = '[[requirement]]\nname = "slow"\ntext = "prob(rms RPE(250 ms) < 100 mas) >= 0.99 at 90 % confidence"\n'
    (tmp_path / "mission.toml").write_text('base = "reference"\n' + table)
    (line,) = unseen_requirements(load_telescope(tmp_path / "mission.toml"))
    assert "the design does not consider slow (prob(rms RPE(250 ms) < 100 mas)" in line


PANEL = """
format = "los-testbed/modal-data"
version = 1
name = "antenna"
parent = "P"
parent_position = [0.0, 0.0, 0.0]
mass = 1.0
inertia_at_cg = [[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]]
cg = [0.0, 0.0, -0.1]

[[mode]]
frequency = 9.2
damping = 0.05
participation = [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]
shapes = {}
"""


def payload(folder: Path) -> str:
    write_modal_data(build_payload(load_telescope()), folder / "payload.toml")
    return '[payload]\nmodal_data = "payload.toml"\n'


def appendage(folder: Path) -> str:
    (folder / "panel.toml").write_text(PANEL, "utf-8")
    return '[[appendage]]\nname = "antenna"\npoint = "A1"\nmodal_data = "panel.toml"\n'


def noise_curve(folder: Path) -> str:
    (folder / "curve.json").write_bytes(STORED_CURVES.read_bytes())
    return '[camera]\nnoise_curve = "curve.json"\nmagnitude = 12.0\n[sensors]\ncamera = "magnitude"\n'


def disturbance(folder: Path) -> str:
    (folder / "shake.csv").write_text("time (s),Fx (N)\n0,0.0\n1,1.0\n2,0.0\n", "utf-8")
    return '[[disturbance]]\nname = "shaker"\nkind = "series"\nplace = "payload"\nfile = "shake.csv"\nrepeat = true\n'


@pytest.fixture(params=[payload, appendage, noise_curve, disturbance])
def mine(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A parameter file that names a file beside it."""
    (tmp_path / "mine").mkdir()
    make: Callable[[Path], str] = request.param
    file = tmp_path / "mine" / "mine.toml"
    file.write_text('base = "reference"\n' + make(file.parent), "utf-8")
    return file


def with_controllers(folder: Path, telescope: Telescope) -> None:
    """The shipped controllers, as if they were made for a telescope."""
    for name, path in RunParts(RunConfig()).model_files.items():
        law = SampledSystem.from_file(path)
        made = {**law.design_basis, "parameters_hash": telescope.parameters_hash}
        replace(law, design_basis=made).to_file(folder / CONTROLLERS[name])


def test_a_folder_has_the_telescope_with_its_files_and_can_be_moved(mine: Path, tmp_path: Path) -> None:
    """The same values, noise and sources, when neither the user's file nor the first folder is there any more."""
    wanted = telescope_digest(load_telescope(mine))
    sources = len(RunParts(RunConfig(parameters=str(mine))).sources)
    store_telescope(tmp_path / "designs", mine)
    store_telescope(tmp_path / "designs", mine)  # the same telescope goes on
    store_telescope(tmp_path / "designs", tmp_path / "designs" / TELESCOPE)
    moved = (tmp_path / "designs").rename(tmp_path / "moved")
    mine.parent.rename(tmp_path / "gone")
    file = moved / TELESCOPE
    assert telescope_digest(load_telescope(file)) == wanted
    assert len(RunParts(RunConfig(parameters=str(file))).sources) == sources
    with_controllers(moved, load_telescope(file))
    assert telescope_digest(load_folder(moved)[0]) == wanted


def test_further_uncertain_factors_go_with_files(tmp_path: Path) -> None:
    """They were refused beside a file with files of its own."""
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "reference"\n' + payload(tmp_path), "utf-8")
    store_telescope(tmp_path / "designs", mine, ["isolator.stiffness=10%"])
    found = load_telescope(tmp_path / "designs" / TELESCOPE)
    assert found.spreads == {"isolator.stiffness": 0.1} and Path(found.payload.modal_data).is_file()
    with pytest.raises(ValueError, match="--uncertain must be in the table"):
        store_telescope(tmp_path / "designs", tmp_path / "designs" / TELESCOPE, ["isolator.stiffness=10%"])


def test_a_folder_of_the_api_has_the_telescope_and_its_files(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`design(folder, parameters=...)` left out telescope.toml: runs of the folder had the reference telescope."""

    def design_all(telescope: Telescope, folder: Path, *_: object, **__: object) -> Any:
        with_controllers(folder, telescope)
        return SimpleNamespace(check=None, not_met=[])

    monkeypatch.setattr("los_design.redesign.design_all", design_all)
    result = design(tmp_path / "designs", parameters=mine, workers=1)
    assert result.met and of_designs(str(result.folder))["parameters"] == str(tmp_path / "designs" / TELESCOPE)
    assert telescope_digest(load_folder(result.folder)[0]) == telescope_digest(load_telescope(mine))


@pytest.mark.parametrize("made", ["", ROUNDS, "k_fsm.json"])
def test_a_refused_design_leaves_no_new_folder_but_what_was_made(
    tmp_path: Path, soft: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], made: str
) -> None:
    def refuse(telescope: Telescope, folder: Path, *_: object, **__: object) -> None:
        assert (folder / TELESCOPE).exists()
        if made:
            (folder / made).write_text("{}")
        raise InputError("the controller must stabilise the telescope, got one that does not")

    monkeypatch.setattr("los_design.redesign.design_all", refuse)
    code, _, err = call_command(capsys, "design", "all", "--parameters", soft, "--output", tmp_path / "new")
    assert code == 2 and "must stabilise" in err
    assert (tmp_path / "new").exists() == bool(made)


@pytest.fixture
def loops(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Loops that were to be proven, in place of the proofs of hours."""
    found: list[Any] = []

    def prove(chosen: Any, loops: Any, *_: Any, **__: Any) -> tuple[()]:
        found.append(loops.stages)
        return ()

    monkeypatch.setattr(designs, "prove_figures", prove)
    return found


def proven(telescope: Telescope, folder: Path) -> None:
    """What `design all --certify` does behind the design."""
    with Workers(1) as workers:
        prove_designs(telescope, folder, workers, time.monotonic() + 1.0)


def test_the_telescope_of_the_design_is_proven(tmp_path: Path, loops: list[Any]) -> None:
    """The loop has the poles of the telescope of the file, not of the reference."""
    mine, folder = tmp_path / "mine.toml", tmp_path / "designs"
    mine.write_text('base = "reference"\n' + appendage(tmp_path), "utf-8")
    store_telescope(folder, mine)
    with_controllers(folder, load_telescope(mine))
    proven(load_telescope(mine), folder)
    orders = [loops[0]["fsm"].system.order]
    (tmp_path / "reference").mkdir()
    with_controllers(tmp_path / "reference", load_telescope())
    proven(load_telescope(), tmp_path / "reference")
    assert orders[0] == loops[1]["fsm"].system.order + 2  # the mode of the antenna


def test_another_telescope_or_controllers_of_another_are_not_proven(tmp_path: Path, loops: list[Any]) -> None:
    mine, folder = tmp_path / "mine.toml", tmp_path / "designs"
    mine.write_text('base = "reference"\n' + payload(tmp_path) + "[body]\ndamping = 0.004\n", "utf-8")
    own = load_telescope(mine)
    store_telescope(folder, mine)
    with_controllers(folder, load_telescope())
    with pytest.raises(ValueError, match=f"must be made for the telescope there.*{own.parameters_hash}"):
        proven(own, folder)
    with_controllers(folder, own)
    (folder / TELESCOPE).unlink()
    with pytest.raises(ValueError, match=f"must be of the telescope {own.parameters_hash} to be proven"):
        proven(own, folder)
    assert not loops
