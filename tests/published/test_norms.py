"""Norms with published digits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from lftkit.analysis.norms import hinf_norm


@pytest.mark.parametrize("certificate", ["interval", "hamiltonian"])
def test_ab13dd_example(certificate: str) -> None:
    """SLICOT AB13DD, example: three modes w^2 = 0.5, 1, 2; norm 0.5000000001E+06 at 1.414213562."""
    modes = [[[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]]]
    A = scipy.linalg.block_diag(*modes)
    B, C = np.array([[1.0], [0], [1], [0], [1], [0]]), np.array([[1.0, 0, 1, 0, 1, 0]])
    norm = hinf_norm(A, B, C, [[0.0]], rtol=1e-9, certificate=certificate)
    assert f"{norm.value / 1e6:.10f}" == "0.5000000001"
    assert f"{norm.omega:.9f}" == "1.414213562"
    assert norm.certificate == certificate
    assert norm.upper <= norm.value * (1 + 1.0001e-9)
