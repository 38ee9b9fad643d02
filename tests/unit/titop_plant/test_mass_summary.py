"""Mass properties of bodies and of the whole, beside those of the source; effective masses and their sum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from titop_plant.structures import (
    Beam,
    BeamFrame,
    LumpedMass,
    MassProperties,
    ModalData,
    from_inertia,
    mass_summary,
    to_modal_data,
)
from titop_plant.structures.beam_frame import assemble
from titop_plant.structures.sections import tube
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.load import difference_counts, difference_summary, differences, load_telescope
from titop_plant.telescope.summary import summarise

SECTION = tube({"E": 70e9, "G": 27e9, "density": 2700.0}, 0.08, 0.002)


def boom(n_modes: int | None = None, masses: tuple[LumpedMass, ...] = ()) -> ModalData:
    nodes = {"P": np.array([0.5, 0.0, 0.0]), "tip": np.array([2.5, 0.0, 0.0])}
    frame = BeamFrame("boom", nodes, (Beam("P", "tip", SECTION, elements=12),), masses)
    return to_modal_data(frame, "P", ["tip"], n_modes)


def test_shares_of_a_cantilever_are_the_closed_ones() -> None:
    """(integral of phi)^2 / (L integral of phi^2) = 4 sigma^2 / (beta L)^2 in bending (Blevins, table 8-1)."""
    beta, sigma = np.array([1.87510407, 4.69409113]), np.array([0.734095514, 1.018467319])
    found = mass_summary(boom(4))
    np.testing.assert_allclose(found.shares[:, 1:3].sum(axis=1), np.repeat(4 * sigma**2 / beta**2, 2), rtol=1e-4)
    assert found.low == ("x translation", "y translation", "z translation")
    assert any("got 80.1%" in one and "y translation" in one for one in found.findings)


def test_all_modes_have_all_but_the_clamped_mass() -> None:
    """With every mode of the frame the sum is the mass that couples the free nodes: (R'M)_f M_ff^-1 (M R)_f."""
    frame = BeamFrame(
        "boom", {"P": np.zeros(3), "tip": np.array([2.0, 0, 0])}, (Beam("P", "tip", SECTION, elements=6),)
    )
    _, M, _ = assemble(frame)
    found = mass_summary(to_modal_data(frame, "P", ["tip"]))
    across = (M @ np.tile(np.eye(6), 7).T)[6:, 1]
    mass = SECTION.density * SECTION.A * 2.0
    assert found.sums[1] == pytest.approx(across @ np.linalg.solve(M[6:, 6:], across) / mass, rel=1e-9)
    assert found.low == ()
    assert found.findings == ()


def test_the_source_is_compared_with_the_model() -> None:
    lump = LumpedMass("tip", 3.0, np.diag([0.1, 0.2, 0.3]), np.array([0.0, 0.1, 0.0]))
    body = boom(None, (lump,))
    assert mass_summary(body, body.mass_matrix).findings == ()
    found = mass_summary(body, 1.1 * body.mass_matrix).findings
    assert found[0].startswith("boom: mass [kg] should be that of the source within 2%, got ")
    assert not any("centre" in one for one in found)
    assert sum(f"inertia {axis}" in one for one in found for axis in ("xx", "yy", "zz")) == 3
    other = mass_summary(body, from_inertia(body.mass, np.eye(3), [1.0, 0.3, 0.0]))
    assert any("centre y" in one for one in other.findings)
    text = str(other)
    assert "| property | model | source | difference |" in text
    assert "| sum |" in text
    with pytest.raises(ValueError, match=r"mass_matrix must have shape \(6, 6\)"):
        mass_summary(body, np.eye(3))


def test_properties_do_not_depend_on_the_point_or_the_frame() -> None:
    """Parallel axes: the same body at another point; a rotation turns centre and inertia."""
    rng = np.random.default_rng(5)
    turn = Rotation.random(random_state=5).as_matrix()
    root = rng.normal(size=(3, 3))
    inertia, center = root @ root.T, rng.normal(size=3)
    for point in rng.normal(size=(5, 3)):
        found = MassProperties.of(from_inertia(2.5, inertia, center - point), point)
        turned = MassProperties.of(from_inertia(2.5, turn @ inertia @ turn.T, turn @ (center - point)), turn @ point)
        assert found.mass == pytest.approx(2.5)
        np.testing.assert_allclose(found.center, center, atol=1e-12)
        np.testing.assert_allclose(found.inertia, inertia, atol=1e-12)
        np.testing.assert_allclose(turned.center, turn @ center, atol=1e-12)
        np.testing.assert_allclose(turned.inertia, turn @ inertia @ turn.T, atol=1e-12)


SMALL = Path(__file__).parents[3] / "examples" / "spacecraft" / "small_telescope.toml"


@pytest.mark.parametrize("file", ["", str(SMALL)])
def test_the_mass_matrix_is_that_of_a_rigid_body(file: str) -> None:
    """Blocks of mass times position; inertia about the centre of mass by the parallel axis theorem."""
    telescope = load_telescope(file)
    found, matrix = summarise(telescope), assembled_telescope(telescope).rigid_mass
    m, c = found.mass, found.centre_of_mass
    cross = np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
    np.testing.assert_allclose(matrix[:3, :3], m * np.eye(3), atol=1e-7 * m)
    np.testing.assert_allclose(matrix[:3, 3:], m * cross.T, atol=1e-7 * m)
    about_centre = matrix[3:, 3:] - m * (c @ c * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(about_centre, found.total_inertia, rtol=1e-9, atol=1e-6 * np.trace(about_centre))


def test_differences_from_the_reference_are_counted_by_table(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        "base = 'reference'\n[isolator]\nmass = 2.0\n[fsm]\nauthority = 1e-3\nstiffness = 70.0\n", "utf-8"
    )
    assert difference_counts(tmp_path / "mine.toml") == {"isolator": (1, 0, 0), "fsm": (2, 0, 0)}
    assert difference_summary(tmp_path / "mine.toml", most=3) == differences(tmp_path / "mine.toml")
    assert difference_summary(tmp_path / "mine.toml", most=2) == [
        "differs from the reference in isolator (1 value changed), fsm (2 values changed)"
    ]
