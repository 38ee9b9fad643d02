"""Output feedback that moves the poles of a plant away from the imaginary axis before a response is taken.

With ``u = F y + u'`` the closed loop of P and K is that of P_F and K - F, exactly. An open loop with undamped modes or
integrators has no response at its poles, and next to them the closed loop's is a difference of large numbers; P_F has
none of this, whether it is stable or not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices
from lftkit.synthesis.extended_plant import loop_inverse


def prefeedback(
    A: FloatArray,
    B2: FloatArray,
    C2: FloatArray,
    D22: FloatArray,
    *,
    undamped: float = 1e-4,
    sufficient: float = 2e-3,
    largest: int = 100,
    most: int = 12,
) -> FloatArray:
    """Static F (u, y) after which no pole is undamped; zero where none is, and where F cannot move it.

    Parameters
    ----------
    A, B2, C2, D22 : ndarray, shapes (n, n), (n, u), (y, n), (y, u)
    undamped, sufficient : float
        Damping ratios below which a pole counts as undamped, and which are enough for every pole.
    largest, most : int
        States up to which the poles are computed for every F; number of them for larger plants.
    """
    zero: FloatArray = np.zeros((B2.shape[1], len(C2)))
    if len(A) == 0 or zero.size == 0:
        return zero
    poles = linalg.eigvals(A)
    scale = float(np.median(np.abs(poles))) or 1.0
    best, most_damped = zero, _least_damping(poles, scale)
    if most_damped >= undamped:
        return zero
    rng = np.random.default_rng(0)
    shifted = A - (scale + float(np.abs(poles.real).max())) * np.eye(len(A))
    gain = max(float(np.abs(C2 @ linalg.solve(shifted, B2)).max()) + float(np.abs(D22).max(initial=0.0)), 1e-300)
    random = [rng.standard_normal(zero.shape) for _ in range(4)]
    sizes = np.geomspace(1e-6, 1e6, 25)
    tried = [[sign * d * size / gain for d in random for sign in (1.0, -1.0)] for size in sizes]
    if len(A) > largest:
        tried = [[F] for F in _promising(A, B2, C2, [F for of_size in tried for F in of_size], scale)[:most]]
    for of_size in tried:
        for F in of_size:
            inner = np.eye(len(F)) - F @ D22
            values = linalg.svdvals(inner)
            if values[0] > 1e3 * values[-1]:
                continue
            damping = _least_damping(linalg.eigvals(A + B2 @ linalg.solve(inner, F @ C2)), scale)
            if damping > most_damped:
                best, most_damped = F, damping
        if most_damped > sufficient:
            break
    return best


def _promising(
    A: FloatArray, B2: FloatArray, C2: FloatArray, tried: list[FloatArray], scale: float
) -> list[FloatArray]:
    """The matrices F by how much they damp the poles as far as the first derivatives of the poles say, best first."""
    solved: Any = linalg.eig(A, left=True, right=True)  # the stubs say two results
    poles, left, right = solved
    product = np.sum(left.conj() * right, axis=0)
    # the left and right eigenvectors of a defective pole are orthogonal
    rows = (left.conj() / np.where(np.abs(product) < 1e-10, 1e-10, product)).T @ B2
    size, moved = np.maximum(np.abs(poles), 1e-6 * scale), []
    for F in tried:
        change = np.sum((rows @ F) * (C2 @ right).T, axis=1)
        far = np.count_nonzero(np.abs(change) > 0.5 * size)  # for which a first derivative says little
        moved.append(_least_damping(poles + change, scale) if far <= 0.1 * len(poles) else -1.0)
    return [tried[k] for k in np.argsort(-np.array(moved), kind="stable")]


def _least_damping(poles: Any, scale: float) -> float:
    size = np.maximum(np.abs(poles), 1e-6 * scale)
    return float((np.abs(poles.real) / size).min())


def applied(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, nz: int, nw: int, F: FloatArray) -> Matrices:
    """The plant (w, u') -> (z, y) after ``u = F y + u'``; `nz` and `nw` are the sizes of z and w."""
    if not F.any():
        return A, B, C, D
    B2, C2, D12, D21, D22 = B[:, nw:], C[nz:], D[:nz, nw:], D[nz:, :nw], D[nz:, nw:]
    inner = loop_inverse(np.eye(len(F)) - F @ D22)
    FC, FD, through = inner @ F @ C2, inner @ F @ D21, inner
    into: FloatArray = np.vstack([D12, D22])
    return (
        A + B2 @ FC,
        np.hstack([B[:, :nw] + B2 @ FD, B2 @ through]),
        C + into @ FC,
        np.hstack([D[:, :nw] + into @ FD, into @ through]),
    )
