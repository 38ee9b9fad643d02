"""Mass, centre of mass and inertia of the whole from its low-frequency response, against sums over its parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.load import difference_counts, difference_summary, differences, load_telescope
from titop_plant.telescope.summary import summarise

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
    (tmp_path / "mine.toml").write_text("[isolator]\nmass = 2.0\n[fsm]\nauthority = 1e-3\nstiffness = 70.0\n", "utf-8")
    assert difference_counts(tmp_path / "mine.toml") == {"isolator": (1, 0, 0), "fsm": (2, 0, 0)}
    assert difference_summary(tmp_path / "mine.toml", most=3) == differences(tmp_path / "mine.toml")
    assert difference_summary(tmp_path / "mine.toml", most=2) == [
        "differs from the reference in isolator (1 value changed), fsm (2 values changed)"
    ]
