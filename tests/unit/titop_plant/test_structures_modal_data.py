"""Modal data: what it refuses, rotation, truncation, residual mass, the file format."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.spatial.transform import Rotation

from titop_plant.structures import (
    ChildPort,
    ModalData,
    ResidualMode,
    add_residual_modes,
    check_residual_mass,
    from_inertia,
    read_modal_data,
    repair_residual_mass,
    smallest_residual_fraction,
    write_modal_data,
)

INERTIA = np.array([[443.49, 0.36, -0.01], [0.36, 26.14, 0.09], [-0.01, 0.09, 469.62]])
CG = np.array([0.007, -5.517, 0.0])
PARTICIPATION = np.array(
    [
        [-0.0001, 0.0051, 6.5226, -47.0158, -0.0546, -0.0008],
        [6.8249, 0.0090, 0.0003, -0.0012, 0.0279, 47.5976],
    ]
)


def solar_array() -> ModalData:
    """The solar array as printed in the paper's table (two modes)."""
    mass = from_inertia(59.0, INERTIA, CG)
    return ModalData("solar_array", "A", np.zeros(3), mass, [0.743, 2.65], [0.001, 0.001], PARTICIPATION)


def arm() -> ModalData:
    """A small flexible body with two children; no point at the origin."""
    rng = np.random.default_rng(7)
    mass = from_inertia(40.0, np.diag([3.0, 4.0, 5.0]), [0.2, -0.1, 0.4])
    shapes = 0.2 * rng.standard_normal((2, 6, 3))
    participation = 0.5 * rng.standard_normal((3, 6))
    children = (ChildPort("C1", [1.0, 0.0, 0.5], shapes[0]), ChildPort("C2", [0.0, 2.0, 0.5], shapes[1]))
    return ModalData("arm", "P", [0.1, 0.2, 0.3], mass, [10.0, 20.0, 35.0], [0.01] * 3, participation, children)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frequencies": [10.0, -20.0, 35.0]}, ["arm", "frequencies", "-20", "mode 2"]),
        ({"frequencies": [10.0, 0.0, 35.0]}, ["arm", "frequencies", "clamped"]),
        ({"damping": [0.1, 1.5, 0.1]}, ["arm", "damping", "1.5", "mode 2"]),
        ({"damping": [0.1, 0.1]}, ["arm", "damping", "(3,)", "(2,)"]),
        ({"participation": np.zeros((3, 5))}, ["arm", "participation", "(3, 6)", "(3, 5)"]),
        ({"mass_matrix": -np.eye(6)}, ["arm", "mass must be positive", "-1", "kg"]),
        ({"mass_matrix": np.diag([1.0, 1, 1, 1, -2, 1])}, ["arm", "inertia", "-2", "y rotation"]),
        ({"mass_matrix": np.eye(6) + 0.1 * np.eye(6, k=3)}, ["arm", "symmetric", "[0, 3]"]),
        ({"mass_matrix": np.eye(6) + 3 * (np.eye(6, k=3) + np.eye(6, k=-3))}, ["arm", "positive semidefinite"]),
        ({"mass_matrix": np.full((6, 6), np.nan)}, ["arm", "mass_matrix", "finite"]),
        ({"parent": "C1"}, ["arm", "different names", "C1"]),
        ({"parent": ""}, ["arm", "names"]),
        ({"children": (ChildPort("C1", np.zeros(3), np.zeros((6, 2))),)}, ["arm", "C1", "(6, 3)", "(6, 2)"]),
        ({"frequencies": "abc"}, ["arm", "frequencies", "numbers"]),
    ],
)
def test_errors_name_the_body_and_the_quantity(change: dict[str, object], words: list[str]) -> None:
    with pytest.raises(ValueError) as caught:
        dataclasses.replace(arm(), **change)  # type: ignore[arg-type]
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_rigid_mass_matrix_is_that_of_a_moved_body() -> None:
    """Kinetic energy of a rigid body: 1/2 x' M_rr x equals 1/2 m v_G^2 + 1/2 w' J w."""
    rng = np.random.default_rng(1)
    v, w = rng.standard_normal(3), rng.standard_normal(3)
    v_g = v + np.cross(w, CG)
    energy = 0.5 * 59.0 * v_g @ v_g + 0.5 * w @ INERTIA @ w
    twist = np.r_[v, w]
    assert 0.5 * twist @ from_inertia(59.0, INERTIA, CG) @ twist == pytest.approx(energy, rel=1e-13)


def test_truncation_moves_mass_into_the_residual() -> None:
    body, short = arm(), arm().truncate(1)
    assert short.n_modes == 1
    assert short.child("C2").shapes.shape == (6, 1)
    growth = eigvalsh(short.residual_mass() - body.residual_mass())
    assert growth[0] > -1e-12
    assert growth[-1] > 0.1
    with pytest.raises(ValueError, match="n_modes must be 0 to 3, got 4"):
        body.truncate(4)


def test_rotation_keeps_the_invariants() -> None:
    body = arm()
    dcm = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    turned = body.rotated(dcm)
    np.testing.assert_allclose(turned.center_of_mass, dcm @ body.center_of_mass, atol=1e-13)
    np.testing.assert_allclose(eigvalsh(turned.residual_mass()), eigvalsh(body.residual_mass()), rtol=1e-11, atol=1e-12)
    both = np.kron(np.eye(2), dcm)
    np.testing.assert_allclose(turned.child_tau("C1"), both @ body.child_tau("C1") @ both.T, atol=1e-13)
    back = turned.rotated(dcm.T)
    np.testing.assert_allclose(back.participation, body.participation, atol=1e-13)
    np.testing.assert_allclose(back.child("C2").shapes, body.child("C2").shapes, atol=1e-13)


def test_printed_solar_array_has_a_negative_residual_mass() -> None:
    body = solar_array()
    assert eigvalsh(body.residual_mass())[0] == pytest.approx(-0.20, abs=5e-3)
    assert body.residual_mass()[5, 5] == pytest.approx(-0.109, abs=5e-4)
    with pytest.raises(ValueError, match=r"solar_array: .*z rotation \(residual there -0\.1086 kg m2"):
        check_residual_mass(body)


def test_uniform_repair_is_the_smallest_one() -> None:
    body = solar_array()
    repair = repair_residual_mass(body)
    assert repair.changed
    assert repair.after == pytest.approx(0.0, abs=1e-12)
    assert 0.9999 < repair.scale[0] == repair.scale[1] < 1.0
    check_residual_mass(repair.data)
    slightly_less = body.participation * (1 - 0.9 * (1 - repair.scale[0]))
    with pytest.raises(ValueError, match="semidefinite"):
        check_residual_mass(dataclasses.replace(body, participation=slightly_less))


def test_repair_of_one_mode_leaves_the_other() -> None:
    body = solar_array()
    repair = repair_residual_mass(body, mode=1, margin=1e-3)
    assert repair.scale[0] == 1.0
    assert repair.scale[1] < 1.0
    assert repair.after == pytest.approx(1e-3, rel=1e-6)
    np.testing.assert_array_equal(repair.data.participation[0], body.participation[0])


def test_residual_modes_have_their_share_of_the_residual_mass() -> None:
    body = repair_residual_mass(solar_array(), margin=1e-3).data
    directions = np.eye(6)[[1, 4, 3, 5, 0]]
    modes = [ResidualMode(10.0 + k, 0.001, d, 0.6) for k, d in enumerate(directions)]
    residual = body.residual_mass()
    for k, mode in enumerate(modes):
        extended = add_residual_modes(body, modes[: k + 1])
        left = extended.residual_mass()
        before, after = (mode.direction @ R @ mode.direction for R in (residual, left))
        assert after == pytest.approx(0.4 * before, rel=1e-9)
        assert eigvalsh(left)[0] > 0
        residual = left
    assert extended.n_modes == 7
    np.testing.assert_array_equal(extended.participation[:2], body.participation)
    everything = add_residual_modes(body, [ResidualMode(10.0, 0.001, np.eye(6)[0], 1.0)])
    assert smallest_residual_fraction(everything) == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ValueError, match="residual mass along the direction of residual mode 1 must be positive"):
        add_residual_modes(everything, [ResidualMode(12.0, 0.001, np.eye(6)[0], 0.5)])


def test_file_round_trip_is_exact(tmp_path: Path) -> None:
    body, path = arm(), tmp_path / "arm.toml"
    write_modal_data(body, path, comment="a test body\nof two lines")
    back = read_modal_data(path)
    for field in ("parent_position", "mass_matrix", "frequencies", "damping", "participation"):
        np.testing.assert_array_equal(getattr(back, field), getattr(body, field))
    assert [c.name for c in back.children] == ["C1", "C2"]
    for ours, theirs in zip(body.children, back.children):
        np.testing.assert_array_equal(ours.shapes, theirs.shapes)
        np.testing.assert_array_equal(ours.position, theirs.position)
    assert path.read_text().startswith("# a test body\n# of two lines\n")
    with pytest.raises(FileExistsError):
        write_modal_data(body, path)


RIGID = """format = "los-testbed/modal-data"
version = 1
name = "panel"
parent = "P"
parent_position = [0.0, 0.0, 0.0]
mass = 59.0
inertia_at_cg = [[443.49, 0.36, -0.01], [0.36, 26.14, 0.09], [-0.01, 0.09, 469.62]]
cg = [0.007, -5.517, 0.0]

[[child]]
name = "tip"
position = [0.0, -10.0, 0.0]

[[mode]]
frequency = 0.743
damping = 0.001
participation = [0.0, 0.0, 6.5, -47.0, 0.0, 0.0]
shapes = { tip = [0.0, 0.0, 0.3, -0.04, 0.0, 0.0] }

[[mode]]
frequency = 2.65
damping = 0.001
participation = [6.8, 0.0, 0.0, 0.0, 0.0, 47.0]
[mode.shapes]
tip = [0.3, 0.0, 0.0, 0.0, 0.0, 0.04]
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", ["line 1", "version = 1"]),
        ("mass = 59.0", "mass = -59.0", ["line 6", "panel", "mass must be positive"]),
        ("mass = 59.0\n", "", ["panel", "mass must be given"]),
        ("mass = 59.0", "weight = 59.0", ["line 6", "panel", "key must be one of", "got 'weight'"]),
        ("cg = [0.007, -5.517, 0.0]", "cg = [0.007, -5.517]", ["line 8", "panel", "cg", "(3,)", "(2,)"]),
        (
            "damping = 0.001\nparticipation = [6.8",
            "participation = [6.8",
            ["line 20", "mode 2", "damping must be given"],
        ),
        ("frequency = 2.65", "frequency = 'x'", ["line 21", "mode 2", "frequency"]),
        ("frequency = 2.65", "frequency = -2.65", ["panel", "frequencies must be positive", "mode 2"]),
        ("tip = [0.3, 0.0", "top = [0.3, 0.0", ["mode 2", "['tip']", "['top']"]),
        ("47.0]", "48.0]", ["panel", "residual mass", "z rotation"]),
        ("[[child]]", "[child]", ["line 10", "panel", "[[child]]"]),
        ("position = [0.0, -10.0", "position = [0.0, nan", ["line 12", "child 1", "finite"]),
        ("cg = [", "cg = [[", ["file must be TOML", "line"]),
        ("\ncg = ", "\nmass_matrix = [[1.0]]\ncg = ", ["line 9", "got both"]),
    ],
)
def test_errors_of_a_file_name_line_and_key(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    path = tmp_path / "bad.toml"
    assert old in RIGID
    path.write_text(RIGID.replace(old, new))
    with pytest.raises(ValueError) as caught:
        read_modal_data(path)
    for word in ("bad.toml", *words):
        assert word in str(caught.value)
