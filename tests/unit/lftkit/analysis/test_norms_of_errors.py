"""Norms of small differences of large systems: where modal terms cancel, the Hamiltonian matrix loses a peak."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import System, balred, hinf_norm


def plant(seed: int) -> System:
    """A stable system with a slow pole, whose gain is some thousand times the error of its reduction."""
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(4, 11)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    A -= (float(np.linalg.eigvals(A).real.max()) + 10 ** rng.uniform(-3.0, 0.5)) * np.eye(n)
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return System(A, B, C, np.zeros((p, m)), [("u", m)], [("y", p)])


@pytest.mark.parametrize(
    ("seed", "order"), [(66, 8), (66, 7), (83, 7), (104, 6), (111, 4), (194, 7), (260, 7), (0, 2), (1, 2), (2, 2)]
)
def test_the_error_of_a_reduction_exceeds_its_bound_nowhere(seed: int, order: int) -> None:
    """The two ways to a norm agree, and so does the response on a grid, to its own rounding.

    The first seven were up to 0.4 % above the level that the Hamiltonian matrix said is exceeded nowhere.
    """
    given = plant(seed)
    found = balred(given, order)
    error = given - found.system
    norm = hinf_norm(*error.matrices)
    covered = hinf_norm(*error.matrices, certificate="interval")
    assert covered.value <= norm.upper * (1.0 + 1e-9) and norm.value <= covered.upper * (1.0 + 1e-9)
    size = hinf_norm(*given.matrices).value
    for omega in np.geomspace(1e-3, 1e3, 300):
        gain = float(np.linalg.norm(np.atleast_2d(error(1j * omega)).reshape(error.D.shape), 2))
        assert gain <= found.error_bound * (1.0 + 1e-9) + 1e-12 * size
