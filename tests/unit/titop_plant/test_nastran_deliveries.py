"""NASTRAN runs as they are delivered: rings of bolts, straight booms, stated units; each a body, or refused by reason.

The expected body is assembled here from the matrices of the frame (``L = Phi' M R``), not from constraint forces.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from support.nastran_deliveries import (
    CYLINDRICAL,
    RECTANGULAR,
    TURNED,
    Delivery,
    Solution,
    matrices,
    solved,
    with_residual_vectors,
    write_deck,
    write_results,
)
from unit.titop_plant.test_nastran_decks import same_body, scaled

from titop_plant.nastran import Interface, nastran_mass, read_nastran
from titop_plant.nastran.units import INCH, POUND_FORCE, DeckUnits
from titop_plant.structures import Beam, BeamFrame, ChildPort, LumpedMass, ModalData, to_modal_data
from titop_plant.structures.beam_frame import rigid_body_modes
from titop_plant.structures.sections import tube

pytest.importorskip("pyNastran", reason="extra nastran")

ALUMINIUM = {"E": 70e9, "G": 27e9, "density": 2700.0}
RING = tuple(f"bolt {k}" for k in range(6))
POINT = np.array([0.1, -0.3, 0.2])


def tower(centre: bool = True) -> BeamFrame:
    """Six struts from a ring of bolts to a platform with an eccentric mast."""
    nodes: dict[str, Any] = {"P": POINT} if centre else {}
    for k, bolt in enumerate(RING):
        angle = 2 * np.pi * k / len(RING)
        nodes[bolt] = POINT + np.array([0.5 * np.cos(angle), 0.4 * np.sin(angle), 0.0])
    nodes |= {"top": POINT + np.array([0.05, 0.02, 1.2]), "tip": POINT + np.array([0.3, 0.0, 1.8])}
    section = tube(ALUMINIUM, 0.04, 0.002)
    beams = (*(Beam(bolt, "top", section) for bolt in RING), Beam("top", "tip", section, elements=3))
    blocks = (
        LumpedMass("tip", 3.0, np.diag([0.02, 0.03, 0.04]), [0.02, 0.0, 0.05]),
        LumpedMass("top", 8.0, np.diag([0.2, 0.3, 0.4])),
    )
    return BeamFrame("tower", nodes, beams, blocks)


def boom(elements: int = 10) -> BeamFrame:
    """A straight tube of 2 m, clamped at P."""
    section = tube(ALUMINIUM, 0.08, 0.002)
    nodes = {"P": np.zeros(3), "tip": np.array([2.0, 0.0, 0.0])}
    return BeamFrame("boom", nodes, (Beam("P", "tip", section, elements=elements),))


def load(folder: Path, delivery: Delivery, parent: Any = ("P", 1), **options: Any) -> ModalData:
    write_deck(delivery, folder / "x.bdf")
    write_results(delivery, folder / "x.op2")
    return again(folder, delivery, parent, **options)


def again(folder: Path, delivery: Delivery, parent: Any = ("P", 1), **options: Any) -> ModalData:
    ports = {"tip": delivery.grid("tip")}
    return read_nastran(folder / "x.bdf", folder / "x.op2", name="x", parent=parent, ports=ports, **options)


def expected(delivery: Delivery, point: np.ndarray = POINT, found: Solution | None = None) -> ModalData:
    """The body by the inertia of its modes."""
    names, M, _ = matrices(delivery)
    found = found or solved(delivery)
    rigid = rigid_body_modes(delivery.frame, names, point)
    row, place = 6 * names.index("tip"), delivery.frame.nodes["tip"]
    return ModalData(
        "x",
        "P",
        point,
        rigid.T @ M @ rigid,
        np.sqrt(found.squares),
        np.full(found.squares.size, 0.005),
        found.shapes.T @ M @ rigid,
        (ChildPort("tip", place, found.shapes[row : row + 6]),),
    )


BOLTS = Interface("P", tuple(range(1, 7)))
HELD: dict[str, tuple[Delivery, Any]] = {
    "RBE2": (Delivery(tower(), {"P": "123456"}, rbe2={"P": RING}), ("P", 1)),
    "RBE3": (Delivery(tower(), {"P": "123456"}, rbe3={"P": RING}), ("P", 1)),
    "bolts clamped": (Delivery(tower(False), dict.fromkeys(RING, "123456")), BOLTS),
    "bolts pinned": (Delivery(tower(False), dict.fromkeys(RING, "123")), BOLTS),
    "three points, six components": (
        Delivery(tower(False), {RING[0]: "123", RING[2]: "23", RING[4]: "3"}),
        Interface("P", (1, 3, 5), at=tuple(POINT)),
    ),
    "centre in the deck": (
        Delivery(tower(), dict.fromkeys(("P", *RING), "123456")),
        Interface("P", tuple(range(2, 8)), at=1),
    ),
}


@pytest.mark.parametrize("lumped", [False, True])
@pytest.mark.parametrize("kind", HELD)
def test_a_ring_of_bolts_is_one_interface(tmp_path: Path, kind: str, lumped: bool) -> None:
    delivery, parent = HELD[kind]
    delivery = replace(delivery, lumped=lumped, weight=None if lumped else 0)
    same_body(load(tmp_path, delivery, parent), expected(delivery), 1e-5)


def test_effective_masses_of_all_modes_are_the_mass_that_is_not_held(tmp_path: Path) -> None:
    """Lumped masses: the halves of the struts at the bolts move with P, all others in the modes."""
    delivery = replace(HELD["RBE2"][0], lumped=True, keep=15)
    body, frame = load(tmp_path, delivery), delivery.frame
    section, arms = frame.beams[0].section, [frame.nodes["top"] - frame.nodes[bolt] for bolt in RING]
    held = 0.5 * section.density * section.A * sum(float(np.sqrt(arm @ arm)) for arm in arms)
    effective = body.participation.T @ body.participation
    np.testing.assert_allclose(effective[:3, :3], (body.mass - held) * np.eye(3), atol=1e-5 * body.mass)


TURNED_GRIDS = {**dict.fromkeys(RING, CYLINDRICAL), "tip": RECTANGULAR, "top": CYLINDRICAL}
"""Grid points whose displacements have axes of their own."""


@pytest.mark.parametrize("kind", ["bolts clamped", "bolts pinned", "RBE2"])
def test_displacement_coordinates_do_not_change_the_body(tmp_path: Path, kind: str) -> None:
    """Radial and tangential components at the bolts, turned ones at the port: the body is in the basic coordinates."""
    delivery, parent = HELD[kind]
    same_body(load(tmp_path, replace(delivery, cd=TURNED_GRIDS), parent), expected(delivery), 1e-5)


def test_constraints_are_in_the_displacement_coordinates(tmp_path: Path) -> None:
    """A kinematic mount of six components along axes of their own holds; two radial ones less do not."""
    spc = {RING[0]: "123", RING[2]: "13", RING[4]: "3"}
    delivery = Delivery(tower(False), spc, cd=dict.fromkeys(RING, CYLINDRICAL))
    parent = Interface("P", (1, 3, 5), at=tuple(POINT))
    same_body(load(tmp_path, delivery, parent), expected(delivery), 1e-5)


@pytest.mark.parametrize("cid", [RECTANGULAR, CYLINDRICAL, -1])
def test_a_mass_in_coordinates_of_its_own_is_the_same(tmp_path: Path, cid: int) -> None:
    """Offset and inertia of a CONM2 in the axes of CID, or its position with CID -1."""
    from pyNastran.bdf.bdf import BDF

    source = tower()
    lump = replace(source.masses[0], inertia=TURNED.T @ np.diag([0.02, 0.03, 0.04]) @ TURNED)
    delivery = Delivery(replace(source, masses=(lump,)), cd={"top": RECTANGULAR})
    write_deck(delivery, tmp_path / "x.bdf")
    whole = nastran_mass(tmp_path / "x.bdf", parent=("P", 1))
    own = lump.inertia if cid == -1 else TURNED @ lump.inertia @ TURNED.T
    offset = source.nodes["tip"] + lump.offset if cid == -1 else TURNED @ lump.offset
    model = BDF(debug=None)
    entries = [own[0, 0], -own[1, 0], own[1, 1], -own[2, 0], -own[2, 1], own[2, 2]]
    model.add_conm2(1001, delivery.grid("tip"), lump.mass, cid=cid, X=offset, I=entries)
    text = (tmp_path / "x.bdf").read_text()
    before, after = text.split("$MASSES")
    cards = after.split("$")[1:]
    (tmp_path / "x.bdf").write_text(f"{before}{model.masses[1001].write_card_16(is_double=True)}${'$'.join(cards)}")
    found = nastran_mass(tmp_path / "x.bdf", parent=("P", 1))
    np.testing.assert_allclose(found, whole, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("cid", [0, RECTANGULAR])
def test_a_mass_matrix_at_a_grid_point_is_that_of_its_block(tmp_path: Path, cid: int) -> None:
    """CONM1 in the place of CONM2, in the basic axes or in those of CID."""
    from pyNastran.bdf.bdf import BDF

    delivery = Delivery(tower(), {"P": "123456"}, {"P": RING}, lumped=True, weight=None, cd={"top": RECTANGULAR})
    body = load(tmp_path, delivery)
    model, turn = BDF(debug=None), block_diag(TURNED, TURNED) if cid else np.eye(6)
    for number, lump in enumerate(delivery.frame.masses, start=1001):
        model.add_conm1(number, delivery.grid(lump.node), turn @ lump.matrix() @ turn.T, cid=cid)
    before, after = (tmp_path / "x.bdf").read_text().split("$MASSES")
    cards = "".join(model.masses[number].write_card_16(is_double=True) for number in model.masses)
    (tmp_path / "x.bdf").write_text(f"{before}{cards}${'$'.join(after.split('$')[1:])}")
    same_body(again(tmp_path, delivery), body, 1e-9)


def test_non_structural_mass_is_that_of_the_run(tmp_path: Path) -> None:
    """The block at the top is in an NSM1 of the deck: its mass is known by the grid point weight alone."""
    delivery = Delivery(tower(), {"P": "123456"}, {"P": RING})
    body = load(tmp_path, delivery)
    text = (tmp_path / "x.bdf").read_text()
    first, last = text.index("CONM2*              1002"), text.index("$RIGID")
    (tmp_path / "x.bdf").write_text(f"{text[:first]}{text[last:].rstrip()}\nNSM1,7,PBAR,3.0,1\n")
    same_body(again(tmp_path, delivery), body, 1e-9)
    write_results(replace(delivery, weight=None), tmp_path / "x.op2")
    with pytest.raises(ValueError, match=r"masses must be those of CONM1, .*GRDPNT.*, got NSM set 7$"):
        again(tmp_path, delivery)


def test_a_binary_file_in_the_place_of_a_deck_is_named(tmp_path: Path) -> None:
    delivery = Delivery(boom(), {"P": "123456"})
    load(tmp_path, delivery)
    with pytest.raises(ValueError, match=r"x\.op2: bulk data and punch files must be text, got a binary file"):
        read_nastran(tmp_path / "x.op2", tmp_path / "x.bdf", name="x", parent=("P", 1), ports={"tip": 11})


@pytest.mark.parametrize("kind", ["RBE2", "RBE3", "bolts pinned"])
def test_without_constraint_forces_lumped_masses_give_the_participation(tmp_path: Path, kind: str) -> None:
    """With WTMASS and turned displacements, too; the expected body is that of all forces."""
    delivery, parent = HELD[kind]
    delivery = replace(delivery, lumped=True, wtmass=0.5, cd={"tip": RECTANGULAR})
    write_deck(delivery, tmp_path / "x.bdf")
    write_results(delivery, tmp_path / "x.op2", forces=False)
    same_body(again(tmp_path, delivery, parent, units="SI"), expected(delivery), 1e-5)


def test_without_constraint_forces_other_masses_are_refused(tmp_path: Path) -> None:
    """A deck that is lumped by its parameters beside modes of consistent masses, or of a lighter block."""
    delivery, parent = HELD["RBE2"]
    write_deck(replace(delivery, lumped=True), tmp_path / "x.bdf")
    write_results(delivery, tmp_path / "x.op2", forces=False)
    with pytest.raises(ValueError, match=r"SPCFORCES\(PLOT\)=ALL\), got none, and the masses of the deck .* miss I by"):
        again(tmp_path, delivery, parent)
    light = replace(tower(), masses=(replace(tower().masses[0], mass=2.9), tower().masses[1]))
    write_results(replace(delivery, frame=light, lumped=True, weight=None), tmp_path / "x.op2", forces=False)
    with pytest.raises(ValueError, match="miss I by"):
        again(tmp_path, delivery, parent)


@pytest.mark.parametrize("lumped", [False, True])
def test_modes_of_any_normalisation_are_the_same_body(tmp_path: Path, lumped: bool) -> None:
    """NORM MAX: the generalised masses are in the table of eigenvalues, and without it the modes are refused."""
    delivery, parent = HELD["RBE2"]
    delivery = replace(delivery, lumped=lumped, wtmass=0.5, cards="EIGRL,1,,,8,,,,MAX\n")
    write_deck(delivery, tmp_path / "x.bdf")
    write_results(delivery, tmp_path / "x.op2", largest=True, eigenvalues=True)
    same_body(again(tmp_path, delivery, parent, units="SI"), expected(delivery), 1e-5)
    write_results(delivery, tmp_path / "x.op2", largest=True)
    with pytest.raises(ValueError, match=r"table of eigenvalues of these modes .*, got none and EIGRL 1 with NORM MAX"):
        again(tmp_path, delivery, parent, units="SI")
    write_deck(replace(delivery, cards=""), tmp_path / "x.bdf")
    with pytest.raises(ValueError, match=r"modes of unit generalised mass .* miss I by"):
        again(tmp_path, delivery, parent, units="SI")


def test_residual_vectors_have_the_momentum_of_their_masses(tmp_path: Path) -> None:
    """Ritz vectors leave forces at the ports: those of constraint are not the inertia of the mode alone."""
    delivery, parent = HELD["bolts clamped"]
    delivery = replace(delivery, lumped=True, cards="SOL 103\nCEND\nSPC = 1\nRESVEC = YES\nBEGIN BULK\n")
    found = with_residual_vectors(delivery, 5, "tip")
    write_deck(delivery, tmp_path / "x.bdf")
    write_results(delivery, tmp_path / "x.op2", solution=found)
    same_body(again(tmp_path, delivery, parent), expected(delivery, found=found), 1e-5)
    write_deck(replace(delivery, cards=""), tmp_path / "x.bdf")
    with pytest.raises(ValueError, match=r"without residual vectors \(RESVEC = NO\), got forces of constraint that"):
        again(tmp_path, delivery, parent)
    coupled = replace(delivery, lumped=False)
    write_deck(coupled, tmp_path / "x.bdf")
    write_results(coupled, tmp_path / "x.op2", solution=with_residual_vectors(coupled, 5, "tip"))
    with pytest.raises(
        ValueError, match=r"must be eigenvectors .*, got RESVEC = YES, and the masses of the deck .* I by"
    ):
        again(tmp_path, coupled, parent)


def test_a_port_without_rotations_is_refused(tmp_path: Path) -> None:
    """As a grid point of solid elements, whose rotations NASTRAN leaves at zero."""
    delivery, parent = HELD["bolts clamped"]
    write_deck(delivery, tmp_path / "x.bdf")
    found = solved(delivery)
    found.shapes[6 * delivery.grid("tip") - 3 :][:3] = 0.0
    write_results(delivery, tmp_path / "x.op2", solution=found)
    with pytest.raises(ValueError, match=r"GRID 8 \('tip'\) must turn with the structure .*, got rotations of zero"):
        again(tmp_path, delivery, parent)


def test_an_interface_without_one_of_its_bolts_is_refused(tmp_path: Path) -> None:
    delivery, _ = HELD["bolts clamped"]
    words = r"SPC must be at the parent grid points \[1, 2, 3, 4, 5\] alone, got SPC at \[6\] too"
    with pytest.raises(ValueError, match=words):
        load(tmp_path, delivery, Interface("P", (1, 2, 3, 4, 5)))
    words = r"alone, got SPC at \[2, 3, 4, 5, 6\] too; Interface\('P', \(1, 2, 3, 4, 5, 6\)\) takes them"
    with pytest.raises(ValueError, match=words):
        again(tmp_path, delivery, ("P", 1))


def test_a_hinge_is_no_interface(tmp_path: Path) -> None:
    """Two pinned points let the body turn about the line between them: its eigenvalue of zero is not even looked at."""
    delivery = Delivery(tower(False), {RING[0]: "123", RING[3]: "123", RING[1]: "3"})
    with pytest.raises(ValueError, match=r"must hold all six rigid motions, got \{1: '123', 4: '123'\}"):
        load(tmp_path, delivery, Interface("P", (1, 4)))
    with pytest.raises(ValueError, match=r"the parent GRID 1 must be clamped .*, got 123 and SPC at \[2, 4\]"):
        again(tmp_path, delivery)


def test_an_op2_of_other_constraints_than_the_deck_is_refused(tmp_path: Path) -> None:
    """The deck clamps the bolts, the run pinned them: the eigenvectors turn what the deck holds."""
    write_deck(HELD["bolts clamped"][0], tmp_path / "x.bdf")
    write_results(HELD["bolts pinned"][0], tmp_path / "x.op2")
    with pytest.raises(ValueError, match="a run that clamps GRID 1 as the deck does, got motion"):
        again(tmp_path, HELD["bolts pinned"][0], BOLTS)


def test_constraints_of_a_set_that_the_case_does_not_name_are_not_used(tmp_path: Path) -> None:
    delivery, parent = HELD["RBE2"]
    write_results(delivery, tmp_path / "x.op2")
    write_deck(delivery, tmp_path / "x.bdf")
    bulk = (tmp_path / "x.bdf").read_text().replace("ENDDATA", "")
    case = "SOL 103\nCEND\nSPC = {}\nMETHOD = 1\nBEGIN BULK\n"
    of_two = "1\nSUBCASE 1\nLABEL = HELD\nSUBCASE 2\nSPC = 7"  # the results are those of the first
    for chosen, more in ((1, ""), (9, "SPCADD,9,1\n"), (of_two, "")):
        (tmp_path / "x.bdf").write_text(f"{case.format(chosen)}{bulk}SPC1,7,123456,9\n{more}ENDDATA\n")
        same_body(again(tmp_path, delivery, parent), expected(delivery), 1e-5)
    (tmp_path / "x.bdf").write_text(f"{case.format(7)}{bulk}SPC1,7,123456,9\nENDDATA\n")
    with pytest.raises(ValueError, match=r"the parent GRID 1 must be clamped .* got nothing and SPC at \[9\]"):
        again(tmp_path, delivery, parent)


def test_a_free_body_is_refused_with_what_to_ask_for(tmp_path: Path) -> None:
    delivery = Delivery(tower(False), keep=14)
    words = "must be clamped .* got nothing: .* ask for SOL 103 with the interface in SPC1 .* KAAX and MAAX"
    with pytest.raises(ValueError, match=words):
        load(tmp_path, delivery)
    write_deck(HELD["bolts clamped"][0], tmp_path / "x.bdf")  # a deck with SPC beside the results of the free body
    with pytest.raises(ValueError, match="a run that clamps GRID 1 as the deck does"):
        again(tmp_path, delivery, BOLTS)


UNITS = {
    "SI": (1.0, 1.0, 1.0),
    "mm-t-s": (1e-3, 1e3, 1.0),
    "mm-kg-s": (1e-3, 1.0, 1.0),
    "inch-lbf-s": (INCH, POUND_FORCE / INCH, 1.0),
    "inch-LBF-S": (INCH, POUND_FORCE / INCH, 1.0 / 386.0886),  # the deck states pounds
    "N-MM": (1e-3, 1e3, 1e-3),  # kilograms beside N and mm
}


@pytest.mark.parametrize("lumped", [False, True])
@pytest.mark.parametrize("name", UNITS)
def test_a_deck_in_stated_units_is_the_same_body(tmp_path: Path, name: str, lumped: bool) -> None:
    """With and without WTMASS, mass of the grid point weight and of the elements, names and factors."""
    delivery, _ = HELD["RBE2"]
    length, mass, weight = UNITS[name]
    deck = replace(delivery, frame=scaled(delivery.frame, length, mass), wtmass=weight)
    if lumped:
        deck = replace(deck, lumped=True, weight=None)
    body = expected(replace(delivery, lumped=lumped))
    same_body(load(tmp_path, deck, units=name), body, 1e-5)
    same_body(again(tmp_path, deck, units=(length, mass)), body, 1e-5)
    same_body(again(tmp_path, deck, units=DeckUnits(length, mass, weight)), body, 1e-5)
    found = nastran_mass(tmp_path / "x.bdf", parent=("P", 1), units=name)
    np.testing.assert_allclose(found, body.mass_matrix, atol=1e-9 * np.abs(body.mass_matrix).max())


@pytest.mark.parametrize(
    ("of", "units", "cards", "message"),
    [
        ("mm-t-s", None, "", r"units must be given .*, got none, and E = 7e\+04 of the stiffest material"),
        ("mm-t-s", "furlong", "", "units must be one of SI, mm-t-s, .*, got furlong"),
        ("mm-t-s", (1.0, 2.0, 3.0), "", r"units must be a name, or two factors .*, got \(1.0, 2.0, 3.0\)"),
        ("mm-t-s", (0.0, 1.0), "", "units: length must be positive, got 0.0"),
        ("mm-t-s", "SI", "PARAM,UNITSYS,N-MM\n", "units must be those of PARAM,UNITSYS,N-MM in the deck, got SI"),
        # its aluminium would be a thousand times stiffer than diamond, or lighter than foam at the same frequencies
        ("SI", "mm-t-s", "", r"units must be those of the deck, got mm-t-s, .* has E = \S+e\+1[3-6] Pa"),
        ("mm-t-s", "mm-kg-s", "", r"those of the deck, got mm-kg-s, .* densest material has \S+ kg/m3"),
    ],
)
def test_units_that_are_unknown_or_contradict_are_refused(
    tmp_path: Path, of: str, units: Any, cards: str, message: str
) -> None:
    delivery, _ = HELD["RBE2"]
    deck = replace(delivery, frame=scaled(delivery.frame, *UNITS[of][:2]), cards=cards)
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path, deck, units=units)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("weight", [0, None])
@pytest.mark.parametrize("lumped", [False, True])
def test_a_straight_boom_of_bars_is_a_cantilever(tmp_path: Path, lumped: bool, weight: int | None) -> None:
    """Frequencies (beta L)^2 sqrt(EI / (rho A L^4)), beta L = 1.87510, 4.69409 (Blevins, table 8-1); inertia about
    the axis rho (Iy + Iz) L, also where lumped masses have none."""
    delivery = Delivery(boom(), {"P": "123456"}, lumped=lumped, weight=weight, keep=4)
    body = load(tmp_path, delivery)
    s = tube(ALUMINIUM, 0.08, 0.002)
    closed = np.repeat([1.87510407, 4.69409113], 2) ** 2 * np.sqrt(s.E * s.Iy / (s.density * s.A * 2.0**4))
    np.testing.assert_allclose(body.frequencies, closed, rtol=0.02 if lumped else 1e-4)
    mass = s.density * s.A * 2.0
    assert body.mass == pytest.approx(mass, rel=1e-6)
    assert body.mass_matrix[3, 3] == pytest.approx(s.density * (s.Iy + s.Iz) * 2.0, rel=1e-6)
    assert body.mass_matrix[4, 4] == pytest.approx(mass * 2.0**2 / 3.0, rel=6e-3 if lumped else 1e-6)
    np.testing.assert_allclose(body.center_of_mass, [1.0, 0.0, 0.0], atol=1e-6)
    if not lumped:
        same_body(body, to_modal_data(boom(), "P", ["tip"], 4), 1e-5)
