"""State-space side of a closed loop as a function of the gain matrix: poles and H2 norms with exact gradients.

A controller of order n_K is a static gain for the plant extended by n_K integrators: with the gain matrix
``K = [[A_K, B_K], [C_K, D_K]]`` the closed loop is affine in ``K (I - D22 K)^-1`` and every derivative is a product.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import balanced
from lftkit.analysis.norms import schur_lyapunov
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.synthesis.extended_plant import ClosedLoopMatrices, ExtendedPlant
from lftkit.systems.connection.feedback import cascade
from lftkit.systems.delay import pade_delay
from lftkit.systems.system import System
from lftkit.tuning.requirements import H2Gain, HinfGain


def extended_plant(
    model: System,
    measurements: tuple[str, ...],
    commands: tuple[str, ...],
    controller_order: int,
    asked: HinfGain | H2Gain | None = None,
    *,
    loop_delay: float = 0.0,
    pade_order: int = 6,
) -> ExtendedPlant:
    """Extend `model`, with the ports, weights and bound of the gain that is asked for and a Padé delay on the commands.

    **Sign: u = + K y.** Performance outputs are over the bound; without a gain there are none.
    """
    inputs, outputs = (asked.inputs, asked.outputs) if asked else ((), ())
    weight_in, weight_out = (asked.weight_in, asked.weight_out) if asked else (None, None)
    scale = 1.0 / asked.bound if asked else 1.0
    cw, cu = model.input_indices(inputs), model.input_indices(commands)
    rz, ry = model.output_indices(outputs), model.output_indices(measurements)
    A, B, C, D = (
        model.A,
        model.B[:, np.r_[cw, cu]],
        model.C[np.r_[rz, ry]],
        model.D[np.ix_(np.r_[rz, ry], np.r_[cw, cu])],
    )
    nw, nu, nz, ny = len(cw), len(cu), len(rz), len(ry)
    before = [_or_unit(weight_in, nw), pade_delay(loop_delay, pade_order, nu)]
    after = [_or_unit(weight_out, nz), _or_unit(None, ny)]
    core = System(A, B, C, D, (("w", nw + nu),), (("z", nz + ny),))  # type: ignore[arg-type]
    whole = cascade(cascade(_stacked(before), core), _stacked(after))
    A, B, C = balanced(whole.A, whole.B, whole.C)
    nw, nz = before[0].D.shape[1], after[0].D.shape[0]
    k = controller_order
    n = whole.order
    return ExtendedPlant(
        linalg.block_diag(A, np.zeros((k, k))),
        np.vstack([B[:, :nw], np.zeros((k, nw))]),
        np.block([[np.zeros((n, k)), B[:, nw:]], [np.eye(k), np.zeros((k, nu))]]),
        scale * np.hstack([C[:nz], np.zeros((nz, k))]),
        np.block([[np.zeros((k, n)), np.eye(k)], [C[nz:], np.zeros((ny, k))]]),
        scale * whole.D[:nz, :nw],
        scale * np.hstack([np.zeros((nz, k)), whole.D[:nz, nw:]]),
        np.vstack([np.zeros((k, nw)), whole.D[nz:, :nw]]),
        linalg.block_diag(np.zeros((k, k)), whole.D[nz:, nw:]),
    )


@dataclass(frozen=True)
class LoopSpectrum:
    """Poles of a closed loop with the factors of their derivatives.

    Parameters
    ----------
    poles : ndarray, shape (n,), complex
    abscissa : float
        Largest real part [rad/s]; infinite, without poles, where the loop has no solution.
    rows, columns : ndarray, shapes (n_K + u, n) and (n_K + y, n), or None
        ``ds_i = sum(outer(rows[:, i], columns[:, i]) * dK)``; None where derivatives were not asked for.
    """

    poles: ComplexArray
    abscissa: float
    rows: ComplexArray | None = None
    columns: ComplexArray | None = None

    def gradient(self, i: int) -> ComplexArray:
        """Derivative of pole i with respect to the gain matrix."""
        if self.rows is None or self.columns is None:
            raise InputError("this spectrum was computed without derivatives")
        return np.asarray(np.outer(self.rows[:, i], self.columns[:, i]))

    def barriers(self, max_poles: int = 6) -> list[tuple[float, FloatArray]]:
        """Real parts of the poles that a small change of K brings to the axis soonest, with real gradients."""
        if self.rows is None or self.columns is None:
            return []
        reach = np.asarray(linalg.norm(self.rows, axis=0)) * np.asarray(linalg.norm(self.columns, axis=0))
        reach[self.poles.imag < 0] = 0.0
        order = np.argsort(self.poles.real / np.maximum(reach, 1e-300))[::-1][:max_poles]
        return [(float(self.poles[i].real), np.real(self.gradient(int(i)))) for i in order if reach[i] > 0]


def spectrum(loop: ClosedLoopMatrices, *, derivatives: bool) -> LoopSpectrum:
    """Poles of the closed loop, with derivatives if asked for; the abscissa is the same either way, bit for bit.

    Eigenvalues that come with eigenvectors differ by rounding from those that come alone: near the limit a loop would
    be stable by one and unstable by the other. Those alone decide; the others are shifted to their abscissa.
    """
    alone = np.asarray(linalg.eigvals(loop.A, check_finite=False), dtype=complex)
    abscissa = float(alone.real.max(initial=-np.inf))
    if not derivatives:
        return LoopSpectrum(alone, abscissa)
    values, left, right = eigenvectors(loop.A)
    shift = abscissa - float(values.real.max()) if len(values) else 0.0
    poles = np.minimum(values.real + shift, abscissa) + 1j * values.imag
    scale = np.sum(left.conj() * right, axis=0)
    # a defective pole has no derivative; a large finite one still points downhill
    scale = np.where(np.abs(scale) < 1e-14, 1e-14, scale)
    rows, columns = loop.left.T @ left.conj() / scale, np.asarray(loop.right @ right)
    return LoopSpectrum(np.asarray(poles, dtype=complex), abscissa, rows, columns)


def eigenvectors(A: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Eigenvalues (n,), left and right eigenvectors of unit length (n, n) of a matrix (n, n)."""
    solved: Any = linalg.eig(A, left=True, right=True, check_finite=False)  # the stubs say two results
    return cast("tuple[ComplexArray, ComplexArray, ComplexArray]", solved)


def h2_value(loop: ClosedLoopMatrices, need_gradient: bool) -> tuple[float, FloatArray | None]:
    """H2 norm of a stable closed loop with D = 0, and its gradient with respect to the gain matrix.

    With P and X the controllability and observability Gramians, ``d trace(C P C') = 2 <X P, dA> + 2 <X B, dB> +
    2 <C P, dC>``.
    """
    T, Q = linalg.schur(loop.A, output="real", check_finite=False)
    b, c = Q.T @ loop.B, loop.C @ Q
    P = schur_lyapunov(T, b @ b.T, transposed=False)
    square = max(float(np.sum((c @ P) * c)), 0.0)
    value = float(np.sqrt(square))
    if not need_gradient:
        return value, None
    X = schur_lyapunov(T, c.T @ c, transposed=True)
    left, right = loop.left.T @ Q, loop.right @ Q
    gradient = left @ (X @ P) @ right.T + left @ (X @ b) @ loop.right_w.T + loop.left_z.T @ (c @ P) @ right.T
    return value, gradient / max(value, 1e-300)


def _or_unit(weight: System | None, size: int) -> System:
    if weight is not None:
        return weight
    return System(
        np.zeros((0, 0)),
        np.zeros((0, size)),
        np.zeros((size, 0)),
        np.eye(size),
        (("in", size),) if size else (),  # type: ignore[arg-type]
        (("out", size),) if size else (),  # type: ignore[arg-type]
    )


def _stacked(parts: list[System]) -> System:
    A, B, C, D = (linalg.block_diag(*(p.matrices[i] for p in parts)) for i in range(4))
    n = sum(p.order for p in parts)
    m, r = sum(p.D.shape[1] for p in parts), sum(p.D.shape[0] for p in parts)
    A, B, C, D = A.reshape(n, n), B.reshape(n, m), C.reshape(r, n), D.reshape(r, m)
    return System(A, B, C, D, (("in", m),), (("out", r),))  # type: ignore[arg-type]
