"""Wheels with asymmetric ranges, constant speeds and spares at rest, against independent equations of motion."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import any_spacecraft as oracle
from oracles.accurate_response import accurate_response
from oracles.kinematic_elimination import about_point, index_slices
from scipy import linalg
from support.spacecraft import write

from lftkit import RealParameter
from titop_plant.blocks.reaction_wheel import MountedWheel, ReactionWheel, wheel_assembly
from titop_plant.disturbances.places import all_places
from titop_plant.disturbances.wheel_and_drive_tones import imbalance_tones
from titop_plant.simulation.build import resonant_speeds
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

SPARE: dict[str, Any] = {"name": "spare", "axis": [1.0, 1.0, 1.0], "position": [0.1, 0.2, -0.1], "speed_range": [0, 0]}
WHEELS: list[dict[str, Any]] = [
    {"name": "a", "axis": [1.0, 0.1, 0.0], "speed_range": [100, 300], "default_speed": 210.0, "mass": 2.0},
    {"name": "b", "axis": [0.0, 1.0, 0.3], "speed_range": [-400, -50], "default_speed": -90.0, "axial_inertia": 0.2},
    {**SPARE, "mass": 3.0, "radial_inertia": 0.06},
    {"name": "c", "axis": [0.0, 0.0, 2.0], "speed_range": [150.0, 150.0]},
    {"name": "d", "axis": [1.0, -1.0, 1.0], "maximum_speed": 200.0, "default_speed": 0.0},
]
LAYOUT: dict[str, Any] = {"solar_array": [], "reaction_wheel": WHEELS}


def independent(telescope: Telescope, bodies: Any, values: dict[str, float], inertia: Any = None) -> Any:
    """The spacecraft of plain numbers: four wheels that turn, the spare a rigid mass at its place."""
    common = {"mass": 1.0, "axial_inertia": 0.096, "radial_inertia": 0.047, "position": [0.0] * 3}
    wheels = []
    for i, table in enumerate(WHEELS, start=1):
        full, speed = {**common, **table}, values.get(f"wheel_{i}.speed", {4: 150.0}.get(i))
        kept = (full[key] for key in ("mass", "axial_inertia", "radial_inertia", "axis", "position"))
        wheels.append(oracle.Wheel(*kept, speed))
    del wheels[2]
    n = np.array(SPARE["axis"]) / np.sqrt(3.0)
    disc = 0.06 * (np.eye(3) - np.outer(n, n)) + 0.096 * np.outer(n, n)
    rigid = type("Modes", (), {})()
    rigid.mass_matrix, rigid.participation = about_point(3.0, disc, SPARE["position"]), np.zeros((0, 6))
    rigid.frequencies = rigid.damping = np.zeros(0)
    mass = oracle.Mounted(rigid, np.zeros(0), "I_w", np.eye(3), [0.0, 1.0, 0.0], 0.0, None)
    return oracle.assemble_any(telescope.to_mapping(), *bodies[:2], wheels, [mass], inertia)


def test_the_plant_at_the_ends_of_the_ranges_has_the_equations_of_motion(tmp_path: Path) -> None:
    """The gyroscopic terms at every corner and in the middle; the spare is exactly a rigid mass."""
    telescope = load_telescope(write(tmp_path, LAYOUT))
    assembled = build_telescope(telescope)
    system = assembled.system
    assert [(p.name, p.nominal, p.lower, p.upper) for p in system.parameters] == [
        ("wheel_1.speed", 200.0, 100.0, 300.0),
        ("wheel_2.speed", -225.0, -400.0, -50.0),
        ("wheel_5.speed", 0.0, -200.0, 200.0),
    ]
    assert all(p.bilinear == (p.upper - p.nominal, 0.0) for p in system.parameters)  # an affine map
    middle = {p.name: p.nominal for p in system.parameters}
    inertia = oracle.total_inertia(independent(telescope, assembled.bodies, middle)[0].M)
    np.testing.assert_allclose(assembled.inertia, inertia, rtol=0, atol=1e-9 * inertia.max())
    omega = np.exp(np.random.default_rng(1).uniform(np.log(0.05), np.log(5e3), 12))
    corners = telescope.corners()
    assert len(corners) == 8
    for values in ({}, *corners):
        data = system.at(values)
        model, inputs, outputs = independent(telescope, assembled.bodies, {**middle, **values}, inertia)
        rows, columns = (index_slices({p.name: p.size for p in side}) for side in (system.outputs, system.inputs))
        assert set(columns) == set(inputs) and set(rows) == set(outputs)
        internal = np.arange(99)[columns["fsm_command"]]
        ours, theirs = (
            accurate_response(data.A, data.B, data.C, data.D, omega, internal),
            model.frequency_response(omega),
        )
        for (y, row), (u, column) in itertools.product(rows.items(), columns.items()):
            one, two = ours[:, row, column], theirs[:, outputs[y], inputs[u]]
            size = linalg.norm(two, axis=(1, 2))
            assert (linalg.norm(one - two, axis=(1, 2)) <= 1e-8 * size + 1e-9 * size.max()).all(), (y, u, values)


@pytest.mark.parametrize("bearing", [False, True])
def test_a_wheel_at_rest_is_a_rigid_mass(bearing: bool) -> None:
    """Without a bearing the wrench is -M a; with one it is so below the modes of the rotor."""
    from titop_plant.blocks.wheel_bearing import WheelBearing

    springs = WheelBearing(1.5, 0.05, rocking_stiffness=9.0e3, radial_stiffness=1.0e6) if bearing else None
    speed = RealParameter("wheel_1.speed", 0.0, 0.0, 0.0)
    wheel = ReactionWheel(2.0, 0.1, 0.06, springs)
    turning = MountedWheel(
        ReactionWheel(1.0, 0.1, 0.05), np.array([1.0, 0, 0]), np.zeros(3), RealParameter("s", 5, 5, 5)
    )
    axis, place = np.array([0.6, 0.0, 0.8]), np.array([0.1, -0.2, 0.3])
    both = wheel_assembly([MountedWheel(wheel, axis, place, speed), turning])
    alone = wheel_assembly([turning])
    assert both.inputs == alone.inputs and not both.elements
    mass = about_point(2.0, 0.06 * (np.eye(3) - np.outer(axis, axis)) + 0.1 * np.outer(axis, axis), place)
    for omega in (0.0, 0.1) if bearing else (0.0, 500.0):
        whole, rest = (s["wrench_Iw", "accel_Iw"](1j * omega) for s in (both, alone))
        np.testing.assert_allclose(whole - rest, -mass, atol=1e-6 if bearing and omega else 1e-13)


def test_tones_places_and_resonant_speeds_are_those_of_the_turning_wheels(tmp_path: Path) -> None:
    file = write(tmp_path, LAYOUT)
    telescope = load_telescope(file)
    speeds = np.array(telescope.default_speeds)
    assert speeds.tolist() == [210.0, -90.0, 0.0, 150.0, 0.0] and telescope.channels == 20
    tones = imbalance_tones(telescope, speeds, np.random.default_rng(1))
    assert set(tones.wheel.tolist()) == {0, 1, 3, 4} and not tones.amplitude[:, tones.wheel == 4].any()  # d is at rest
    assert not tones.amplitude[:, tones.wheel == 3][[*range(10), *range(15, 20)]].any()
    assert tones.amplitude[10:15, tones.wheel == 3].any()
    assert {"wheel_4", "c"} <= set(all_places(telescope)) and not {"wheel_3", "spare"} & set(all_places(telescope))
    found = resonant_speeds(str(file))
    assert 100 <= found[0] <= 300 and -400 <= found[1] <= -50 and found[2:4] == (0.0, 150.0)


def test_both_forms_of_a_symmetric_range_are_one_telescope(tmp_path: Path) -> None:
    (tmp_path / "range.toml").write_text("base = 'reference'\n[reaction_wheel]\nspeed_range = [-1047.2, 1047.2]\n")
    one, two = load_telescope(tmp_path / "range.toml"), load_telescope()
    assert one.uncertain == two.uncertain and one.wheels[0].speed_range == two.wheels[0].speed_range
    assert two.parameters_hash == "9449a3d3599c" and one.parameters_hash != two.parameters_hash


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed_range = [10, 300]", r"reaction_wheel\.default_speed' must be between 10 and 300 rad/s, got -187"),
        ("speed_range = [300, 10]", r"speed_range' must be its smallest and its largest speed, got \[300\.0, 10\.0\]"),
        ("speed_range = [10]", r"speed_range' must hold 2 numbers, got 1"),
        ("speed_range = [-9, 9]\nmaximum_speed = 9", r"speed_range' must be absent beside maximum_speed"),
        ("speed_range = [0, 0]\ndefault_speed = [0, 0, 0, 0]", "must have turning wheels with axes that span"),
    ],
)
def test_other_ranges_are_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(f"base = 'reference'\n[reaction_wheel]\n{text}\n")
    with pytest.raises(ValueError, match=message):
        load_telescope(tmp_path / "mine.toml")


def test_a_wheel_that_varies_needs_a_default_speed(tmp_path: Path) -> None:
    wheels = [{key: value for key, value in table.items() if key != "default_speed"} for table in WHEELS]
    with pytest.raises(ValueError, match=r"reaction_wheel\[0\].*has no 'default_speed'"):
        load_telescope(write(tmp_path, {**LAYOUT, "reaction_wheel": wheels}))
