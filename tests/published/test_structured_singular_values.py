"""Published values of the structured singular value."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.proofs import check_mu, complex_block, full_block, mu, real_block


def test_four_scalars_whose_upper_bound_is_not_reached() -> None:
    """Packard and Doyle, Automatica 29 (1993), 71-109: the best scalings D give 1, mu itself is about 0.87."""
    g, b = 3.0 + np.sqrt(3.0), np.sqrt(3.0) - 1.0
    a, c, d, f = np.sqrt(2.0 / g), np.sqrt(1.0 / g), -np.sqrt(b / g), (1.0 + 1.0j) * np.sqrt(1.0 / (g * b))
    U = np.array([[a, 0.0], [c, c], [c, 1j * c], [d, f]])
    V = np.array([[0.0, a], [c, -c], [c, -1j * c], [-1j * f, -d]])
    np.testing.assert_allclose(U.conj().T @ U, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(V.conj().T @ V, np.eye(2), atol=1e-14)
    M, structure = U @ V.conj().T, [complex_block()] * 4
    bounds = mu(M, structure, rtol=1e-6, starts=30)
    assert bounds.upper == pytest.approx(1.0, abs=2e-6) and check_mu(M, structure, bounds.certificate) >= 1.0
    assert bounds.lower == pytest.approx(0.87, abs=0.005)
    scan = [_radius(M, phases) for phases in np.random.default_rng(0).uniform(-np.pi, np.pi, (20000, 4))]
    assert 0.85 < max(scan) <= bounds.lower * (1.0 + 1e-9), "mu is the largest spectral radius of M U"


def _radius(M: np.ndarray, phases: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(M * np.exp(1j * phases))).max())


@pytest.mark.parametrize(
    ("structure", "value"),
    [
        ([full_block(2)], np.sqrt(10.0)),
        ([complex_block(), complex_block()], 3.0),
        ([complex_block(2)], 1.0),
        ([real_block(2)], 1.0),
        ([real_block(), real_block()], 3.0),
    ],
)
def test_a_matrix_of_rank_one(structure: list, value: float) -> None:
    """M = [[2, 2], [-1, -1]]: norm, sum of the diagonal's magnitudes, spectral radius."""
    bounds = mu([[2.0, 2.0], [-1.0, -1.0]], structure, rtol=1e-7)
    assert bounds.lower == pytest.approx(value, rel=1e-6) and bounds.upper == pytest.approx(value, rel=1e-6)
