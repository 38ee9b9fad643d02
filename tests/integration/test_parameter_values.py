"""Parameters off their nominal values in runs, comparisons of stages and campaigns: one member everywhere."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign import adversarial
from los_testbed.campaign.dataset import Campaign
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.reproduction import member_command
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import completed, layered
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.stages import Plan
from los_testbed.run.summary.ran_loop import RanLoop
from support.command_line import refused

from lftkit.arrays import FloatArray
from pointing_analysis.read.run import Run
from titop_plant.simulation.plant_config import parameter_values, stated_values
from titop_plant.telescope.load import load_telescope

SPREADS = "[uncertain]\nisolator.stiffness = 0.1\nisolator.damping = 0.5\ncamera_los.gain = 0.05\n"
SPREADS += "solar_array.damping = 0.5\n"
MEMBER = {
    "isolator.stiffness": 1.03,
    "isolator.damping": 0.6,
    "solar_array.damping": 0.7,
    "wheel_2.speed": 120.0,
    "solar_array.tau": 0.2,
}
SHORT = {"mode": "inprocess", "duration": 0.5, "loop": "fsm+pma", "noise": False}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """A telescope with uncertain factors, and one whose file has the values of `MEMBER`."""
    folder, table = tmp_path_factory.mktemp("telescopes"), load_telescope().isolator
    uncertain, certain = folder / "uncertain.toml", folder / "certain.toml"
    uncertain.write_text('base = "reference"\n' + SPREADS)
    stiffness, damping = [1.03 * k for k in table.stiffness], [0.6 * d for d in table.damping]
    arrays = f"[solar_array]\ndamping = {0.7 * load_telescope().to_mapping()['solar_array']['damping']!r}\n"
    certain.write_text(f"base = 'reference'\n{arrays}[isolator]\nstiffness = {stiffness}\ndamping = {damping}\n")
    return str(uncertain), str(certain)


def los_of(settings: Mapping[str, object], bag: Path) -> FloatArray:
    run_in_process(completed({**SHORT, **settings}), bag)
    return np.array(Run.open(bag)["truth/los"].values)


@pytest.mark.parametrize(("scenario", "within"), [("unit_norm", 1e-9), ("worst_case", 1e-4)])  # a tone is searched
def test_a_run_has_the_values_of_its_parameters(
    scenario: str, within: float, files: tuple[str, str], tmp_path: Path
) -> None:
    """It is the run of a telescope whose file has these values; tone, start and prediction are of the same member."""
    uncertain, certain = files
    stated = {"parameters": uncertain, "scenario": scenario, "parameter_values": MEMBER}
    by_options = {"tau": 0.2, "wheel_speed": [*load_telescope().default_speeds]}
    by_options["wheel_speed"][1] = 120.0  # type: ignore[index]
    found = los_of(stated, tmp_path / "named")
    expected = los_of({"parameters": certain, "scenario": scenario, **by_options}, tmp_path / "certain")
    nominal = los_of({"parameters": uncertain, "scenario": scenario, **by_options}, tmp_path / "nominal")
    size = float(np.abs(expected).max())
    assert np.abs(found - expected).max() < within * size
    assert np.abs(nominal - expected).max() > 1e-3 * size

    run = Run.open(tmp_path / "named")
    ran = RanLoop.of(run).known
    assert parameter_values(ran.settings, ran.telescope) == {**ran_nominal(uncertain), **MEMBER}
    text = str(run.parameters["member"])
    assert "isolator.stiffness 1.03" in text and "120" in text and f"arrays at {4 * np.arctan(0.2):.6g} rad" in text
    speeds = json.loads(str(run.parameters["wheel_speeds_rad_s"]))
    assert speeds[1] == 120.0
    other = RanLoop.of(Run.open(tmp_path / "certain")).known
    predicted, independent = (parts.tone_model().loop.spectral_radius() for parts in (ran, other))
    assert predicted == pytest.approx(independent, rel=1e-9)


def ran_nominal(parameters: str) -> dict[str, float]:
    """Speeds of the file, and the angle, which a run always states."""
    telescope = load_telescope(parameters)
    return {f"wheel_{i}.speed": speed for i, speed in enumerate(telescope.default_speeds, start=1)}


def test_members_of_stages_and_campaigns_have_the_values(files: tuple[str, str], tmp_path: Path) -> None:
    uncertain, _ = files
    stated = {"isolator.stiffness": 1.03, "wheel_2.speed": 120.0}
    base = RunConfig.from_mapping({**SHORT, "parameters": uncertain, "parameter_values": stated})
    telescope = load_telescope(uncertain)
    plan = Plan(base, tmp_path / "stages", ("imbalance", "worst_case"), 3)
    drawn = {run.member: stated_values(run.config, telescope) for run in plan.runs}
    assert all(values[name] == value for values in drawn.values() for name, value in stated.items())
    assert drawn["sample-1"]["isolator.damping"] != drawn["sample-2"]["isolator.damping"]

    base = replace(base, scenario="unit_norm", duration=1.0)
    asked = Campaign.of(base, "uniform", 2, 1, "time", {})
    assert asked.parameters.columns == (
        *("tau", "wheel_speed_1", "wheel_speed_3", "wheel_speed_4"),
        *("omega_1", "omega_2", "isolator.damping", "camera_los.gain", "solar_array.damping"),
    )
    row = next(asked.chunks())[1][0]
    config = replace(base, **asked.parameters.settings(row))
    values = stated_values(config, telescope)
    assert values == {**asked.parameters.checked(row), **stated} and set(values) == set(telescope.uncertain)
    command = member_command(row, base, "time")
    assert " --set isolator.stiffness=1.03" in command and " 120.0 " in command
    evaluator = MemberEvaluator.of(base)
    whole = MemberParameters.of(uncertain)
    other = {column: values[name] for column, name in zip(whole.columns, whole.ranges)} | {"seed": row["seed"]}
    without = MemberEvaluator.of(replace(base, parameter_values=None))
    for depth in ("time", "model"):
        found, expected = evaluator.row(0, row, depth), without.row(0, other, depth)
        assert found["status"] == "ok"
        shared = [name for name in found if name not in ("index", "seed", "status", "reason", "hash")]
        assert all(found[name] == expected[name] for name in shared)


def test_a_later_layer_wins_by_whatever_name() -> None:
    first: dict[str, object] = {"theta": 0.3, "wheel_speed": [1.0, 2.0, 3.0, 4.0], "omega_1": 0.73}
    named = {"parameter_values": {"wheel_2.speed": 120.0, "solar_array.omega_1": 0.75}}
    above = layered(first, named)["parameter_values"]
    assert above["wheel_2.speed"] == 120.0 and above["wheel_3.speed"] == 3.0 and above["solar_array.omega_1"] == 0.75
    assert above["solar_array.tau"] == pytest.approx(np.tan(0.075), rel=1e-15)
    assert layered(named, first)["parameter_values"]["wheel_2.speed"] == 2.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--set", "isolator.stiffness=1.03"],
            r"unknown parameter 'isolator\.stiffness', expected one of: wheel_1\.speed, ",
        ),
        (["--set", "whel_2.speed=1200"], r"unknown parameter 'whel_2\.speed': did you mean wheel_2\.speed\?"),
        (["--set", "wheel_2.speed=1200"], r"wheel_2\.speed must be between -1047\.2 and 1047\.2 rad/s, got 1200"),
        (["--set", "wheel_2.speed=fast"], r"wheel_2\.speed must be a number, got 'fast'"),
        (["--set", "solar_array.tau=0.2", "--theta", "0.5"], r"solar_array\.tau must be given once"),
        (["--set", "wheel_2.speed=1", "--set", "wheel_2.speed=2"], r"wheel_2\.speed must be given once, got 1 and 2"),
        (["--set", "solar_array.omega_1=0.74", "--omega-1", "0.75"], r"omega_1 must be given once"),
    ],
)
def test_other_values_are_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["--output", str(tmp_path / "bag")]
    assert re.search(message, refused(capsys, "run", "--mode", "inprocess", *words, *output))
    if "--set" in words[:1] and not any(word.startswith("--theta") or word == "--omega-1" for word in words):
        assert re.search(message, refused(capsys, "stages", *words, *output))
        assert re.search(message, refused(capsys, "campaign", *words, *output))


def test_a_configuration_file_has_them_by_name(files: tuple[str, str], tmp_path: Path) -> None:
    from los_testbed.cli.run import configure

    file = tmp_path / "run.yaml"
    values = "".join(f"  {name}: {value}\n" for name, value in MEMBER.items())
    file.write_text(f"parameters: {files[0]}\nscenario: unit_norm\nmode: inprocess\nparameter_values:\n{values}")
    config = configure(file, ["wheel_3.speed=7"], {"output": str(tmp_path / "bag")})
    assert config.parameter_values == {**MEMBER, "wheel_3.speed": 7.0}
    assert RunConfig.from_mapping(config.to_plain()) == config and hash(config) == hash(replace(config))
    assert stated_values(RunParts(config).config, load_telescope(files[0]))["wheel_3.speed"] == 7.0


def test_a_search_of_members_keeps_the_values(files: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its points vary the other parameters; the loop that it searches is that of the values."""
    monkeypatch.setattr(adversarial, "MOST_ASCENTS", 1)
    stated = {"isolator.stiffness": 1.03, "solar_array.tau": 0.2}
    base = RunConfig.from_mapping({**SHORT, "noise": True, "parameters": files[0], "parameter_values": stated})
    asked = Campaign.of(base, "adversarial", 2, 1, "model", {})
    assert asked.points.shape == (2, len(load_telescope(files[0]).uncertain) - 2)
    loop = RunParts(replace(base, scenario="design")).implemented_loop(stated)
    assert not set(loop.names) & set(stated)
    rest = dict(zip(asked.parameters.ranges, map(float, asked.points[0])))
    whole = RunParts(replace(base, scenario="design")).implemented_loop()
    for own, other in zip(loop.sampled_at(rest)[0].matrices, whole.sampled_at({**rest, **stated})[0].matrices):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_a_hard_mounted_payload_has_no_isolator(files: tuple[str, str], tmp_path: Path) -> None:
    """The stage none runs with the parameters that it has."""
    stated = {"parameters": files[0], "loop": "none", "scenario": "imbalance", "wheel_speed": [100.0] * 4}
    own = {"solar_array.damping": 0.7, "isolator.stiffness": 1.03}
    found = los_of({**stated, "parameter_values": own}, tmp_path / "named")
    expected = los_of({**stated, "parameters": files[1]}, tmp_path / "certain")
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()
