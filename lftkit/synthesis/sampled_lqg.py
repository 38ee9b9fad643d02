"""LQG controllers of sampled plants, with the measurement of the same sample or without it.

With the stabilising solutions X and Y of both discrete Riccati equations the variance that a controller makes is ::

    trace(D11' D11 + B1' X B1) + trace(R F Y F') - trace(R G S G'),
    R = D12' D12 + B2' X B2, S = D21 D21' + C2 Y C2', G = (F Y C2' + F0 D21') S^-1,

where ``u = F x + F0 w`` were the best command, and G is the gain from the innovation of a sample to the command. A
controller without a direct path lacks the last term (Chen and Francis, Optimal Sampled-Data Control Systems, 1995,
chapter 6). No term needs a weight of commands or noise of measurements where R and S are positive definite without.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy import linalg

from lftkit.arrays import Matrices
from lftkit.synthesis.extended_plant import ExtendedPlant


def sampled_lqg(plant: ExtendedPlant, *, direct: bool = True) -> tuple[Matrices, float]:
    """Controller (A, B, C, D) of the least H2 norm of a sampled plant, and that norm.

    The norm is the root of the variance of the error for white noise of variance 1 per sample.

    Parameters
    ----------
    plant : ExtendedPlant
        ``x+ = A x + B1 w + B2 u``.
    direct : bool
        With a direct path from the measurement to the command.

    Raises
    ------
    ValueError, ArithmeticError, LinAlgError
        An equation has no stabilising solution; R or S is singular.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return _sampled_lqg(plant, direct)
        except linalg.LinAlgWarning as error:
            raise linalg.LinAlgError(str(error)) from None


def _sampled_lqg(plant: ExtendedPlant, direct: bool) -> tuple[Matrices, float]:
    A, B1, B2, C1, C2, D11, D12, D21, D22 = (
        getattr(plant, name) for name in ("A", "B1", "B2", "C1", "C2", "D11", "D12", "D21", "D22")
    )
    X = linalg.solve_discrete_are(A, B2, C1.T @ C1, D12.T @ D12, s=C1.T @ D12)
    Y = linalg.solve_discrete_are(A.T, C2.T, B1 @ B1.T, D21 @ D21.T, s=B1 @ D21.T)
    R, S = D12.T @ D12 + B2.T @ X @ B2, D21 @ D21.T + C2 @ Y @ C2.T
    F, F0 = (-linalg.solve(R, B2.T @ X @ M + D12.T @ N, assume_a="pos") for M, N in ((A, C1), (B1, D11)))
    K, G = (linalg.solve(S, M.T, assume_a="pos").T for M in (A @ Y @ C2.T + B1 @ D21.T, F @ Y @ C2.T + F0 @ D21.T))
    if not direct:
        G = np.zeros_like(G)
    variance = float(np.trace(D11.T @ D11 + B1.T @ X @ B1) + np.trace(R @ F @ Y @ F.T) - np.trace(R @ G @ S @ G.T))
    inner = linalg.inv(np.eye(len(F)) + G @ D22)
    C, D = inner @ (F - G @ C2), inner @ G
    into = B2 - K @ D22
    return (A - K @ C2 + into @ C, K + into @ D, C, D), float(np.sqrt(max(variance, 0.0)))
