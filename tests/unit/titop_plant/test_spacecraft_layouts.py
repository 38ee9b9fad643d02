"""Spacecraft with any arrays, wheels and appendages against equations of motion of their own and conservation laws."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from oracles import any_spacecraft as oracle
from oracles.accurate_response import accurate_response
from oracles.kinematic_elimination import about_point, carry, index_slices, turn
from scipy import linalg
from support.spacecraft import write

from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope

WING = {
    "mass": 46.0,
    "inertia_at_cg": [[210.0, 0.3, 0.0], [0.3, 24.0, 0.0], [0.0, 0.0, 232.0]],
    "center_of_mass": [0.1, -4.2, 0.0],
    "frequencies": [1.35, 4.10],
    "damping": 0.002,
    "participation": [[0.0, 0.0, 5.60, -30.8, 0.0, 0.0], [5.80, 0.0, 0.0, 0.0, 0.0, 31.4]],
    "relative_uncertainty": 0.10,
}
PANEL = {
    "mass": 9.0,
    "inertia_at_cg": [[2.6, 0.0, 0.0], [0.0, 1.1, 0.0], [0.0, 0.0, 3.6]],
    "center_of_mass": [0.0, -0.95, 0.0],
    "frequencies": [21.0],
    "damping": 0.004,
    "participation": [[0.0, 0.0, 2.55, -2.80, 0.0, 0.0]],
}
ANTENNA = {
    "mass": 14.0,
    "inertia_at_cg": [[3.2, 0.0, 0.0], [0.0, 3.2, 0.0], [0.0, 0.0, 1.4]],
    "center_of_mass": [0.0, 0.0, -1.1],
    "frequencies": [9.2, 11.5],
    "damping": 0.005,
    "participation": [[3.40, 0.0, 0.0, 0.0, -4.30, 0.0], [0.0, 3.35, 0.0, 4.25, 0.0, 0.0]],
    "relative_uncertainty": 0.05,
    "uncertain_modes": 1,
}
TURNED = turn([0.6, 0.0, 0.8], 0.7).tolist()
SKEW = turn([0.0, 1.0, 0.0], -0.4).tolist()
HALF = [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
NONE: dict[str, Any] = {
    "solar_array": [],
    "reaction_wheel": [
        {"name": "a", "axis": [1.0, 0.1, 0.0], "position": [0.1, 0.0, 0.2], "default_speed": 100.0, "mass": 2.0},
        {"name": "b", "axis": [0.0, 1.0, 0.3], "default_speed": -90.0, "axial_inertia": 0.2},
        {"name": "c", "axis": [0.0, 0.0, 2.0], "default_speed": 80.0},
    ],
    "pma": {"azimuths_deg": []},
}
UNLIKE: dict[str, Any] = {
    "solar_array": [
        {"name": "wing", "point": "A1", "dcm": HALF, "drive_axis": [0.0, 1.0, 0.0], "gearbox_stiffness": 1.6e4, **WING},
        {"name": "panel", "point": "top", "dcm": TURNED, "theta_range": [0.4, 0.4], **PANEL},
        {"name": "plate", "point": "A2", "driven": False, **PANEL},
    ],
    "appendage": [{"name": "antenna", "point": "boom", "dcm": SKEW, **ANTENNA}],
    "reaction_wheel": {
        "azimuths_deg": [0.0, 72.0, 144.0, 216.0, 288.0],
        "default_speed": [212.0, -187.0, 236.0, -254.0, 201.0],
    },
    "body": {"ports": {"boom": [-0.60, 0.95, 0.05], "top": [0.4, 0.3, 2.9]}},
}
INTERNAL = ("sadm_torque", "fsm_command")
"""Forces between two bodies: their effect on the rest is a difference of large numbers."""
BEARING = {
    "rotor_mass": 0.8,
    "rotor_radial_inertia": 0.045,
    "radial_stiffness": 1.5e6,
    "radial_damping": 30.0,
    "axial_stiffness": 1.0e6,
    "axial_damping": 20.0,
    "rocking_stiffness": 6.0e3,
    "rocking_damping": 0.3,
}
BEARINGS: dict[str, Any] = {
    "solar_array": [{"name": "plate", "point": "A2", "driven": False, **PANEL}],
    "reaction_wheel": {
        "azimuths_deg": [0.0, 100.0, 230.0],
        "default_speed": [212.0, -187.0, 236.0],
        "bearing": BEARING,
    },
}
LAYOUTS = {"none": NONE, "unlike": UNLIKE, "bearings": BEARINGS}


@pytest.fixture(scope="module", params=list(LAYOUTS))
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    layout = LAYOUTS[request.param]
    telescope = load_telescope(write(tmp_path_factory.mktemp("craft"), layout))
    return SimpleNamespace(layout=layout, telescope=telescope, assembled=build_telescope(telescope))


def wheels_of(layout: dict[str, Any], values: dict[str, float]) -> list[oracle.Wheel]:
    """Wheels from the plain tables of a layout; what these leave out is printed in the reference file."""
    given, common = layout["reaction_wheel"], {"mass": 1.0, "axial_inertia": 0.096, "radial_inertia": 0.047}
    if isinstance(given, dict):
        cant, out = math.radians(35.26), []
        for azimuth in np.radians(given["azimuths_deg"]):
            flat = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            axis = math.cos(cant) * flat + np.array([0.0, 0.0, math.sin(cant)])
            out.append({"axis": axis, "position": 0.2 * flat})
        given = out
    full = [{**common, "position": [0.0] * 3, **table} for table in given]
    rotor = None
    if "bearing" in layout["reaction_wheel"]:
        kinds, of = ("radial", "radial", "axial", "rocking", "rocking"), layout["reaction_wheel"]["bearing"]
        springs, dampers = ([of[f"{kind}_{what}"] for kind in kinds] for what in ("stiffness", "damping"))
        rotor = (of["rotor_mass"], of["rotor_radial_inertia"], springs, dampers)
    return [
        oracle.Wheel(
            t["mass"],
            t["axial_inertia"],
            t["radial_inertia"],
            t["axis"],
            t["position"],
            values.get(f"wheel_{i}.speed", 0.0),
            rotor,
        )
        for i, t in enumerate(full, start=1)
    ]


def mounted_of(layout: dict[str, Any], values: dict[str, float]) -> list[oracle.Mounted]:
    """Arrays and appendages from the plain tables of a layout."""
    found = []
    theta = 4.0 * math.atan(values.get("solar_array.tau", 0.0))
    for table in (*layout.get("solar_array", ()), *layout.get("appendage", ())):
        n, array = len(table["frequencies"]), table in layout.get("solar_array", ())
        modes = SimpleNamespace(
            mass_matrix=about_point(table["mass"], table["inertia_at_cg"], table["center_of_mass"]),
            participation=np.array(table["participation"]),
            frequencies=np.array(table["frequencies"]),
            damping=np.full(n, table["damping"]),
        )
        own = [values.get(f"{table['name']}.omega_{i}", w) for i, w in enumerate(table["frequencies"], start=1)]
        driven = array and table.get("driven", True)
        fixed = table.get("theta_range", [None])[0]
        angle = theta if fixed is None else fixed
        gearbox = (table.get("gearbox_stiffness", 2.0e4), 15.0) if driven else None
        dcm = table.get("dcm", np.eye(3))
        axis = table.get("drive_axis", [0.0, 1.0, 0.0])
        found.append(oracle.Mounted(modes, np.array(own), table["point"], dcm, axis, angle if driven else 0.0, gearbox))
    return found


def independent(case: Any, values: dict[str, float], inertia: np.ndarray | None = None) -> Any:
    body, payload = case.assembled.bodies[:2]
    wheels, mounted = wheels_of(case.layout, values), mounted_of(case.layout, values)
    return oracle.assemble_any(case.telescope.to_mapping(), body, payload, wheels, mounted, inertia)


def test_every_pair_of_ports_by_equations_of_motion(case: Any) -> None:
    """Nominal and random values, 0.05 to 5000 rad/s: 1e-8 of the block of a pair."""
    system = case.assembled.system
    inertia = oracle.total_inertia(independent(case, {})[0].M)
    np.testing.assert_allclose(case.assembled.inertia, inertia, rtol=0, atol=1e-9 * inertia.max())
    rng = np.random.default_rng(3)
    for values in ({}, *system.sample_values(rng, 2)):
        (model, inputs, outputs), data = independent(case, values, inertia), system.at(values)
        omega = np.exp(rng.uniform(math.log(0.05), math.log(5e3), 12))
        rows, columns = (index_slices({p.name: p.size for p in side}) for side in (system.outputs, system.inputs))
        internal = np.concatenate([np.arange(99)[columns[u]] for u in columns if u in INTERNAL])
        ours = accurate_response(data.A, data.B, data.C, data.D, omega, internal)
        theirs = model.frequency_response(omega)
        assert ours.shape == theirs.shape and set(rows) == set(outputs) and set(columns) == set(inputs)
        for (y, row), (u, column) in itertools.product(rows.items(), columns.items()):
            one, two = ours[:, row, column], theirs[:, outputs[y], inputs[u]]
            size = np.sqrt(np.sum(np.abs(two) ** 2, axis=(1, 2)))
            error = np.sqrt(np.sum(np.abs(one - two) ** 2, axis=(1, 2)))
            bound = 1e-8 * size + 1e-9 * size.max()
            assert (error <= bound).all(), (y, u, values, (error / np.maximum(size, 1e-300)).max())


def test_a_list_of_the_reference_arrays_is_the_reference(tmp_path: Path) -> None:
    text = '[[solar_array]]\nname = "array_1"\nlike = "reference"\npoint = "A1"\nparameters = "solar_array"\n'
    text += '[[solar_array]]\nname = "array_2"\nlike = "reference"\npoint = "A2"\nparameters = "solar_array"\n'
    path = tmp_path / "same.toml"
    path.write_text('base = "reference"\n' + text, encoding="utf-8")
    one, two = build_telescope(load_telescope(path)).system, build_telescope().system
    assert one.parameters == two.parameters and one.inputs == two.inputs
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_mass_and_inertia_are_the_sum_with_parallel_axes(case: Any) -> None:
    """Rigid motion of the free spacecraft at 1e-4 rad/s, the rotors free about their axes."""
    p, (body, payload) = case.telescope.to_mapping(), case.assembled.bodies[:2]
    at = {child.name: child.position - body.parent_position for child in body.children}
    parts = [body.mass_matrix]
    for wheel in wheels_of(case.layout, {}):
        axis = np.asarray(wheel.axis) / np.linalg.norm(wheel.axis)
        disc = wheel.radial * (np.eye(3) - np.outer(axis, axis))
        parts.append(moved(linalg.block_diag(wheel.mass * np.eye(3), disc), at["I_w"] + wheel.position))
    for one in mounted_of(case.layout, {}):
        frame = np.asarray(one.dcm) @ turn(one.axis, one.angle).T
        twice = linalg.block_diag(frame, frame)
        parts.append(moved(twice.T @ one.modes.mass_matrix @ twice, at[one.point]))
    platform = about_point(*(p["isolator"][k] for k in ("mass", "inertia_at_cg", "center_of_mass")))
    fsm, mirror = p["fsm"], next(c for c in payload.children if c.name == "I_f").position
    platform = platform + payload.mass_matrix + moved(np.diag([fsm["mass"]] * 3 + fsm["inertia"]), mirror)
    casing = np.diag(p["pma"]["inertia"])
    for azimuth in np.radians(p["pma"]["azimuths_deg"]):
        radial, up = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), np.array([0.0, 0.0, 1.0])
        tangent = np.cross(up, radial)
        for frame in (np.array([radial, tangent, up]), np.array([up, radial, tangent])):
            each = p["pma"]["casing_mass"] + p["pma"]["moving_mass"]
            actuator = linalg.block_diag(each * np.eye(3), frame.T @ casing @ frame)
            platform = platform + moved(actuator, p["pma"]["mounting_radius"] * radial)
    total = sum(parts) + moved(platform, at["I_p"])
    free = build_telescope(case.telescope, attitude_controlled=False).system["accel_G", "external_wrench"].at({})
    gain = accurate_response(free.A, free.B, free.C, free.D, [1e-4])[0].real
    scale = np.sqrt(np.diag(total))
    difference = (linalg.inv(gain) - total) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-6
    assert linalg.inv(gain)[0, 0] == pytest.approx(total[0, 0], rel=1e-7)


def moved(mass: np.ndarray, lever: Any) -> np.ndarray:
    """Mass matrix at the point that a body hangs on by a rigid lever."""
    arm = carry(np.asarray(lever))
    return arm.T @ mass @ arm
