"""Hankel singular values that are printed."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import System, balred, hankel_singular_values, hinf_norm


def test_the_example_of_slicot() -> None:
    """SLICOT, documentation of AB09AD, program results: seven states, of which five are kept."""
    A = [
        [-0.04165, 0.0, 4.92, -4.92, 0.0, 0.0, 0.0],
        [-5.21, -12.5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 3.33, -3.33, 0.0, 0.0, 0.0, 0.0],
        [0.545, 0.0, 0.0, 0.0, -0.545, 0.0, 0.0],
        [0.0, 0.0, 0.0, 4.92, -0.04165, 0.0, 4.92],
        [0.0, 0.0, 0.0, 0.0, -5.21, -12.5, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 3.33, -3.33],
    ]
    B = np.zeros((7, 2))
    B[1, 0] = B[5, 1] = 12.5
    given = System(A, B, np.eye(7)[[0, 3, 4]], np.zeros((3, 2)), [("u", 2)], [("y", 3)])
    values = hankel_singular_values(given)
    assert values == pytest.approx([2.5139, 2.0846, 1.9178, 0.7666, 0.5473, 0.0253, 0.0246], abs=5e-5)
    found = balred(given, 5)
    assert found.tail_bound == pytest.approx(2.0 * (0.0253 + 0.0246), abs=2e-4)
    assert found.error_bound == pytest.approx(hinf_norm(*(given - found.system).matrices).value, rel=1e-6)
    assert 2.0 * values[5] <= found.error_bound * (1.0 + 1e-6)  # what any five states lose is at least the next value
