"""Smallest full-order H-infinity norm by Riccati equations: a lower bound for every controller of any order.

Zhou, Doyle and Glover 1996, theorem 17.1 (general D11), existence conditions only; written for the tests, shares
nothing with the tuner.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from lftkit.systems.system import System


def full_order_bound(plant: System, rtol: float = 1e-6) -> float:
    """Infimum over all controllers of the norm w -> z; needs D12 of full column and D21 of full row rank."""
    A = plant.A
    w, u = plant.input_indices(["w"]), plant.input_indices(["u"])
    z, y = plant.output_indices(["z"]), plant.output_indices(["y"])
    B, C, D = plant.B[:, np.r_[w, u]], plant.C[np.r_[z, y]], plant.D[np.ix_(np.r_[z, y], np.r_[w, u])]
    nw, nz = len(w), len(z)
    low, high = 0.0, 1.0
    while not _reachable(A, B, C, D, nw, nz, high):
        low, high = high, 2.0 * high
    while high - low > rtol * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _reachable(A, B, C, D, nw, nz, middle) else (middle, high)
    return low


def _reachable(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, nw: int, nz: int, g: float) -> bool:
    D1, D_1 = D[:nz], D[:, :nw]
    D12, D21, D11 = D[:nz, nw:], D[nz:, :nw], D[:nz, :nw]
    off_12 = np.eye(nz) - D12 @ np.linalg.pinv(D12)
    off_21 = np.eye(nw) - np.linalg.pinv(D21) @ D21
    if g <= max(np.linalg.norm(off_12 @ D11, 2), np.linalg.norm(D11 @ off_21, 2)):
        return False
    R = D1.T @ D1 - scipy.linalg.block_diag(g * g * np.eye(nw), np.zeros((D.shape[1] - nw,) * 2))
    S = D_1 @ D_1.T - scipy.linalg.block_diag(g * g * np.eye(nz), np.zeros((D.shape[0] - nz,) * 2))
    X = _stabilising(A, B, C[:nz], D1, R)
    Y = _stabilising(A.T, C.T, B[:, :nw].T, D_1.T, S)
    if X is None or Y is None:
        return False
    return bool(np.abs(np.linalg.eigvals(X @ Y)).max() < g * g)


def _stabilising(A: np.ndarray, B: np.ndarray, C1: np.ndarray, D1: np.ndarray, R: np.ndarray) -> np.ndarray | None:
    """Positive semidefinite stabilising solution for the Hamiltonian of the theorem, or None."""
    n = len(A)
    try:
        inner = np.linalg.solve(R, np.hstack([D1.T @ C1, B.T]))
    except np.linalg.LinAlgError:
        return None
    H = np.block([[A, np.zeros((n, n))], [-C1.T @ C1, -A.T]]) - np.vstack([B, -C1.T @ D1]) @ inner
    values = np.linalg.eigvals(H)
    if np.abs(values.real).min() < 1e-9 * np.abs(values).max():
        return None
    _, Z, stable = scipy.linalg.schur(H, sort="lhp")
    if stable != n or np.linalg.cond(Z[:n, :n]) > 1e13:
        return None
    X = Z[n:, :n] @ np.linalg.inv(Z[:n, :n])
    X = 0.5 * (X + X.T)
    return X if np.linalg.eigvalsh(X).min() >= -1e-7 * max(1.0, np.abs(X).max()) else None
