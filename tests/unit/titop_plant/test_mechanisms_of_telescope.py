"""Wheels with bearings and drives with steppers in the whole telescope: order, limits, energy, files, modes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.accurate_response import accurate_response
from scipy import linalg

from titop_plant.disturbances.mechanisms import mount_matrix
from titop_plant.disturbances.places import place_matrix, source_ports
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.mechanism_modes import mechanism_modes
from titop_plant.telescope.telescope import Telescope

FILE = """
[reaction_wheel.bearing]
rotor_mass = 0.8
rotor_radial_inertia = 0.045
radial_stiffness = 1.5e6
radial_damping = 30.0
axial_stiffness = 1.0e6
axial_damping = 30.0
rocking_stiffness = 6.0e3
rocking_damping = 0.3

[reaction_wheel.broadband]
frequency = [1.0, 400.0]
radial_force = [1e-6, 1e-6]

[sadm.stepper]
rotor_inertia = 1.2e-5
gear_ratio = 100.0
full_steps = 200
micro_steps = 16
holding_torque = 0.4
rate = 1e-3
motor_damping = 1e-3
detent_torque = 0.02
gear_errors = [[100.0, 2e-6], [6000.0, 1e-7]]
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("mechanisms") / "mine.toml"
    found.write_text('base = "reference"\n' + FILE, encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def telescope(path: Path) -> Telescope:
    return load_telescope(path)


def test_stiff_mechanisms_are_the_reference(telescope: Telescope) -> None:
    """The difference falls as the stiffness rises: a hundredth for a hundred times the stiffness."""
    values, omega = {"wheel_1.speed": 400.0, "wheel_2.speed": -700.0, "solar_array.tau": 0.4}, [6.0, 15.0, 120.0, 300.0]
    rigid = _response(load_telescope(), values, omega)
    errors = []
    for factor in (1e2, 1e4):
        stiff = telescope.to_mapping()
        for name in ("radial", "axial", "rocking"):
            stiff["reaction_wheel"]["bearing"][f"{name}_stiffness"] *= factor
            stiff["reaction_wheel"]["bearing"][f"{name}_damping"] = 0.0
        stiff["sadm"]["stepper"] |= {"rotor_inertia": 1e-9, "holding_torque": 0.4 * factor, "motor_damping": 0.0}
        errors.append(np.abs(_response(Telescope(stiff), values, omega) / rigid - 1.0).max())
    assert errors[0] < 0.1 and errors[1] == pytest.approx(1e-2 * errors[0], rel=0.1)


def _response(telescope: Any, values: dict[str, float], omega: list[float]) -> np.ndarray:
    system = build_telescope(telescope).system["los_controlled", ("wheel_imbalance", "sadm_torque")].at(values)
    found = accurate_response(system.A, system.B, system.C, system.D, omega)
    return np.sqrt(np.sum(np.abs(found) ** 2, axis=1))


def test_energy_is_conserved_without_damping(telescope: Telescope) -> None:
    """The power that a force at G puts in per period is zero at any speed of the wheels: Y + Y* = 0."""
    content = telescope.to_mapping()
    for name in ("body", "payload", "fsm", "pma", "solar_array"):
        content[name]["damping"] = 0.0
    content["isolator"]["damping"] = [0.0] * 6
    content["sadm"]["gearbox_damping"] = content["sadm"]["stepper"]["motor_damping"] = 0.0
    for name in ("radial", "axial", "rocking"):
        content["reaction_wheel"]["bearing"][f"{name}_damping"] = 0.0
    system = build_telescope(Telescope(content), attitude_controlled=False).system["accel_G", "external_wrench"]
    data = system.at(system.sample_values(np.random.default_rng(8))[0])
    omega, scale = np.array([0.3, 2.0, 15.0, 130.0, 370.0, 1400.0]), np.array([1.0] * 3 + [1.5] * 3)
    for w, response in zip(omega, accurate_response(data.A, data.B, data.C, data.D, omega)):
        mobility = scale[:, None] * response / (1j * w) * scale
        assert np.abs(mobility + mobility.conj().T).max() < 1e-9 * np.abs(mobility).max(), w


def test_modes_of_the_rotors_are_in_the_plant(telescope: Telescope) -> None:
    """Each printed mode is near a pole of the telescope at the default speeds."""
    speeds = {f"wheel_{i}.speed": w.default_speed for i, w in enumerate(telescope.wheels, start=1)}
    poles = linalg.eigvals(build_telescope(telescope).system.at(speeds).A).imag
    modes = mechanism_modes(telescope)
    assert len(modes) == 4 * 4 + 2
    for mode in modes:
        if "whirl" in mode.name or "rotor" in mode.name:
            assert np.abs(poles / mode.at_speed - 1.0).min() < 0.05, mode
    assert {mode.at_rest for mode in modes if "whirl" in mode.name} == {np.sqrt(6e3 / 0.045)}


def test_a_force_on_the_mount_is_one_on_a_rigid_wheel(telescope: Telescope) -> None:
    """Broadband noise acts on the mount: as a force on the rotor where the rotor is rigid, else another one."""
    plain = load_telescope()
    wheel = plain.wheels[1]
    given, mount = place_matrix("wheel_2", plain), mount_matrix(wheel, plain)
    for of, alike in ((plain, True), (telescope, False)):
        whole = build_telescope(of, loads=("I_w",)).system
        names = [p.name for p in source_ports(plain) if p.name in {q.name for q in whole.inputs}]
        rows = np.concatenate([np.arange(99)[s] for s in _slices(plain, names)])
        data = whole.select(inputs=names, outputs=("los_controlled",)).at({"wheel_2.speed": 300.0})
        found = accurate_response(data.A, data.B, data.C, data.D, [40.0, 380.0])
        one, two = found @ given[rows], found @ mount[rows]
        assert (np.abs(one - two)[:, :, :5].max() < 1e-6 * np.abs(one).max()) == alike


def _slices(telescope: Any, names: list[str]) -> list[slice]:
    from lftkit.systems.ports import port_slices

    columns = port_slices(source_ports(telescope))
    return [columns[name] for name in names]


def test_wheels_and_arrays_of_a_list_have_their_own(tmp_path: Path) -> None:
    axes = {"a": [1.0, 0.0, 0.0], "b": [0.0, 1.0, 0.0], "c": [0.0, 0.0, 1.0]}
    text = "".join(
        f'[[reaction_wheel]]\nname = "{n}"\naxis = {axis}\ndefault_speed = 9.0\n' for n, axis in axes.items()
    )
    bearing = "bearing = {rotor_mass = 0.5, rotor_radial_inertia = 0.01, axial_stiffness = 1e6}"
    text = text.replace('name = "b"', f'name = "b"\n{bearing}')
    path = tmp_path / "list.toml"
    path.write_text('base = "reference"\n' + text)
    assert [wheel.bearing is not None for wheel in load_telescope(path).wheels] == [False, True, False]
