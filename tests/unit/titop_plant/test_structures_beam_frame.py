"""Beam frames: rigid motion, invariance under rotation, exact rigid mass, errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.spatial.transform import Rotation

from lftkit.arrays import FloatArray
from titop_plant.structures import (
    Beam,
    BeamFrame,
    LumpedMass,
    Section,
    effective_masses,
    static_displacement,
    to_modal_data,
)
from titop_plant.structures.beam_frame import assemble, rigid_body_modes
from titop_plant.structures.sections import bar, box, tube

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


def massless_link() -> BeamFrame:
    return dataclasses.replace(crane(), masses=(), beams=(Beam("a", "c", SECTION),))


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: to_modal_data(crane(), "x", ["e"]), "crane: parent and ports must be of .*, got 'x'"),
        (lambda: to_modal_data(crane(), "a", ["e"], 999), "modes must be 0 to 30, got 999"),
        (lambda: static_displacement(crane(), "a", {"x": np.zeros(6)}), "loaded node must be one of .*, got 'x'"),
        (
            lambda: dataclasses.replace(crane(), beams=(Beam("a", "x", SECTION),)),
            "ends of beam a-x must be nodes, got unknown node 'x'",
        ),
        (lambda: dataclasses.replace(crane(), masses=(LumpedMass("x", 1.0),)), "must be at a node, got 'x'"),
        (lambda: dataclasses.replace(crane(), beams=(Beam("a", "a", SECTION),)), "end points must be different"),
        (lambda: dataclasses.replace(crane(), beams=(Beam("a", "c", SECTION, [0.8, 0.1, 0.2]),)), "parallel"),
        (lambda: Beam("a", "c", SECTION, elements=0), "elements must be at least 1"),
        (lambda: LumpedMass("a", -1.0, name="tank"), "'?tank'?: mass must not be negative, got -1"),
        (lambda: dataclasses.replace(SECTION, E=-1.0), "E must be positive"),
        (lambda: dataclasses.replace(SECTION, density=-1.0), "density"),
        (lambda: tube(ALUMINIUM, 0.1, 0.06), "tube"),
        (lambda: box(ALUMINIUM, 0.1, 0.1, 0.05), "box"),
        (lambda: bar(ALUMINIUM, 0.1, 0.0), "bar"),
        (lambda: to_modal_data(massless_link(), "a", []), "mass in all six directions"),
    ],
)
def test_errors_name_the_quantity(make: object, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        make()  # type: ignore[operator]


def test_a_mechanism_is_found() -> None:
    """A disconnected second part has a mass but no stiffness."""
    nodes = {**crane().nodes, "f": np.array([5.0, 0.0, 0.0])}
    free = dataclasses.replace(
        crane(), nodes=nodes, masses=(*crane().masses, LumpedMass("f", 1.0, np.eye(3), name="lost"))
    )
    with pytest.raises(ValueError, match="crane: structure must have no mechanism"):
        to_modal_data(free, "a", ["e"])


def test_sections_of_known_shapes() -> None:
    """A thin tube has J = 2 I and I = pi r^3 t; a square bar has J = 0.1406 a^4."""
    thin = tube(ALUMINIUM, 0.2, 1e-5)
    assert thin.Iy == pytest.approx(np.pi * 0.1**3 * 1e-5, rel=2e-4)
    torsion = [thin.J, bar(ALUMINIUM, 0.1, 0.1).J, box(ALUMINIUM, 0.1, 0.1, 1e-5).J]
    np.testing.assert_allclose(torsion, [2 * thin.Iz, 0.1406e-4, 0.1**3 * 1e-5], rtol=2e-3)
    assert bar(ALUMINIUM, 0.3, 0.1).Iz == pytest.approx(0.1 * 0.3**3 / 12)
    tall = box(ALUMINIUM, 0.3, 0.1, 0.002)
    assert tall.Iz > 4 * tall.Iy
