"""Solutions from a Schur form against direct ones, for systems of mixed units."""

import numpy as np
import pytest

from lftkit.analysis.real_schur import RealSchur


@pytest.mark.parametrize("order", [1, 2, 7, 40])
def test_solutions_are_those_of_the_linear_equations(order: int) -> None:
    rng = np.random.default_rng(order)
    units = 10.0 ** rng.uniform(-6, 6, order)
    A = rng.standard_normal((order, order)) * units[:, None] / units
    points = np.exp(1j * rng.uniform(0.1, 3.0, 5)) * 4.0 * np.sqrt(order)
    forcing = (rng.standard_normal((order, 5)) + 1j * rng.standard_normal((order, 5))) * units[:, None]
    found = RealSchur.of(A).solve(points, forcing)
    for k, z in enumerate(points):
        left = (z * found[:, k] - A @ found[:, k] - forcing[:, k]) / units
        assert np.abs(left).max() < 1e-13 * order * np.abs(z) * np.abs(found[:, k] / units).max()


def test_eigenvalues_are_those_of_a_known_matrix() -> None:
    A = np.array([[0.5, 3.0, 1.0], [-3.0, 0.5, 2.0], [0.0, 0.0, 0.25]])
    assert np.sort_complex(RealSchur.of(A).eigenvalues) == pytest.approx([0.25, 0.5 - 3j, 0.5 + 3j])


def test_no_points_have_no_solutions() -> None:
    assert RealSchur.of(np.eye(3)).solve(np.zeros(0, complex), np.zeros((3, 0), complex)).shape == (3, 0)
