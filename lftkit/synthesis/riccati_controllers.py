"""Controllers of two Riccati equations: LQG, sampled too, and the central H-infinity controller at a level.

The H-infinity controller is that of Doyle, Glover, Khargonekar and Francis (1989). A direct path from disturbance to
error is taken out first (Safonov, Limebeer and Chiang 1989): a static gain makes it as small as it can be (Parrott),
and the plant with the rest of it has the same controllers at this level as one without. **Sign: u = + K y.**
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import is_stable
from lftkit.analysis.riccati import riccati
from lftkit.arrays import FloatArray, Matrices
from lftkit.support.regular_solve import regular_solve
from lftkit.synthesis.extended_plant import ExtendedPlant
from lftkit.synthesis.settings import SETTINGS, SynthesisSettings


@dataclass(frozen=True)
class FullOrderEstimator:
    """Full-order controller ``x' = A x + B u - L y, u = F x + D y``."""

    A: FloatArray
    B: FloatArray
    L: FloatArray
    F: FloatArray
    D: FloatArray

    @property
    def gain_matrix(self) -> FloatArray:
        """The controller as one matrix, (states + commands, states + measurements)."""
        return np.block([[self.A + self.B @ self.F, self.B @ self.D - self.L], [self.F, self.D]])


def lqg(plant: ExtendedPlant) -> FullOrderEstimator | None:
    """Controller with the least H2 norm, D11 left out; None where an equation has no solution."""
    R, W = plant.D12.T @ plant.D12, plant.D21 @ plant.D21.T
    X = riccati(plant.A, plant.B2, plant.C1.T @ plant.C1, R, plant.C1.T @ plant.D12)
    Y = riccati(plant.A.T, plant.C2.T, plant.B1 @ plant.B1.T, W, plant.B1 @ plant.D21.T)
    if X is None or Y is None:
        return None
    try:
        F = -regular_solve(R, plant.B2.T @ X + plant.D12.T @ plant.C1)
        L = -regular_solve(W, plant.C2 @ Y + plant.D21 @ plant.B1.T).T
    except linalg.LinAlgError:
        return None
    D = np.zeros((len(F), L.shape[1]))
    return FullOrderEstimator(plant.A + L @ plant.C2, plant.B2 + L @ plant.D22, L, F, D)


def lowest_level(plant: ExtendedPlant, settings: SynthesisSettings = SETTINGS) -> tuple[float, float] | None:
    """Levels of the H-infinity norm without and with a controller, close to each other; None where none is found."""
    levels = (10.0**k for k in range(settings.decades))
    high = next((level for level in levels if central(plant, level, settings) is not None), None)
    if high is None:
        return None
    for _ in range(settings.decades):
        if central(plant, high / 10.0, settings) is None:
            break
        high /= 10.0
    else:
        return None
    low = high / 10.0
    for _ in range(settings.bisections):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if central(plant, middle, settings) is not None else (middle, high)
    return low, high


def central(plant: ExtendedPlant, level: float, settings: SynthesisSettings = SETTINGS) -> FullOrderEstimator | None:
    """Central controller at a level; None where the equations have no solution that is one."""
    try:
        return _central(plant, level, settings)
    except linalg.LinAlgError:  # at the least level the coupling of both solutions is singular
        return None


def _central(plant: ExtendedPlant, level: float, settings: SynthesisSettings) -> FullOrderEstimator | None:
    K = _parrott(plant, level, settings)
    shifted = None if K is None else _without_direct_path(_with_static_gain(plant, K), level)
    if K is None or shifted is None:
        return None
    A, B1, B2, C1, C2 = shifted.A, shifted.B1, shifted.B2, shifted.C1, shifted.C2
    nw, nz = B1.shape[1], len(C1)
    D1, D2 = np.hstack([np.zeros((nz, nw)), shifted.D12]), np.vstack([np.zeros((nz, nw)), shifted.D21])
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    R = D1.T @ D1 - linalg.block_diag(level**2 * np.eye(nw), np.zeros((B2.shape[1],) * 2))
    S = D2 @ D2.T - linalg.block_diag(level**2 * np.eye(nz), np.zeros((len(C2),) * 2))
    X, Y = riccati(A, B, C1.T @ C1, R, C1.T @ D1), riccati(A.T, C.T, B1 @ B1.T, S, B1 @ D2.T)
    if X is None or Y is None:
        return None
    F = -regular_solve(R, B.T @ X + D1.T @ C1)
    L = -regular_solve(S, C @ Y + D2 @ B1.T).T
    # X is positive semidefinite exactly where A + B2 F2 is stable: it solves a Lyapunov equation of this matrix, and a
    # mode of it that is not stable, with X >= 0, would be one of the closed loop. Y likewise; rounding hardly matters.
    if not (is_stable(A + B2 @ F[nw:]) and is_stable(A + L[:, nz:] @ C2)):
        return None
    product = X @ Y / level**2
    if float(np.abs(linalg.eigvals(product)).max(initial=0.0)) >= 1.0:
        return None
    ZL = regular_solve(np.eye(len(X)) - product.T, L[:, nz:])
    seen = C2 + shifted.D21 @ F[:nw]
    into = B2 + ZL @ shifted.D22
    return FullOrderEstimator(A + B1 @ F[:nw] + ZL @ seen, into, ZL + into @ K, F[nw:], K)


def _parrott(plant: ExtendedPlant, level: float, settings: SynthesisSettings) -> FloatArray | None:
    """Static gain with which the direct path from disturbance to error is below a level; None where there is none."""
    nu, ny = plant.D12.shape[1], len(plant.D21)
    U, sizes, V = linalg.svd(plant.D12)
    Q, widths, W = linalg.svd(plant.D21)
    D = np.vstack([U[:, nu:].T, U[:, :nu].T]) @ plant.D11 @ np.hstack([W[ny:].T, W[:ny].T])
    z, w = len(D) - nu, D.shape[1] - ny
    a, b, c, d = D[:z, :w], D[:z, w:], D[z:, :w], D[z:, w:]
    if max(_gain(D[:z]), _gain(D[:, :w])) >= level:
        return None
    inner = -c @ regular_solve(level**2 * np.eye(w) - a.T @ a, a.T @ b) if z and w else np.zeros_like(d)
    gain = V.T @ ((inner - d) / sizes[:, None] / widths) @ Q.T
    for part in settings.shares:  # the central gain may make the loop with D22 singular
        scaled = part * gain
        loop = np.eye(ny) + plant.D22 @ scaled
        if part == 1.0 or _gain(plant.D11 + plant.D12 @ scaled @ plant.D21) < level:
            sizes = linalg.svdvals(loop)
            if sizes[-1] > settings.well_posed * sizes[0]:
                return np.asarray(scaled @ _inverse(loop))  # of what the commands add to y
    return None


def _inverse(matrix: FloatArray) -> FloatArray:
    return regular_solve(matrix, np.eye(len(matrix)))


def _inverse_root(matrix: FloatArray) -> FloatArray:
    """Inverse of the square root of a positive definite matrix."""
    values, vectors = linalg.eigh(matrix)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _gain(matrix: FloatArray) -> float:
    return float(linalg.norm(matrix, 2)) if matrix.size else 0.0


def _with_static_gain(plant: ExtendedPlant, K: FloatArray) -> ExtendedPlant:
    """The plant behind ``u = K y + v``, with v as command."""
    closed = plant.closed(K)
    inner = _inverse(np.eye(len(K)) - K @ plant.D22)
    return ExtendedPlant(
        closed.A,
        closed.B,
        closed.left,
        closed.C,
        closed.right,
        closed.D,
        closed.left_z,
        closed.right_w,
        plant.D22 @ inner,
    )


def _without_direct_path(plant: ExtendedPlant, level: float) -> ExtendedPlant | None:
    """A plant without D11 whose controllers at this level are the same; None where D11 is not below it."""
    D = plant.D11 / level
    if _gain(D) >= 1.0:
        return None
    left, right = np.eye(len(D)) - D @ D.T, np.eye(D.shape[1]) - D.T @ D
    through = D.T @ _inverse(left) / level
    root_left, root_right = (_inverse_root(M) for M in (left, right))
    return ExtendedPlant(
        plant.A + plant.B1 @ through @ plant.C1,
        plant.B1 @ root_right,
        plant.B2 + plant.B1 @ through @ plant.D12,
        root_left @ plant.C1,
        plant.C2 + plant.D21 @ through @ plant.C1,
        np.zeros_like(D),
        root_left @ plant.D12,
        plant.D21 @ root_right,
        plant.D22 + plant.D21 @ through @ plant.D12,
    )


def sampled_lqg(plant: ExtendedPlant, *, direct: bool = True) -> tuple[Matrices, float]:
    """Controller (A, B, C, D) of the least H2 norm of a sampled plant, and that norm.

    With the stabilising solutions X and Y of both discrete Riccati equations the variance that a controller makes is ::

        trace(D11' D11 + B1' X B1) + trace(R F Y F') - trace(R G S G'),
        R = D12' D12 + B2' X B2, S = D21 D21' + C2 Y C2', G = (F Y C2' + F0 D21') S^-1,

    where ``u = F x + F0 w`` were the best command, and G is the gain from the innovation of a sample to the command. A
    controller without a direct path lacks the last term (Chen and Francis, Optimal Sampled-Data Control Systems, 1995,
    chapter 6). No term needs a weight of commands or noise of measurements where R and S are positive definite without.

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
            A, B1, B2, C1, C2, D11, D12, D21, D22 = (
                getattr(plant, name) for name in ("A", "B1", "B2", "C1", "C2", "D11", "D12", "D21", "D22")
            )
            X = linalg.solve_discrete_are(A, B2, C1.T @ C1, D12.T @ D12, s=C1.T @ D12)
            Y = linalg.solve_discrete_are(A.T, C2.T, B1 @ B1.T, D21 @ D21.T, s=B1 @ D21.T)
            R, S = D12.T @ D12 + B2.T @ X @ B2, D21 @ D21.T + C2 @ Y @ C2.T
            F, F0 = (-linalg.solve(R, B2.T @ X @ M + D12.T @ N, assume_a="pos") for M, N in ((A, C1), (B1, D11)))
            K, G = (
                linalg.solve(S, M.T, assume_a="pos").T for M in (A @ Y @ C2.T + B1 @ D21.T, F @ Y @ C2.T + F0 @ D21.T)
            )
            if not direct:
                G = np.zeros_like(G)
            variance = float(
                np.trace(D11.T @ D11 + B1.T @ X @ B1) + np.trace(R @ F @ Y @ F.T) - np.trace(R @ G @ S @ G.T)
            )
            inner = linalg.inv(np.eye(len(F)) + G @ D22)
            C, D = inner @ (F - G @ C2), inner @ G
            into = B2 - K @ D22
            return (A - K @ C2 + into @ C, K + into @ D, C, D), float(np.sqrt(max(variance, 0.0)))
        except linalg.LinAlgWarning as error:
            raise linalg.LinAlgError(str(error)) from None
