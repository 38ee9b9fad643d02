"""NASTRAN decks: their units, the files that they include, and an OP2 file that is of another model."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.nastran_deliveries import Delivery, write_deck, write_results

from titop_plant.nastran import Interface, nastran_mass, read_nastran
from titop_plant.nastran.files import of_subcase
from titop_plant.nastran.match import check_grids
from titop_plant.nastran.units import INCH, POUND_FORCE
from titop_plant.structures import Beam, BeamFrame, LumpedMass, ModalData, Section, to_modal_data

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


def written(folder: Path, source: BeamFrame, extra: str = "", *, weight: int | None = 0, **missing: bool) -> None:
    """Deck of a frame with further cards in front; modes, constraint forces and weight of its matrices."""
    held = Delivery(source, {PARENT: "123456"}, weight=weight, keep=KEEP)
    write_deck(held, folder / "crane.bdf")
    (folder / "crane.bdf").write_text(extra + (folder / "crane.bdf").read_text())
    write_results(held, folder / "crane.op2", **missing)


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


def scaled(source: BeamFrame, length: float, mass: float, size: float = 1.0) -> BeamFrame:
    """The frame in units of so many metres and kilograms, and larger by a factor."""
    beams = tuple(
        replace(
            beam,
            section=replace(
                beam.section,
                E=beam.section.E * length / mass,
                G=beam.section.G * length / mass,
                density=beam.section.density * length**3 / mass,
                A=beam.section.A / length**2,
                Iy=beam.section.Iy / length**4,
                Iz=beam.section.Iz / length**4,
                J=beam.section.J / length**4,
            ),
        )
        for beam in source.beams
    )
    masses = tuple(
        replace(
            one,
            mass=one.mass / mass,
            inertia=np.asarray(one.inertia) / (mass * length**2),
            offset=np.asarray(one.offset) / length,
        )
        for one in source.masses
    )
    nodes = {name: (size * np.asarray(place) / length).tolist() for name, place in source.nodes.items()}
    return BeamFrame(source.name, nodes, beams, masses)


UNITS = {"MN-MM": (1e-3, 1.0), "N-MM": (1e-3, 1e3), "LBF-IN": (INCH, POUND_FORCE / INCH), "N-M": (1.0, 1.0)}


@pytest.mark.parametrize("weight", [0, None])
@pytest.mark.parametrize("system", UNITS)
def test_a_deck_of_other_units_is_the_same_body(tmp_path: Path, system: str, weight: int | None) -> None:
    """A frame with all its mass in CONM2, so that its mass is known exactly without the grid point weight, too."""
    source = frame(density=1e-6)
    written(tmp_path, scaled(source, *UNITS[system]), f"PARAM,UNITSYS,{system}\n", weight=weight)
    same_body(load(tmp_path), to_modal_data(source, PARENT, ["e", "d"], KEEP), 1e-5)


def heavier(source: BeamFrame) -> BeamFrame:
    masses = (*source.masses[:-1], replace(source.masses[-1], mass=1.1 * source.masses[-1].mass))
    return BeamFrame(source.name, source.nodes, source.beams, masses)


OTHERS = {
    "larger by half": lambda: scaled(frame(), 1.0, 1.0, 1.5),
    "heavier at one point": lambda: heavier(frame()),
    "in millimetres": lambda: scaled(frame(), 1e-3, 1.0),
    "of denser beams": lambda: frame(density=28_000.0),
    "mirrored": lambda: BeamFrame(
        "crane", {k: [-v[0], *v[1:]] for k, v in frame().nodes.items()}, frame().beams, frame().masses
    ),
}


TENTH = "heavier at one point"
"""Within the lumping of the masses, so that the grid point weight alone has it."""


CASES = [(name, weight) for name in OTHERS for weight in (0, None) if (name, weight) != (TENTH, None)]


@pytest.mark.parametrize(("name", "weight"), CASES)
def test_a_deck_with_the_op2_of_another_model_is_refused(tmp_path: Path, name: str, weight: int | None) -> None:
    written(tmp_path, frame(), weight=weight)
    write_results(Delivery(OTHERS[name](), {PARENT: "123456"}, weight=weight, keep=KEEP), tmp_path / "crane.op2")
    with pytest.raises(ValueError, match="results must be of the model of the deck"):
        load(tmp_path)


def test_positions_that_the_op2_states_are_compared() -> None:
    def model(places: dict[int, list[float]]) -> Any:
        nodes = {grid: SimpleNamespace(get_position=lambda p=place: np.array(p)) for grid, place in places.items()}
        return SimpleNamespace(nodes=nodes, spoints={}, epoints={})

    table = SimpleNamespace(node_gridtype=np.array([[1, 1], [2, 1]]))
    stated = SimpleNamespace(
        nid_cp_cd_ps=np.array([[1, 0, 0, 0], [2, 0, 0, 0]]), xyz=np.array([[0.0, 0, 0], [2.0, 0, 0]], "float32")
    )
    results = SimpleNamespace(op2_results=SimpleNamespace(gpdt=stated))
    check_grids(model({1: [0, 0, 0], 2: [2, 0, 0]}), results, table, "x.op2")
    with pytest.raises(ValueError, match=r"GRID 2 must be where the deck has it, at \[2.1, 0.0, 0.0\]"):
        check_grids(model({1: [0, 0, 0], 2: [2.1, 0, 0]}), results, table, "x.op2")
    with pytest.raises(ValueError, match=r"got none with the numbers \[3\]"):
        check_grids(model({1: [0, 0, 0], 2: [2, 0, 0], 3: [1, 0, 0]}), results, table, "x.op2")


REFUSED = {
    "a spring to ground": ("CELAS2,5001,1.+5,3,1\n", "springs must be .*, got CELAS2 5001 to ground"),
    "a spring to a held scalar point": (
        "SPOINT,7001\nSPC1,1,0,7001\nCELAS2,5001,1.+5,3,1,7001,0\n",
        "springs must be between two grid points, got CELAS2 5001 .* scalar point",
    ),
    "an equation to ground": (
        "MPC,4,3,1,1.,3,1,1.\n",
        "MPC must let the body move .*, got MPC 4 of GRID .3, 3. against it",
    ),
    "an equation of two points": ("MPC,4,3,1,1.,2,1,-1.\n", r"MPC must let .*, got MPC 4 of GRID \[3, 2\] against it"),
    "constraints of all": ("GRDSET,,,,,,,6\n", "GRDSET must have no CP, CD and PS .*, got CP 0, CD 0, PS 6"),
    "a mass in x": ("CMASS2,6001,0.5,4,1\n", "mass must be the same in all directions .*, got .* in x, y and z"),
    "a mass between points": (
        "CMASS2,6001,0.5,3,1,4,1\n",
        "masses must be .*PARAM,GRDPNT,0 .*, got CMASS2 6001",
    ),
    "an element that is not read": ("PWELD,9,1,.01\nCWELD,61,9,4,ALIGN,2,3\n", "masses must be .*, got CWELD"),
    "a spring across its direction": (
        "CELAS2,5001,1.+5,3,1,4,1\n",
        "springs between two .* no force in a rigid motion, got CELAS2 5001",
    ),
    "a mass of a bush": ("PBUSH,50,K,1.+5\n,,M,.5\nCBUSH,5001,50,3,4,,,,0\n", "masses must be .*, got CBUSH 5001"),
    "a mass matrix of the deck": ("DMIG,MX,0,6,2,0\nDMIG,MX,4,1,,4,1,0.5\n", "masses must be .*, got DMIG MX"),
    "two parts": ("BEGIN SUPER     11\nBEGIN BULK SUPER = 2\n", "deck must be of one .*, got BEGIN SUPER 11 beside"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_body_on_its_parent_is_refused_by_its_card(tmp_path: Path, name: str) -> None:
    cards, message = REFUSED[name]
    written(tmp_path, frame(), cards, weight=None)
    with pytest.raises(ValueError, match=rf"crane\.bdf: {message}") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "cards",
    [
        "CELAS2,5001,1.+5,3,4,4,4\n",  # between rotations about one axis of two grid points
        "MPC,4,3,1,1.,2,1,-1.\n,,2,5,-.3,2,6,.8\n",  # the x component of d on c, with the arm (-0.1, 0.8, 0.3)
    ],
)
def test_springs_in_a_joint_and_equations_of_a_rigid_bar_hold_nothing(tmp_path: Path, cards: str) -> None:
    written(tmp_path, frame())
    whole = load(tmp_path)
    written(tmp_path, frame(), cards)
    same_body(load(tmp_path), whole, 1e-12)


@pytest.mark.parametrize(
    "start", [b"1  MSC NASTRAN  R E A L   E I G E N V A L U E S\n" * 4, b"\x89HDF\r\n\x1a\n", b"PK\3\4"]
)
def test_a_file_in_the_place_of_an_op2_is_named(
    tmp_path: Path, start: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    """F06, HDF5 and an archive."""
    written(tmp_path, frame())
    (tmp_path / "crane.op2").write_bytes(start + bytes(100) * (start[:1] != b"1"))
    with pytest.raises(
        ValueError, match=r"crane\.op2: OP2 must be .* \(PARAM,POST,-1 writes it\), got (text|an HDF5|a zip)"
    ):
        load(tmp_path)
    assert capfd.readouterr() == ("", "")


def test_a_damaged_op2_is_one_line_and_nothing_is_printed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    written(tmp_path, frame())
    file = tmp_path / "crane.op2"
    whole = file.read_bytes()
    capfd.readouterr()
    for share in (0.1, 0.4, 0.7, 0.9):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"crane\.op2: ") as caught:
            load(tmp_path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_two_tables_of_one_subcase_are_refused() -> None:
    """Keys of pyNastran for a superelement beside the residual structure."""
    tables = {(1, 2, 1, 0, 0, "", ""): "residual", (1, 2, 1, 0, 101, "", ""): "superelement"}
    for subcase in (None, 1):
        with pytest.raises(ValueError, match=r"x\.op2: file must contain modes once .*, got 2 tables of subcase 1 "):
            of_subcase(tables, "modes", "x.op2", subcase)


@pytest.mark.parametrize("coupled", [0, 1])
def test_masses_are_where_offsets_and_components_have_them(tmp_path: Path, coupled: int) -> None:
    """Grid points elsewhere with the offsets of bars and blocks that lead back, in displacement axes of their own; and
    a block as three CMASS2 in the place of the mass of its CONM2: the same mass matrix."""
    from pyNastran.bdf.bdf import read_bdf

    written(tmp_path, frame())
    file, parent = tmp_path / "crane.bdf", Interface("P", (1,), at=(0.1, 0.2, 0.3))
    file.write_text(file.read_text().replace("COUPMASS       1", f"COUPMASS{2 * coupled - 1:>8}"))
    whole = nastran_mass(file, parent=parent)
    model = read_bdf(str(file), punch=True, xref=False, debug=None)
    model.add_cord2r(7, [0.0, 0, 0], [0.2, -0.3, 1.0], [1.0, 0.1, 0])
    shift = dict(zip(model.nodes, np.random.default_rng(1).normal(size=(len(model.nodes), 3))))
    axes = np.asarray(model.coords[7].beta())
    for grid, node in model.nodes.items():
        node.xyz, node.cd = node.xyz - shift[grid], 7
    for bar in model.elements.values():
        bar.wa, bar.wb = axes @ shift[bar.ga], axes @ shift[bar.gb]
    for lump in model.masses.values():
        lump.X = lump.X + shift[lump.nid]
    model.write_bdf(str(file), size=16, is_double=True)
    np.testing.assert_allclose(nastran_mass(file, parent=parent), whole, atol=1e-9 * np.abs(whole).max())
    first = next(iter(model.masses.values()))
    model.add_grid(99, model.nodes[first.nid].xyz + first.X, cd=7)
    for component in (1, 2, 3):
        model.add_cmass2(6000 + component, first.mass, [99, 0], component, 0)
    first.mass = 0.0
    model.write_bdf(str(file), size=16, is_double=True)
    np.testing.assert_allclose(nastran_mass(file, parent=parent), whole, atol=1e-9 * np.abs(whole).max())


def test_a_deck_in_parts_is_the_whole_one(tmp_path: Path) -> None:
    written(tmp_path, frame())
    whole = load(tmp_path)
    lines = (tmp_path / "crane.bdf").read_text().splitlines()
    middle = next(i for i, line in enumerate(lines) if line.startswith("CBAR"))
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "rest.bdf").write_text("\n".join(lines[middle:]))
    (tmp_path / "crane.bdf").write_text("\n".join([*lines[:middle], "include 'parts/", "   rest.bdf'"]))
    assert np.array_equal(load(tmp_path).mass_matrix, whole.mass_matrix)


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "name", ["/etc/passwd", "../out.bdf", "link.bdf", "$HOME/x", "C:/x", "sub/../../out.bdf", "", "crane.bdf"]
)
def test_no_file_outside_the_folder_is_included(tmp_path: Path, name: str) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    (tmp_path / "out.bdf").write_text("GRID,77,,1.,0.,0.\n")
    (inside / "link.bdf").symlink_to(tmp_path / "out.bdf")
    (inside / "sub").mkdir()
    written(inside, frame())
    with (inside / "crane.bdf").open("a") as file:
        file.write(f"INCLUDE '{name}'\n")
    with pytest.raises(ValueError, match="INCLUDE must"):
        load(inside)


@pytest.mark.timeout(120)
def test_a_pipe_or_device_is_no_deck_and_no_result(tmp_path: Path) -> None:
    written(tmp_path, frame())
    os.mkfifo(tmp_path / "pipe")
    for file in (tmp_path / "pipe", Path("/dev/zero")):
        for pair in ((file, tmp_path / "crane.op2"), (tmp_path / "crane.bdf", file)):
            with pytest.raises(ValueError, match="not an ordinary file"):
                read_nastran(*pair, name="x", parent=("a", 1), ports={"e": 4})
    with (tmp_path / "crane.bdf").open("a") as deck:
        deck.write("INCLUDE 'pipe'\n")
    with pytest.raises(ValueError, match="not an ordinary file"):
        load(tmp_path)


pytest.importorskip("pyNastran", reason="extra nastran")


@pytest.mark.parametrize("weight", [0, 1, 3])
def test_import_agrees_with_the_frame_to_single_precision(tmp_path: Path, weight: int) -> None:
    written(tmp_path, frame(), weight=weight)
    same_body(load(tmp_path), to_modal_data(frame(), PARENT, ["e", "d"], KEEP), 2e-6)


def test_mass_comes_from_the_bulk_data_without_grid_point_weight(tmp_path: Path) -> None:
    """Lumped masses exactly (products of inertia with their sign), bars as slender rods without inertia about them."""
    for density, spin_inertia in ((1e-6, 1e-6), (2800.0, 2800.0 * (SECTION.Iy + SECTION.Iz) * 4.0)):
        written(tmp_path, frame(density), weight=None)
        expected = to_modal_data(frame(density), PARENT, ["e"], KEEP)
        np.testing.assert_allclose(load(tmp_path).mass_matrix, expected.mass_matrix, atol=spin_inertia)


def test_a_given_mass_matrix_replaces_that_of_the_files(tmp_path: Path) -> None:
    written(tmp_path, frame())
    known = load(tmp_path).mass_matrix
    np.testing.assert_array_equal(load(tmp_path, mass_matrix=1.5 * known).mass_matrix, 1.5 * known)
    with pytest.raises(ValueError, match="crane: residual mass"):
        load(tmp_path, mass_matrix=0.5 * known)


def test_files_without_required_results_or_content_are_named(tmp_path: Path) -> None:
    for missing, words in (("modes", "real eigenvectors"), ("forces", "forces of single-point constraint")):
        written(tmp_path, frame(), **{missing: False})
        with pytest.raises(ValueError, match=f"crane.op2: .*must contain {words}"):
            load(tmp_path)
    (tmp_path / "crane.bdf").write_text("this is no NASTRAN file\n")
    with pytest.raises(ValueError, match=r"crane\.bdf: BDF must be readable by pyNastran"):
        load(tmp_path)
    for name in ("crane.bdf", "crane.op2"):
        (tmp_path / name).unlink()
        with pytest.raises(FileNotFoundError, match=name):
            load(tmp_path)
        written(tmp_path, frame())
