"""One configuration: each setting is an option, a YAML key, a ROS parameter and an entry of the metadata."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml
from los_testbed.cli.app import command_line
from los_testbed.cli.run import configure, with_lone_options
from los_testbed.config.run_config import RunConfig, read_yaml
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import announced
from los_testbed.run.processes.node_launch import parameter_text

from pointing_analysis.read.run import Run

REFERENCE = Path(__file__).parents[4] / "bags" / "reference"

OTHER = {
    "duration": 2.5,
    "mode": "lockstep",
    "loop": "fsm",
    "scenario": "design",
    "worst_of": "slow",
    "start": "rest",
    "seed": 7,
    "noise": False,
    "disturbance": False,
    "camera_rate": 25.0,
    "camera_dropout": 0.25,
    "theta": 0.5,
    "tau": 0.25,
    "wheel_speed": [1.0, 2.0, 3.0, 4.5],
    "omega_1": 0.75,
    "omega_2": 2.5,
    "frequencies": [0.75, 2.5],
    "parameter_values": {"solar_array.omega_1": 0.75},
    "theta_rate": 0.01,
    "wheel_acceleration": [1.0, 0.0, 0.0, -1.0],
    "ramp_duration": 1.5,
    "profile": "trapezoidal",
    "parameters": "mine.toml",
    "fsm_authority": 0.001,
    "pma_authority": 5.0,
    "nonlinear": True,
    "plant": "my:Plant",
    "device": "my:Rig",
    "device_address": "127.0.0.1:5000",
    "device_key": "rig.key",
    "disturbance_source": "my:Wind",
    "disturbance_files": "measured.csv@wheel_2;cooler.toml",
    "k_fsm": "k.json",
    "k_pma": "p.json",
    "ports_in_order": True,
    "hold_ticks": 5,
    "fade_ticks": 7,
    "old_frames": "drop",
    "lost_samples": "hold",
    "camera_latency": 7.0,
    "output": "folder",
    "namespace": "/foo",
    "domain": 3,
    "priority": False,
    "pin": False,
    "wait_for_recorder": True,
    "wait_for_start": True,
    "start_timeout": 5.0,
    "hang_timeout": 30.0,
    "processes": "separate",
    "exercise": 2.0,
    "max_missed": 3.0,
    "mode_choice": "auto",
}
"""A value of each setting that is not the default."""

NEEDS = {"plant": {"start": "rest"}, "device": {"start": "rest"}}
"""Settings that a value of another one asks for."""


OPTIONS = {"disturbance_source": "--disturbance", "disturbance_files": "--disturbance", "parameter_values": "--set"}
"""Options that do not have the name of their setting."""

CHOSEN = ("mode_choice",)
"""What the program notes, and nobody asks for."""

SHARED = ("disturbance", "disturbance_source", "disturbance_files", "parameter_values")
"""Settings whose options are for others, too."""


def changed(name: str) -> RunConfig:
    return RunConfig.from_mapping({**NEEDS.get(name, {}), name: OTHER[name]})


def option_of(name: str) -> typer.core.TyperOption:
    command = command_line().commands["run"]
    flag = OPTIONS.get(name, "--" + name.replace("_", "-"))
    (found,) = [p for p in command.params if flag in p.opts]
    return found


def test_the_values_below_are_those_of_all_settings() -> None:
    assert set(OTHER) == set(RunConfig.SETTINGS)
    for name, own in RunConfig.SETTINGS.items():
        assert bool(own.absent) == own.optional == (own.default is None), name


@pytest.mark.parametrize("name", RunConfig.SETTINGS)
def test_each_setting_is_an_option_a_key_a_ros_parameter_and_an_entry_of_the_metadata(name, tmp_path) -> None:
    own, expected = RunConfig.SETTINGS[name], changed(name)
    value = getattr(expected, name)
    assert value != own.default
    if name not in (*CHOSEN, *SHARED):
        assert (own.description[1:] in option_of(name).help) and (own.absent in option_of(name).help)
    (tmp_path / "run.yaml").write_text(yaml.safe_dump({**NEEDS.get(name, {}), name: OTHER[name]}))
    assert RunConfig.from_file(tmp_path / "run.yaml") == expected
    ros = yaml.safe_load(parameter_text(expected))["/**"]["ros__parameters"]
    stated = json.dumps(OTHER[name]) if own.kind is dict else OTHER[name]
    assert ros[name] == stated and type(ros[name]) is type(stated)
    text = expected.to_strings()[name]
    assert (text if own.kind is str else json.loads(text)) == OTHER[name]
    assert RunConfig.from_mapping(expected.to_mapping()) == expected == RunConfig.from_mapping(expected.to_plain())


@pytest.mark.parametrize("name", [n for n in RunConfig.SETTINGS if n not in (*OPTIONS, *CHOSEN, "output")])
def test_each_option_of_the_command_sets_its_setting(name, tmp_path, monkeypatch) -> None:
    """From the words on the command line to the configuration."""
    seen: dict[str, Any] = {}
    monkeypatch.setattr("los_testbed.cli.run.execute", lambda parts, *_: seen.update(config=parts.config) or 1 / 0)
    own, value = RunConfig.SETTINGS[name], OTHER[name]
    flag = "--" + name.replace("_", "-")
    if own.kind is bool:
        words = [flag if value else f"--no-{flag[2:]}"]
    else:
        words = [flag, *(str(v) for v in (value if isinstance(value, list) else [value]))]
    words = with_lone_options(words)
    if name == "parameters":
        words[1] = str(tmp_path / "mine.toml")
        (tmp_path / "mine.toml").write_text("base = 'reference'\n")
    try:
        command = ["run", "--output", str(tmp_path / "bag"), "--scenario", "design", *words]
        command_line().main(command, standalone_mode=False)
    except ZeroDivisionError:
        pass
    found = getattr(seen["config"], name)
    assert (list(found) if isinstance(found, tuple) else found) == (words[1] if name == "parameters" else value)


def test_the_configuration_of_the_reference_bag_is_read_and_makes_its_plant() -> None:
    run = Run.open(REFERENCE)
    from_file = RunConfig.from_mapping(yaml.safe_load(run.attachments["run.yaml"]))
    limits = ("fsm_authority", "pma_authority")  # those in force
    recorded = {name: value for name, value in run.parameters.items() if name in RunConfig.SETTINGS}
    from_metadata = RunConfig.from_mapping({name: v for name, v in recorded.items() if name not in limits})
    assert announced(RunParts(from_file))["plant"] == run.parameters["plant_hash"]
    assert len(recorded) > 30 and from_metadata == from_file


def test_the_installed_parameter_file_and_no_options_mean_the_defaults(tmp_path) -> None:
    file = Path(__file__).parents[4] / "ros_ws/src/los_testbed/config/run.yaml"
    assert replace(RunConfig.from_file(file), wait_for_recorder=False) == RunConfig()
    chosen = configure(None, [], {"output": str(tmp_path / "bag")})
    assert chosen.scenario == "worst_case"
    member = dict.fromkeys(("scenario", "tau", "wheel_speed", "omega_1", "omega_2"))
    assert replace(chosen, output=None, **member) == RunConfig()


@pytest.mark.parametrize("rate", [1, 12.5, 40, 1000])
def test_camera_rates_that_divide_the_loop_rate(rate):
    assert RunConfig(camera_rate=float(rate)).frame_ticks * rate == 1000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2", "must be YAML"),
        *((t, "must be a YAML file") for t in ("- a\n- b\n", "just words", "")),
    ],
)
def test_a_file_that_is_no_configuration(tmp_path, text, words):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ValueError, match=f"bad.yaml {words}"):
        read_yaml(tmp_path / "bad.yaml")


def digests(**settings):
    return announced(RunParts(RunConfig(**settings)))


def test_the_digest_of_the_plant_depends_on_physics_only(tmp_path):
    """At rest under tones that do not follow from the loop it does not depend on the laws either."""
    still = {"scenario": "imbalance", "start": "rest"}
    base, same = digests(**still), digests(**still, duration=3.0, mode="inprocess", loop="fsm")
    assert base["plant"] == same["plant"] and base["estimator"] == same["estimator"]
    assert base["controller"] != same["controller"]
    changed: list[dict[str, Any]] = [
        {"seed": 2},
        {"theta": 0.1},
        {"noise": False},
        {"loop": "none"},
        {"nonlinear": True},
        {"start": "steady"},
    ]
    assert len({digests(**{**still, **c})["plant"] for c in [{}, *changed]}) == 7
    copied = tmp_path / "copy.toml"
    copied.write_text("base = 'reference'\n")
    assert digests(**still, parameters=str(copied)) == base  # wherever the file of the same values is
    copied.write_text("base = 'reference'\n[sensors]\naccelerometer_noise = [2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4]\n")
    other = digests(**still, parameters=str(copied))
    assert other["plant"] != base["plant"] and other["estimator"] == base["estimator"]


def test_the_digest_of_a_law_is_that_of_its_numbers(tmp_path):
    base = digests()
    law = RunParts(RunConfig()).models["k_fsm"]
    law.to_file(tmp_path / "same.json")
    replace(law, D=np.nextafter(law.D, 1.0)).to_file(tmp_path / "other.json")
    assert digests(k_fsm=str(tmp_path / "same.json")) == base
    other = digests(k_fsm=str(tmp_path / "other.json"))
    assert {name for name in base if base[name] != other[name]} == {"plant", "estimator"}  # its tone is of the loop
    assert digests(loop="fsm")["controller"] != digests(fsm_authority=1e-3)["controller"] != base["controller"]
    unknown = digests(plant="simple_telescope:SimpleTelescope", start="rest")
    assert unknown["plant"] == "" and unknown["estimator"] == base["estimator"]
