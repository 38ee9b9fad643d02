"""What a controller was made for, against the telescope of a run: refused, warned about, or taken over."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts, build_controller, build_estimator
from los_testbed.run.metadata import run_metadata
from los_testbed.run.replay import controllers
from simple_telescope import SimpleTelescope, write_controllers
from support.loop_rows import COMMANDS

from lftkit import SampledSystem
from lftkit.errors import InputError
from los_design.synthesis.store import load_designs
from pointing_analysis.read.run import Run
from titop_plant.interface import FORCES, MIRROR, STAGES, design_warnings
from titop_plant.telescope.load import load_telescope

pytestmark = pytest.mark.usefixtures("without_pictures")

REFERENCE = load_telescope()


def toml(value: Any) -> str:
    """A value of a TOML file."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Path of every number in a parameter file."""
    if isinstance(value, (int, float)):
        yield path
    elif isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from numbers(item, (*path, key))


def changed(value: Any, path: tuple[Any, ...]) -> Any:
    """The value with the number at `path` larger by 3 %, an integer by 1."""
    if not path:
        return value + 1 if isinstance(value, int) else 1.03 * value if value else 0.03
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = changed(value[path[0]], path[1:])
    return copy


def user_file(path: Path, number: tuple[Any, ...]) -> Path:
    """A user's parameter file in which this number is another one."""
    depth = next((i for i, key in enumerate(number) if isinstance(key, int)), len(number))
    value: Any = REFERENCE.to_mapping()
    for key in number[:depth]:
        value = value[key]
    # a frame rate divides that of the ticks
    other = 0.5 * value if number == ("sensors", "camera_rate") else changed(value, number[depth:])
    path.write_text(f"base = 'reference'\n{'.'.join(number[:depth])} = {toml(other)}\n")
    return path


def refused(file: Path) -> bool:
    """Whether the file is refused as its arrays are no bodies."""
    try:
        load_telescope(file)
    except InputError as error:
        return str(file) in str(error) and "must be a body" in str(error)
    return False


def sensitive(path: Path, value: float = 0.2, table: str = "los_sensitivity") -> Path:
    path.write_text(f"base = 'reference'\n[fsm]\n{table} = {value}\n")
    return path


@pytest.mark.further
def test_no_number_of_the_parameter_file_changes_unnoticed(tmp_path: Path) -> None:
    """A controller made for the reference is refused or warned about, whatever number the user's file changes.

    The file itself is refused where an array is no body with it: an inertia of which one side of the diagonal changes.
    """
    known, pair = REFERENCE.design_basis.parameters_hash, load_designs("implemented")
    without = REFERENCE.linear_tables()
    walked = list(numbers(without))
    tables = {number[0] for number in walked}
    assert {"fsm", "pma", "sensors", "optics", "isolator", "payload", "body", "solar_array", "weights"} <= tables
    hashes, no_bodies = set(), 0
    for number in walked:
        file = user_file(tmp_path / "user.toml", number)
        if number[0] == "solar_array" and refused(file):
            no_bodies += 1
            continue
        basis = load_telescope(file).design_basis
        assert basis.parameters_hash is not None
        hashes.add(basis.parameters_hash)
        if number == ("fsm", "los_sensitivity"):
            with pytest.raises(ValueError, match=r"los_sensitivity of its design must be 0\.103, got 0\.1"):
                design_warnings(pair, basis, closed=True)
            continue
        lines = design_warnings(pair, basis, closed=True)
        assert len(lines) == 2, number
        assert all(f"parameters_hash {known}" in line and basis.parameters_hash in line for line in lines), number
    assert len(hashes) + no_bodies == len(walked) and known not in hashes and no_bodies < 0.1 * len(walked)


@pytest.mark.parametrize("loop", STAGES)
def test_another_sensitivity_is_refused_where_it_closes_a_loop(tmp_path: Path, loop: str) -> None:
    config = RunConfig(parameters=str(sensitive(tmp_path / "user.toml")), loop=loop)
    builders = (build_estimator, build_controller, lambda config: RunParts(config).check())
    if loop in ("fsm", "fsm+pma"):
        for build in builders:
            with pytest.raises(ValueError, match=r"K_FSM, implemented: fsm\.los_sensitivity .* must be 0\.2, got 0\.1"):
                build(config)
    else:
        assert all(build(config) for build in builders)
        (line,) = RunParts(config).check()
        assert "los_sensitivity 0.1" in line and "los_sensitivity 0.2" in line


def test_the_mirror_law_takes_its_gain_from_the_observer(tmp_path: Path) -> None:
    """From the file; where the file says nothing, from the telescope."""
    files, user = write_controllers(tmp_path), str(sensitive(tmp_path / "user.toml"))
    silent = RunConfig(loop="fsm", **files)
    assert build_controller(silent).los_sensitivity == 0.1
    assert build_controller(replace(silent, parameters=user)).los_sensitivity == 0.2
    assert RunParts(replace(silent, parameters=user)).check() == ()
    own = replace(SampledSystem.from_file(files["k_fsm"]), design_basis={"los_sensitivity": 0.2})
    own.to_file(tmp_path / "own.json")
    said = replace(silent, k_fsm=str(tmp_path / "own.json"))
    out = np.zeros(COMMANDS)
    build_controller(replace(said, parameters=user)).step(np.array([1e-6, -2e-6]), np.zeros(6), out)
    np.testing.assert_allclose(out[MIRROR], [-5e-6, 1e-5], rtol=1e-14)
    with pytest.raises(ValueError, match=r"test observer: fsm\.los_sensitivity of its design must be 0\.1, got 0\.2"):
        build_controller(said)


def test_the_limits_are_the_telescopes_unless_the_run_has_its_own(tmp_path: Path) -> None:
    user = tmp_path / "user.toml"
    user.write_text("base = 'reference'\n[fsm]\nauthority = 2e-3\n[pma]\nauthority = 12.0\n")
    config = RunConfig(parameters=str(user), **write_controllers(tmp_path))
    assert RunParts(config).basis.authority == (2e-3, 12.0)
    out = np.zeros(COMMANDS)
    build_controller(config).step(np.array([1.0, -1.0]), np.full(6, 1e6), out)
    np.testing.assert_array_equal(np.abs(out[MIRROR]), 2e-3)
    np.testing.assert_array_equal(out[FORCES], 12.0)
    assert run_metadata(RunParts(config))["fsm_authority"] == "0.002"
    assert RunParts(replace(config, fsm_authority=1e-3)).basis.authority == (1e-3, 12.0)
    assert json.loads(run_metadata(RunParts(replace(config, pma_authority=5.0)))["pma_authority"]) == 5.0


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    from los_testbed.run.loop.simulate import run_in_process

    files = write_controllers(tmp_path)
    run_in_process(RunConfig(duration=0.2, mode="inprocess", **files), tmp_path / "bag", SimpleTelescope())
    return tmp_path / "bag"


def test_a_replay_compares_with_the_telescope_of_the_bag(recorded: Path, tmp_path: Path) -> None:
    own = SampledSystem.from_file(tmp_path / "k_fsm.json")
    other = tmp_path / "other.json"
    replace(own, design_basis={"los_sensitivity": 0.2}).to_file(other)
    with pytest.raises(ValueError, match=r"must be 0\.1, got 0\.2"):
        controllers(Run.open(recorded), k_fsm=other)
    replace(own, design_basis={"parameters_hash": "0123456789ab"}).to_file(other)
    (line,) = controllers(Run.open(recorded), k_fsm=other).warnings
    assert "0123456789ab" in line
    assert controllers(Run.open(recorded)).warnings == ()


@pytest.mark.parametrize(
    ("basis", "message"),
    [
        ({"los_sensitvity": 0.1}, "keys of design_basis must be among parameters_hash, .*, got 'los_sensitvity'"),
        ({"los_sensitivity": 0.0}, "los_sensitivity must be positive and finite, got 0"),
        ({"fsm_authority": True}, "fsm_authority must be a number, got True"),
    ],
)
def test_a_file_that_says_it_wrongly(tmp_path: Path, basis: Any, message: str) -> None:
    path = Path(write_controllers(tmp_path)["k_fsm"])
    path.write_text(json.dumps({**json.loads(path.read_text()), "design_basis": basis}))
    with pytest.raises(ValueError, match=message) as caught:
        RunParts(RunConfig(k_fsm=str(path))).check()
    assert "\n" not in str(caught.value)
