"""Norms with published digits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from lftkit.analysis.norms import h2_norm, hinf_norm


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


def test_scherer_example_7_h2() -> None:
    """Scherer, Gahinet and Chilali 1997, example 7: the H2-optimal closed loop has norm 7.748350599360575.

    The controller is the LQG one, here from two Riccati equations; D12 and D21 are as in the paper (1 and 2).
    """
    A = np.array([[0.0, 10, 2], [-1, 1, 0], [0, 2, -5]])
    B1, B2 = np.array([[1.0], [0], [1]]), np.array([[0.0], [1], [0]])
    C1, D12 = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0]]), np.array([[0.0], [0], [1]])
    C2, D21 = np.array([[0.0, 1, 0]]), np.array([[2.0]])
    X = scipy.linalg.solve_continuous_are(A, B2, C1.T @ C1, D12.T @ D12, s=C1.T @ D12)
    F = -np.linalg.solve(D12.T @ D12, B2.T @ X + D12.T @ C1)
    Y = scipy.linalg.solve_continuous_are(A.T, C2.T, B1 @ B1.T, D21 @ D21.T, s=B1 @ D21.T)
    L = -np.linalg.solve(D21 @ D21.T, C2 @ Y + D21 @ B1.T).T
    closed = np.block([[A, B2 @ F], [-L @ C2, A + B2 @ F + L @ C2]])
    B = np.vstack([B1, -L @ D21])
    C = np.hstack([C1, D12 @ F])
    assert h2_norm(closed, B, C, np.zeros((3, 1))) == pytest.approx(7.748350599360575, rel=1e-9)
