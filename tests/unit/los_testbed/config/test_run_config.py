"""Configuration: every mistake is one line that says what was expected and what came."""

import math

import pytest
from los_testbed.config.run_config import RunConfig, physical_hash, read_yaml


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"durtion": 1.0}, ["unknown parameter 'durtion'", "duration"]),
        ({"duration": 0.0}, ["duration", "between"]),
        ({"duration": math.inf}, ["duration", "between", "inf"]),
        ({"duration": True}, ["duration", "a number", "True"]),
        ({"duration": 0.0015}, ["whole number of milliseconds"]),
        ({"camera_rate": 30.0}, ["camera_rate", "divide", "30"]),
        ({"seed": 1.5}, ["seed", "whole number", "1.5"]),
        ({"loop": "pma"}, ["loop", "none, isolator, fsm, fsm+pma", "'pma'"]),
        ({"noise": 1}, ["noise", "true or false", "1"]),
        ({"wheel_speed": [1.0, 2.0, 3.0, math.nan]}, ["wheel_speed", "between"]),
    ],
)
def test_a_mistake_is_one_line_that_says_what_was_expected_and_what_came(values, words):
    with pytest.raises(ValueError) as error:
        RunConfig.from_mapping(values)
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("rate", [1, 12.5, 40, 1000])
def test_camera_rates_that_divide_the_loop_rate(rate):
    assert RunConfig(camera_rate=float(rate)).frame_ticks * rate == 1000


def test_a_configuration_survives_its_own_mapping_and_file(tmp_path):
    config = RunConfig(duration=2.5, loop="fsm", wheel_speed=(1.0, 2.0, 3.0, 4.0), seed=7)
    assert RunConfig.from_mapping(config.to_mapping()) == config
    (tmp_path / "run.yaml").write_text("/**:\n  ros__parameters:\n    duration: 2.5\n    loop: fsm\n")
    assert RunConfig.from_file(tmp_path / "run.yaml").loop == "fsm"


@pytest.mark.parametrize(
    ("text", "words"), [("[1, 2", "must be YAML"), *((t, "must hold names") for t in ("- a\n- b\n", "just words", ""))]
)
def test_a_file_that_is_no_configuration(tmp_path, text, words):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(ValueError, match=f"bad.yaml {words}"):
        read_yaml(tmp_path / "bad.yaml")


def test_every_parameter_says_what_it_is():
    for name, own in RunConfig.SETTINGS.items():
        assert len(own.description) > 5, name
        assert bool(own.absent) == own.optional == (own.default is None), name


def test_the_plant_hash_depends_on_physics_only():
    base = RunConfig()
    assert physical_hash(base) == physical_hash(RunConfig(duration=3.0, mode="inprocess", loop="fsm"))
    changed = [RunConfig(seed=2), RunConfig(theta=0.1), RunConfig(noise=False), RunConfig(loop="none")]
    assert len({physical_hash(c) for c in [base, *changed]}) == 5
