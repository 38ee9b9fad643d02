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

UNDAMPED = 1e-4  # damping ratio below which a pole counts as undamped
SUFFICIENT = 2e-3  # damping ratio that is enough for every pole
SIZES = np.geomspace(1e-6, 1e6, 25)  # of F, relative to 1 / gain of the plant
DIRECTIONS = 4
MAX_CONDITION = 1e3  # of I - F D22
MAX_ORDER, MAX_TRIED = 100, 12  # of a plant whose poles are computed for every F; number of them for larger ones
LEAST_PRODUCT = 1e-10  # of left and right eigenvectors of unit length: those of a defective pole have none


def prefeedback(A: FloatArray, B2: FloatArray, C2: FloatArray, D22: FloatArray) -> FloatArray:
    """Static F (u, y) after which no pole is undamped; zero where none is, and where F cannot move it.

    Shapes (n, n), (n, u), (y, n), (y, u).
    """
    zero: FloatArray = np.zeros((B2.shape[1], len(C2)))
    if len(A) == 0 or zero.size == 0:
        return zero
    poles = linalg.eigvals(A)
    scale = float(np.median(np.abs(poles))) or 1.0
    best, most_damped = zero, _least_damping(poles, scale)
    if most_damped >= UNDAMPED:
        return zero
    rng = np.random.default_rng(0)
    shifted = A - (scale + float(np.abs(poles.real).max())) * np.eye(len(A))
    gain = max(float(np.abs(C2 @ linalg.solve(shifted, B2)).max()) + float(np.abs(D22).max(initial=0.0)), 1e-300)
    directions = [rng.standard_normal(zero.shape) for _ in range(DIRECTIONS)]
    tried = [[sign * d * size / gain for d in directions for sign in (1.0, -1.0)] for size in SIZES]
    if len(A) > MAX_ORDER:
        tried = [[F] for F in _promising(A, B2, C2, [F for of_size in tried for F in of_size], scale)]
    for of_size in tried:
        for F in of_size:
            inner = np.eye(len(F)) - F @ D22
            values = linalg.svdvals(inner)
            if values[0] > MAX_CONDITION * values[-1]:
                continue
            damping = _least_damping(linalg.eigvals(A + B2 @ linalg.solve(inner, F @ C2)), scale)
            if damping > most_damped:
                best, most_damped = F, damping
        if most_damped > SUFFICIENT:
            break
    return best


def _promising(
    A: FloatArray, B2: FloatArray, C2: FloatArray, tried: list[FloatArray], scale: float
) -> list[FloatArray]:
    """The matrices F that damp the poles most as far as the first derivatives of the poles say."""
    solved: Any = linalg.eig(A, left=True, right=True)  # the stubs say two results
    poles, left, right = solved
    product = np.sum(left.conj() * right, axis=0)
    rows = (left.conj() / np.where(np.abs(product) < LEAST_PRODUCT, LEAST_PRODUCT, product)).T @ B2
    size, moved = np.maximum(np.abs(poles), 1e-6 * scale), []
    for F in tried:
        change = np.sum((rows @ F) * (C2 @ right).T, axis=1)
        far = np.count_nonzero(np.abs(change) > 0.5 * size)  # for which a first derivative says little
        moved.append(_least_damping(poles + change, scale) if far <= 0.1 * len(poles) else -1.0)
    return [tried[k] for k in np.argsort(-np.array(moved), kind="stable")[:MAX_TRIED]]


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
