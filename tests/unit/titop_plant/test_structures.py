"""Structures: beam frames, modal data and their files, residual mass, the bodies of the reference telescope."""

from __future__ import annotations

import dataclasses
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.static_frame import static_displacement
from scipy.linalg import eigvalsh
from scipy.spatial.transform import Rotation

from lftkit.arrays import FloatArray
from titop_plant.structures import (
    Beam,
    BeamFrame,
    ChildPort,
    LumpedMass,
    ModalData,
    ResidualMode,
    Section,
    add_residual_modes,
    check_residual_mass,
    effective_masses,
    from_inertia,
    port_visibility,
    read_modal_data,
    repair_residual_mass,
    smallest_residual_fraction,
    to_modal_data,
    write_modal_data,
)
from titop_plant.structures.beam_frame import assemble, rigid_body_modes
from titop_plant.structures.sections import bar, box, tube
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.bodies import build_body, build_payload
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

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
        ("mass = 59.0", "weight = 59.0", ["line 6", "panel", "unknown parameter 'weight'"]),
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


SECTION = Section(E=7e10, G=2.7e10, density=2800.0, A=4e-4, Iy=3e-8, Iz=6e-8, J=5e-8)

ALUMINIUM = {"E": 7e10, "G": 2.7e10, "density": 2800.0}

UPS = {"ac": np.array([0.0, 1.0, 0.3]), "cd": np.array([1.0, 0.0, 0.0]), "ad": np.array([0.0, 0.0, 1.0])}


def crane(rotation: np.ndarray | None = None, shift: np.ndarray | None = None) -> BeamFrame:
    """A small asymmetric frame with an eccentric block."""
    R = np.eye(3) if rotation is None else rotation
    t = np.zeros(3) if shift is None else shift
    nodes = {"a": [0.0, 0.0, 0.0], "c": [0.8, 0.1, 0.2], "d": [0.7, 0.9, 0.5], "e": [1.4, 0.9, 0.6]}
    inertia = np.array([[0.3, 0.02, 0.0], [0.02, 0.2, -0.01], [0.0, -0.01, 0.25]])
    beams = (
        Beam("a", "c", SECTION, R @ UPS["ac"], elements=2),
        Beam("c", "d", SECTION, R @ UPS["cd"]),
        Beam("a", "d", SECTION, R @ UPS["ad"]),
        Beam("d", "e", SECTION, R @ UPS["ad"], elements=2),
    )
    lump = LumpedMass("e", 7.0, R @ inertia @ R.T, R @ [0.1, 0.0, -0.05], "block")
    return BeamFrame("crane", {k: R @ np.array(v) + t for k, v in nodes.items()}, beams, (lump,))


def test_rigid_motion_has_no_strain_energy() -> None:
    names, _, K = assemble(crane())
    rigid = rigid_body_modes(crane(), names, [0.3, -0.2, 1.0])
    assert np.abs(rigid.T @ K @ rigid).max() < 1e-9 * np.abs(K).max()
    values = eigvalsh(K)
    assert values[5] < 1e-9 * values[-1] < values[6]


def test_rigid_mass_matrix_is_that_of_rods_and_blocks() -> None:
    """Mass, first moment and inertia summed by hand from thin rods and the block."""
    frame = crane()
    data = to_modal_data(frame, "a", ["e"])
    mass, inertia = 0.0, np.zeros((3, 3))
    moment: FloatArray = np.zeros(3)

    def add(m: float, center: np.ndarray, own: np.ndarray) -> None:
        nonlocal mass, moment, inertia
        mass, moment = mass + m, moment + m * center
        inertia = inertia + own + m * (center @ center * np.eye(3) - np.outer(center, center))

    for beam in frame.beams:
        start, end = frame.nodes[beam.start], frame.nodes[beam.end]
        axis = (end - start) / np.sqrt((end - start) @ (end - start))
        m = SECTION.density * SECTION.A * np.sqrt((end - start) @ (end - start))
        length2 = (end - start) @ (end - start)
        spin = m * (SECTION.Iy + SECTION.Iz) / SECTION.A * np.outer(axis, axis)
        add(m, 0.5 * (start + end), m * length2 / 12 * (np.eye(3) - np.outer(axis, axis)) + spin)
    block = frame.masses[0]
    add(7.0, frame.nodes["e"] + block.offset, block.inertia)
    assert data.mass == pytest.approx(mass, rel=1e-12)
    np.testing.assert_allclose(data.center_of_mass, moment / mass, rtol=1e-11)
    np.testing.assert_allclose(data.mass_matrix[3:, 3:], inertia, rtol=1e-9, atol=1e-9)


def test_rotation_and_translation_of_the_frame_change_only_the_axes() -> None:
    R = Rotation.from_euler("zyx", [0.7, -0.4, 1.9]).as_matrix()
    here, there = (to_modal_data(f, "a", ["e"]) for f in (crane(), crane(R, np.array([3.0, -1.0, 2.0]))))
    turned = here.rotated(R)
    np.testing.assert_allclose(there.frequencies, here.frequencies, rtol=1e-8)
    np.testing.assert_allclose(there.mass_matrix, turned.mass_matrix, atol=1e-9)
    low = slice(0, 8)
    np.testing.assert_allclose(effective_masses(there)[low], effective_masses(turned)[low], rtol=1e-6, atol=1e-9)
    left, right = there.child("e").shapes[:, low], turned.child("e").shapes[:, low]
    signs = np.sign(np.sum(left * right, axis=0))
    np.testing.assert_allclose(left, signs * right, atol=1e-6 * np.abs(right).max())


def test_dividing_a_beam_does_not_change_statics() -> None:
    load = {"e": [1.0, 2.0, -3.0, 0.5, 0.1, -0.2]}
    coarse = static_displacement(crane(), "a", load)["e"]
    fine_beams = tuple(dataclasses.replace(beam, elements=5) for beam in crane().beams)
    fine = static_displacement(dataclasses.replace(crane(), beams=fine_beams), "a", load)["e"]
    np.testing.assert_allclose(fine, coarse, rtol=1e-7)


def test_sections_of_known_shapes() -> None:
    """A thin tube has J = 2 I and I = pi r^3 t; a square bar has J = 0.1406 a^4."""
    thin = tube(ALUMINIUM, 0.2, 1e-5)
    assert thin.Iy == pytest.approx(np.pi * 0.1**3 * 1e-5, rel=2e-4)
    torsion = [thin.J, bar(ALUMINIUM, 0.1, 0.1).J, box(ALUMINIUM, 0.1, 0.1, 1e-5).J]
    np.testing.assert_allclose(torsion, [2 * thin.Iz, 0.1406e-4, 0.1**3 * 1e-5], rtol=2e-3)
    assert bar(ALUMINIUM, 0.3, 0.1).Iz == pytest.approx(0.1 * 0.3**3 / 12)
    tall = box(ALUMINIUM, 0.3, 0.1, 0.002)
    assert tall.Iz > 4 * tall.Iy


if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@pytest.fixture(scope="module")
def telescope() -> Telescope:
    return Telescope(tomllib.loads(files("titop_plant.telescope").joinpath("reference.toml").read_text("utf-8")))


@pytest.fixture(scope="module")
def body(telescope: Telescope) -> ModalData:
    return build_body(telescope)


@pytest.fixture(scope="module")
def payload(telescope: Telescope) -> ModalData:
    return build_payload(telescope)


def test_every_mode_is_visible_at_a_port_and_distinct(body: ModalData, payload: ModalData) -> None:
    """A mode that no port excites, or two modes at one frequency, would be removed in the minimal realisation."""
    for data in (body, payload):
        assert port_visibility(data).min() > 5e-3
        assert np.min(np.diff(data.frequencies) / data.frequencies[1:]) > 5e-4


def test_positions_of_the_ports_agree_with_the_optics(
    telescope: Telescope, body: ModalData, payload: ModalData
) -> None:
    optics = telescope.optics
    m1, m2, detector = (payload.child(name).position for name in ("M1", "M2", "DET"))
    np.testing.assert_allclose(m2 - m1, [0, 0, optics.mirror_distance], atol=1e-12)
    assert m1[2] - detector[2] == pytest.approx(optics.back_focal_distance)
    assert optics.mirror_distance < optics.primary_focal_length
    assert body.child("A1").position[1] > 0 > body.child("A2").position[1]
    np.testing.assert_array_equal(payload.parent_position, 0.0)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda data: dataclasses.replace(data, parent="X"), "parent must be 'I_p', got 'X'"),
        (lambda data: dataclasses.replace(data, children=data.children[:2]), "child ports must be .*, got no 'DET'"),
    ],
)
def test_a_modal_data_file_with_other_points_is_an_error(
    telescope: Telescope, payload: ModalData, tmp_path: Path, change: Any, word: str
) -> None:
    path = tmp_path / "mine.toml"
    write_modal_data(change(payload), path)
    with pytest.raises(ValueError, match=f"mine.toml: payload: {word}"):
        build_payload(telescope.changed({"payload": {"modal_data": str(path)}}))


def test_modal_files_of_both_bodies_reproduce_the_telescope(
    body: ModalData, payload: ModalData, tmp_path: Path
) -> None:
    """Written to files, named in a parameter file and read again: the same model bit for bit."""
    for data in (body, payload):
        write_modal_data(data, tmp_path / f"{data.name}.toml")
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "reference"\n[body]\nmodal_data = "body.toml"\n[payload]\nmodal_data = "payload.toml"\n')
    again, reference = build_telescope(load_telescope(mine)).system, build_telescope().system
    assert again.occurrences() == reference.occurrences()
    for key in "ABCD":
        np.testing.assert_array_equal(getattr(again, key), getattr(reference, key))


def test_the_hash_of_the_parameters_follows_the_content_of_a_modal_file(payload: ModalData, tmp_path: Path) -> None:
    hashes = []
    for folder, modes in (("a", 5), ("b", 5), ("c", 4)):
        (tmp_path / folder).mkdir()
        write_modal_data(payload.truncate(modes), tmp_path / folder / "payload.toml")
        mine = tmp_path / folder / "mine.toml"
        mine.write_text('base = "reference"\n[payload]\nmodal_data = "payload.toml"\n')
        hashes.append(load_telescope(mine).parameters_hash)
    assert hashes[0] == hashes[1] != hashes[2]
    (tmp_path / "c" / "payload.toml").unlink()
    with pytest.raises(
        ValueError, match=r"'payload.modal_data' must be a readable file, got .*payload.toml: No such file"
    ):
        build_payload(load_telescope(tmp_path / "c" / "mine.toml"))
