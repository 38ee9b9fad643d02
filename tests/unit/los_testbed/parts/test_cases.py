"""Named cases of the reference telescope, and of others by their own ranges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from los_testbed.cli.app import main
from los_testbed.config.cases import case_settings, telescope_cases
from los_testbed.config.members import check_ranges
from los_testbed.config.run_config import RunConfig

from titop_plant.telescope.load import load_telescope

SPACECRAFT = sorted(Path("examples/spacecraft").glob("*.toml"))

OF_THE_REFERENCE: dict[str, dict[str, Any]] = {
    "nominal": {"theta": 0.0},
    "arrays_quarter_turn": {"theta": 1.5707963267948966},
    "arrays_half_turn": {"tau": 1.0},
    "wheels_at_rest": {"wheel_speed": [0.0, 0.0, 0.0, 0.0]},
    "wheels_fast": {"wheel_speed": [1047.2, 1047.2, 1047.2, 1047.2]},
    "soft_arrays": {"omega_1": 0.70585, "omega_2": 2.5175},
    "stiff_arrays": {"omega_1": 0.78015, "omega_2": 2.7825},
    "worst": {
        "theta": 1.3962634015954636,
        "wheel_speed": [-1047.2, -1047.2, -1047.2, -1047.2],
        "omega_1": 0.70585,
        "omega_2": 2.7825,
    },
    "arrays_turning": {"theta": 0.0, "theta_rate": 0.2, "ramp_duration": 5.0},
    "wheels_spinning_up": {
        "wheel_speed": [100.0, -100.0, 100.0, -100.0],
        "wheel_acceleration": [10.0, -10.0, 10.0, -10.0],
        "ramp_duration": 10.0,
    },
    "spin_up": {
        "scenario": "ramp",
        "wheel_speed": [30.0, -30.0, 30.0, -30.0],
        "wheel_acceleration": [8.083333333333334, -8.083333333333334, 8.083333333333334, -8.083333333333334],
        "ramp_duration": 120.0,
        "duration": 120.0,
    },
    "zero_crossing": {
        "scenario": "ramp",
        "wheel_speed": [60.0, -60.0, 60.0, -60.0],
        "wheel_acceleration": [-2.0, 2.0, -2.0, 2.0],
        "ramp_duration": 60.0,
        "duration": 60.0,
    },
    "array_turn": {
        "scenario": "ramp",
        "theta": -3.141592653589793,
        "theta_rate": 0.05235987755982988,
        "ramp_duration": 120.0,
        "profile": "trapezoidal",
        "duration": 120.0,
    },
}


def test_those_of_the_reference_are_as_they_were() -> None:
    for name, settings in OF_THE_REFERENCE.items():
        case = case_settings(name)
        assert case.keys() == settings.keys(), name
        for key, value in settings.items():
            assert case[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-15)), name
    assert telescope_cases(load_telescope()).keys() == OF_THE_REFERENCE.keys()


@pytest.mark.parametrize("path", SPACECRAFT, ids=lambda path: path.stem)
def test_each_case_is_in_the_family_of_its_telescope_or_refused_by_name(path: Path) -> None:
    """A case of the reference ended as "wheel_speed must hold 3 numbers, got 4", which nobody had typed."""
    telescope = load_telescope(path)
    cases = telescope_cases(telescope)
    assert cases.keys() == OF_THE_REFERENCE.keys()
    for name, case in cases.items():
        if isinstance(case, str):
            with pytest.raises(ValueError, match=f"{path.name} has no case {name}: "):
                case_settings(name, None, str(path))
        else:
            settings = {"parameters": str(path), "loop": telescope.stages[-1], **case_settings(name, None, str(path))}
            check_ranges(RunConfig.from_mapping(settings), telescope)
    assert isinstance(cases["worst"], str)


def test_wheels_that_do_not_pass_through_rest_have_no_zero_crossing(tmp_path: Path) -> None:
    file = tmp_path / "t.toml"
    wheels = "".join(
        f'[[reaction_wheel]]\nname = "w{k}"\naxis = {axis}\nposition = [0.0, 0.0, 0.2]\ndefault_speed = 150.0\n'
        f"speed_range = [100.0, 400.0]\n"
        for k, axis in enumerate(([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))
    )
    file.write_text('base = "reference"\n' + wheels)
    cases = telescope_cases(load_telescope(file))
    refused = ("wheels_at_rest", "zero_crossing", "spin_up")
    assert all(cases[name] == "the wheel w0 is not driven through these speeds" for name in refused)
    assert case_settings("wheels_spinning_up", None, str(file))["wheel_speed"] == [100.0, 100.0, 100.0]


def test_the_command_lists_those_of_a_telescope(capsys: pytest.CaptureFixture[str]) -> None:
    for path in SPACECRAFT:
        assert main(["plant", "cases", "--parameters", str(path)]) == 0
        assert "not of this telescope" in " ".join(capsys.readouterr().out.split())
