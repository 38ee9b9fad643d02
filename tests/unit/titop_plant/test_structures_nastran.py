"""NASTRAN import of files that pyNastran writes from a beam frame of this project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.nastran_deliveries import Delivery, write_deck, write_results

from titop_plant.structures import Beam, BeamFrame, LumpedMass, ModalData, Section, to_modal_data
from titop_plant.structures.nastran import read_nastran

pytest.importorskip("pyNastran", reason="extra nastran")

PARENT, KEEP = "a", 8
SECTION = Section(E=7e10, G=2.7e10, density=2800.0, A=4e-4, Iy=3e-8, Iz=6e-8, J=5e-8)


def frame(density: float = 2800.0) -> BeamFrame:
    """An asymmetric frame with eccentric blocks; with zero density all its mass is in CONM2 cards."""
    section = Section(SECTION.E, SECTION.G, density, SECTION.A, SECTION.Iy, SECTION.Iz, SECTION.J)
    nodes = {"a": [0.3, -0.2, 0.1], "c": [0.8, 0.1, 0.2], "d": [0.7, 0.9, 0.5], "e": [1.4, 0.9, 0.6]}
    up = np.array([0.1, 0.2, 1.0])
    beams = tuple(Beam(i, j, section, up) for i, j in ("ac", "cd", "ad", "de"))
    spin = Rotation.from_euler("xyz", [0.5, 0.2, -0.3]).as_matrix()
    masses = tuple(
        LumpedMass(node, 5.0 + k, spin @ np.diag([0.3, 0.2, 0.4]) @ spin.T, [0.1, 0.02 * k, -0.05])
        for k, node in enumerate("cde")
    )
    return BeamFrame("crane", nodes, beams, masses)


def write_bdf(source: BeamFrame, path: Path, clamp: str = "123456", also: int | None = None) -> None:
    held = [PARENT] if also is None else [PARENT, list(source.nodes)[also - 1]]
    write_deck(Delivery(source, dict.fromkeys(held, clamp) if clamp else {}), path)


def write_op2(source: BeamFrame, path: Path, *, weight: int | None = 0, **missing: bool) -> None:
    """Modes, constraint forces and grid point weight of the frame's mass and stiffness matrices."""
    write_results(Delivery(source, {PARENT: "123456"}, weight=weight, keep=KEEP), path, **missing)


def imported(folder: Path, source: BeamFrame | None = None, **op2: Any) -> ModalData:
    source = source or frame()
    write_bdf(source, folder / "crane.bdf")
    write_op2(source, folder / "crane.op2", **op2)
    return load(folder)


def load(folder: Path, **options: Any) -> ModalData:
    arguments: dict[str, Any] = {"name": "crane", "parent": ("a", 1), "ports": {"e": 4, "d": 3}, **options}
    return read_nastran(folder / "crane.bdf", folder / "crane.op2", **arguments)


def same_body(found: ModalData, expected: ModalData, tolerance: float) -> None:
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=tolerance)
    np.testing.assert_allclose(
        found.mass_matrix, expected.mass_matrix, atol=tolerance * np.abs(expected.mass_matrix).max()
    )
    signs = np.sign(np.sum(found.participation * expected.participation, axis=1))
    largest = np.abs(expected.participation).max()
    np.testing.assert_allclose(
        signs[:, None] * found.participation, expected.participation, atol=10 * tolerance * largest
    )
    for child in expected.children:
        shapes = found.child(child.name).shapes
        np.testing.assert_allclose(signs * shapes, child.shapes, atol=10 * tolerance * np.abs(child.shapes).max())
        np.testing.assert_allclose(found.child(child.name).position, child.position, atol=1e-12)


@pytest.mark.parametrize("weight", [0, 1, 3])
def test_import_agrees_with_the_frame_to_single_precision(tmp_path: Path, weight: int) -> None:
    same_body(imported(tmp_path, weight=weight), to_modal_data(frame(), PARENT, ["e", "d"], KEEP), 2e-6)


def test_mass_comes_from_the_bulk_data_without_grid_point_weight(tmp_path: Path) -> None:
    """Lumped masses exactly (products of inertia with their sign), bars as slender rods."""
    light = frame(density=1e-6)
    found = imported(tmp_path, light, weight=None)
    expected = to_modal_data(light, PARENT, ["e"], KEEP)
    np.testing.assert_allclose(found.mass_matrix, expected.mass_matrix, atol=1e-6)
    heavy = imported(tmp_path, weight=None)
    rods = to_modal_data(frame(), PARENT, ["e"], KEEP)
    spin_inertia = 2800.0 * (SECTION.Iy + SECTION.Iz) * 4.0  # left out of slender rods, at most
    np.testing.assert_allclose(heavy.mass_matrix, rods.mass_matrix, atol=spin_inertia)


def test_a_given_mass_matrix_replaces_that_of_the_files(tmp_path: Path) -> None:
    known = imported(tmp_path).mass_matrix
    np.testing.assert_array_equal(load(tmp_path, mass_matrix=1.5 * known).mass_matrix, 1.5 * known)
    with pytest.raises(ValueError, match="crane: residual mass"):
        load(tmp_path, mass_matrix=0.5 * known)


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ({"modes": False}, ["crane.op2", "must contain real eigenvectors"]),
        ({"forces": False}, ["crane.op2", "must contain forces of single-point constraint"]),
    ],
)
def test_an_op2_without_required_results_is_an_error(
    tmp_path: Path, missing: dict[str, bool], words: list[str]
) -> None:
    with pytest.raises(ValueError) as caught:
        imported(tmp_path, **missing)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"clamp": ""}, "crane.bdf: the parent GRID 1 must be clamped .*got nothing"),
        ({"clamp": "123"}, "crane.bdf: the parent GRID 1 must be clamped .*got 123"),
        ({"also": 3}, r"crane.bdf: SPC must be at the parent GRID 1 alone, got SPC at \[3\]"),
    ],
)
def test_a_bdf_with_other_constraints_is_an_error(tmp_path: Path, options: dict[str, Any], word: str) -> None:
    write_bdf(frame(), tmp_path / "crane.bdf", **options)
    write_op2(frame(), tmp_path / "crane.op2")
    with pytest.raises(ValueError, match=word):
        load(tmp_path)


def spoil(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text("this is no NASTRAN file\n")


@pytest.mark.parametrize(
    ("damage", "error", "word"),
    [
        (spoil("crane.bdf"), ValueError, "crane.bdf: BDF must be readable by pyNastran"),
        (spoil("crane.op2"), ValueError, "crane.op2: OP2 must be readable by pyNastran"),
        (lambda folder: (folder / "crane.op2").unlink(), FileNotFoundError, "crane.op2"),
        (lambda folder: (folder / "crane.bdf").unlink(), FileNotFoundError, "crane.bdf"),
    ],
)
def test_broken_files_are_named_in_one_line(
    tmp_path: Path, damage: Callable[[Path], None], error: type[Exception], word: str
) -> None:
    imported(tmp_path)
    damage(tmp_path)
    with pytest.raises(error, match=word) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
