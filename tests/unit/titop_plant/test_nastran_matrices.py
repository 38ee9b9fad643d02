"""Reduced matrices of a superelement (DMIG in a punch file) against the clamped modes of the whole frame."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.nastran_deliveries import Delivery, write_deck, write_superelement
from unit.titop_plant.test_nastran_decks import same_body, scaled
from unit.titop_plant.test_nastran_deliveries import HELD, RING, expected, tower

from titop_plant.nastran import Interface, read_nastran_matrices
from titop_plant.nastran.units import INCH, POUND_FORCE
from titop_plant.structures import ModalData

pytest.importorskip("pyNastran", reason="extra nastran")

FREE = Delivery(tower(), rbe2={"P": RING})
SIX = "123456"
BOUNDARY = {"P": SIX, "tip": SIX}


def reduced(folder: Path, delivery: Delivery, modes: int, boundary: dict[str, str] = BOUNDARY, **names: Any) -> None:
    write_deck(delivery, folder / "x.bdf")
    write_superelement(delivery, folder / "x.pch", boundary, modes, **names)


def load(folder: Path, delivery: Delivery = FREE, **options: Any) -> ModalData:
    given: dict[str, Any] = {"parent": ("P", 1), "ports": {"tip": delivery.grid("tip")}, "units": "SI", **options}
    return read_nastran_matrices(folder / "x.pch", folder / "x.bdf", name="x", **given)


def test_all_component_modes_give_the_whole_frame(tmp_path: Path) -> None:
    """P, tip, top and two inner nodes of the mast: two boundary nodes and all modes of the others lose nothing."""
    reduced(tmp_path, FREE, 18)
    found = load(tmp_path)
    assert found.n_modes == 24
    body = expected(HELD["RBE2"][0])
    same_body(load(tmp_path, n_modes=body.n_modes), body, 1e-6)
    assert found.mass == pytest.approx(expected(HELD["RBE2"][0]).mass, rel=1e-8)


def test_a_punch_file_of_an_external_superelement_is_geometry_and_matrices(tmp_path: Path) -> None:
    """As NASTRAN writes it with EXTBULK and DMIGPCH: BEGIN SUPER without "=", EXTRN, ASET, QSET1, SPOINT, DTI."""
    reduced(tmp_path, FREE, 4)
    body = load(tmp_path)
    head = "$ STANDARD PUNCH (.PCH) FILE FOR EXTERNAL SUPERELEMENT  111\n$\nBEGIN SUPER     111     \n$\n"
    grids = "".join(re.findall(r"GRID\*.*\n\*.*\n", (tmp_path / "x.bdf").read_text()))
    sets = [
        ("EXTRN", 1, 123456, 9, 123456, 9001, 0),
        ("ASET", 1, 123456, 9, 123456),
        ("QSET1", 0, 9001, "THRU", 9004),
        ("SPOINT", 9001, "THRU", 9004),
    ]
    cards = "".join(f"{card[0]:<8}" + "".join(f"{field:>8}" for field in card[1:]) + "\n" for card in sets)
    table = (
        "DTI     TUG1    0       66      105     32767   0       7       0       \n"
        "        PHIP            7                       REAL           1ENDREC  \n"
    )
    text = (tmp_path / "x.pch").read_text()
    (tmp_path / "x.pch").write_text(head + grids.replace("GRID*   ", "GRID   *") + "$\n" + cards + table + text)
    (tmp_path / "x.bdf").unlink()
    found = read_nastran_matrices(
        tmp_path / "x.pch", tmp_path / "x.pch", name="x", parent=("P", 1), ports={"tip": 9}, units="SI"
    )
    same_body(found, body, 1e-12)


def test_the_matrices_may_have_another_suffix(tmp_path: Path) -> None:
    """EXTSEOUT(DMIGSFIX=TOWER)."""
    reduced(tmp_path, FREE, 4)
    body = load(tmp_path)
    reduced(tmp_path, FREE, 4, names=("KTOWER", "MTOWER"))
    same_body(load(tmp_path), body, 1e-12)


@pytest.mark.parametrize("modes", [0, 2, 6])
def test_reduction_is_from_above_and_keeps_the_mass(tmp_path: Path, modes: int) -> None:
    """By Rayleigh and Ritz every frequency is too high; the static shapes contain the rigid motions exactly."""
    reduced(tmp_path, FREE, modes)
    found, body = load(tmp_path, n_modes=6), expected(HELD["RBE2"][0])
    assert np.all(found.frequencies >= body.frequencies[:6] * (1.0 - 1e-7))
    scale = np.abs(body.mass_matrix).max()
    np.testing.assert_allclose(found.mass_matrix, body.mass_matrix, atol=1e-7 * scale)
    if modes == 6:
        np.testing.assert_allclose(found.frequencies[:3], body.frequencies[:3], rtol=1e-3)


def test_bolts_of_the_boundary_are_one_interface(tmp_path: Path) -> None:
    """Bolts with their translations alone in the matrices; clamped here as the run with pinned bolts is."""
    free = Delivery(tower(False))
    reduced(tmp_path, free, 30, {**dict.fromkeys(RING, "123"), "tip": SIX})
    found = load(tmp_path, free, parent=Interface("P", tuple(range(1, 7))), n_modes=8)
    same_body(found, expected(HELD["bolts pinned"][0]), 1e-6)
    with pytest.raises(ValueError, match=r"hold all six rigid motions, got \{1: '123', 4: '123'\}"):
        load(tmp_path, free, parent=Interface("P", (1, 4)))


@pytest.mark.parametrize(("units", "length", "mass"), [("mm-t-s", 1e-3, 1e3), ("inch-lbf-s", INCH, POUND_FORCE / INCH)])
def test_matrices_in_other_units_are_the_same_body(tmp_path: Path, units: str, length: float, mass: float) -> None:
    """WTMASS of the deck is in the matrices already."""
    delivery = replace(FREE, frame=scaled(FREE.frame, length, mass), wtmass=1.0 / 386.0)
    reduced(tmp_path, delivery, 18)
    same_body(load(tmp_path, units=units, n_modes=8), expected(HELD["RBE2"][0]), 1e-6)


def test_a_grounded_component_and_other_positions_are_refused(tmp_path: Path) -> None:
    held = Delivery(tower(False), {RING[0]: SIX, RING[2]: SIX})
    reduced(tmp_path, held, 4, {RING[4]: SIX, "tip": SIX})
    with pytest.raises(ValueError, match=r"KAAX must have no force for rigid motions, .* a grounded component"):
        load(tmp_path, held, parent=("P", 5))
    reduced(tmp_path, FREE, 4)
    moved = replace(tower(), nodes={**tower().nodes, "tip": np.array([0.5, 0.2, 2.0])})
    write_deck(replace(FREE, frame=moved), tmp_path / "x.bdf")
    with pytest.raises(ValueError, match=r"no force for rigid motions, .* rotation at GRID"):
        load(tmp_path)
    write_deck(replace(FREE, frame=scaled(tower(), 1e-3, 1.0)), tmp_path / "x.bdf")  # in mm beside matrices in m
    with pytest.raises(ValueError, match="no force for rigid motions"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ports": {"M1": 8}}, r"grid point of 'M1' must be one of the 2 in the matrices \[1, 9\] .*, got GRID 8"),
        ({"parent": ("P", 2)}, r"grid point of 'P' must be one of the 2 in the matrices \[1, 9\] .*, got GRID 2"),
        ({"n_modes": 99}, "x: modes must be 0 to 10, got 99"),
        ({"units": "mm"}, "units must be one of SI, .*, got mm"),
    ],
)
def test_wrong_requests_are_named(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    reduced(tmp_path, FREE, 4)
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, **options)
    assert "\n" not in str(caught.value)


def test_incomplete_punch_files_are_named(tmp_path: Path) -> None:
    reduced(tmp_path, FREE, 0, names=("KAAX", "MXX"))
    with pytest.raises(ValueError, match=r"must have DMIG KAAX and MAAX \(EXTSEOUT.*, got \['KAAX', 'MXX'\]"):
        load(tmp_path)
    (tmp_path / "x.pch").write_text("".join(f"DMIG,{name},0,6,2,0\n" for name in ("KA", "MA", "KB", "MB")))
    with pytest.raises(ValueError, match=r"or one pair of another suffix, got \['KA', 'KB', 'MA', 'MB'\]"):
        load(tmp_path)
    reduced(tmp_path, FREE, 0, {"P": SIX, "tip": "123"})
    with pytest.raises(ValueError, match=r"GRID 9 \('tip'\) must have six components in the matrices, got 123"):
        load(tmp_path)
    text = (tmp_path / "x.pch").read_text()
    heads = [f"DMIG    KAAX    {0:>8}{6:>8}{kind:>8}" for kind in (2, 4)]  # real and complex
    (tmp_path / "x.pch").write_text(text.replace(*heads))
    with pytest.raises(ValueError, match=r"must be (real and square|readable by pyNastran)"):
        load(tmp_path)
