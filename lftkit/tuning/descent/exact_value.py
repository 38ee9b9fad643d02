"""Largest value of a problem of few states and its gradient, exact and cheap: peaks in modal form, no grid.

One evaluation of a loop of ten states takes about half a millisecond. A peak that hides between the frequencies tried
is missed; what decides in the end are the values of :class:`lftkit.tuning.problem.Problem` and the certificate.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS, complex_columns, complex_rows
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.peak_search import climb
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.synthesis.extended_plant import ClosedLoopMatrices, ExtendedPlant
from lftkit.tuning.gains.algebraic_loop import WellPosedness
from lftkit.tuning.gains.loop import extended_plant
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.requirements.sector import SectorGain

MAX_ORDER = 40  # of the closed loop: above it the grid of the smooth phase is cheaper
RIVAL, MAX_RIVALS = 0.9, 3  # peaks of the frequencies tried above this fraction of the largest gain are refined
PEAK_TOLERANCE = 1e-9
OUTSIDE = np.inf


class ExactValue:
    """Logarithm of the largest H-infinity gain over requirements and models, with gradient; infinite where unstable.

    Parameters
    ----------
    problem : Problem
        Must pass :meth:`suits`.
    """

    def __init__(self, problem: Problem) -> None:
        self._structure, self._limit, self._inside = problem.structure, -problem.min_decay, problem.inside
        self.evaluations = 0
        measured = tuple(p.name for p in problem.structure.inputs)
        commanded = tuple(p.name for p in problem.structure.outputs)
        self._plants: list[ExtendedPlant] = []
        for model in problem.models:
            for r in problem.given:
                assert isinstance(r, HinfGain)
                self._plants.append(extended_plant(model, measured, commanded, problem.structure.order, r))
        self._peaks: list[FloatArray] = [np.zeros(0) for _ in self._plants]

    @staticmethod
    def suits(problem: Problem) -> bool:
        """Whether all requirements are soft H-infinity gains, there is no delay, and every loop is small."""
        asked = [r for r in problem.requirements if not isinstance(r, WellPosedness)]
        gains = all(isinstance(r, HinfGain) and not (r.hard or r.banded or isinstance(r, SectorGain)) for r in asked)
        if not gains or problem.loop_delay or len(problem.models) * len(asked) > 4:
            return False
        weights = [w for r in problem.given if isinstance(r, HinfGain) for w in (r.weight_in, r.weight_out) if w]
        extra = max((w.order for w in weights), default=0) * 2
        return all(0 < problem.order(k) <= MAX_ORDER - extra for k in range(len(problem.models)))

    def __call__(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient (size,); infinite and zero outside the domain."""
        self.evaluations += 1
        if not self._inside(x):
            return OUTSIDE, np.zeros(len(x))
        try:
            return self._evaluated(x)
        except (ValueError, ArithmeticError):  # matrices near overflow
            return OUTSIDE, np.zeros(len(x))

    def _evaluated(self, x: FloatArray) -> tuple[float, FloatArray]:
        K = self._structure.gain_matrix(x)
        best, at = 0.0, None
        for k, plant in enumerate(self._plants):
            loop = plant.closed(K)
            peak = _peak(loop, self._limit, self._peaks[k]) if np.all(np.isfinite(loop.A)) else None
            if peak is None:
                return OUTSIDE, np.zeros(len(x))
            self._peaks[k] = peak[2]
            if peak[0] > best or at is None:
                best, at = peak[0], (loop, peak[1])
        assert at is not None
        value = max(best, 1e-300)
        gradient = _slope(*at) / value
        return float(np.log(value)), np.asarray(self._structure.pullback(x, gradient), dtype=float)

    def abscissa(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Largest real part of the closed-loop poles [rad/s] and its gradient (size,)."""
        self.evaluations += 1
        if not self._inside(x):
            return OUTSIDE, np.zeros(len(x))
        K = self._structure.gain_matrix(x)
        worst, slope = -np.inf, np.zeros(K.shape)
        for plant in self._plants:
            loop = plant.closed(K)
            if not np.all(np.isfinite(loop.A)):
                return OUTSIDE, np.zeros(len(x))
            real, imaginary, left, right, info = lapack.dgeev(loop.A)
            if info:
                return OUTSIDE, np.zeros(len(x))
            i = int(np.argmax(real))
            if real[i] > worst:
                worst = float(real[i])
                u, v = left[:, i].astype(complex), right[:, i].astype(complex)
                if imaginary[i]:
                    j = i + 1 if imaginary[i] > 0 else i - 1
                    u, v = left[:, min(i, j)] + 1j * left[:, max(i, j)], right[:, min(i, j)] + 1j * right[:, max(i, j)]
                scale = complex(np.vdot(u, v))
                scale = scale if abs(scale) > 1e-14 else 1e-14
                slope = np.real(np.outer(u.conj() @ loop.left, loop.right @ v) / scale)
        return worst, np.asarray(self._structure.pullback(x, slope), dtype=float)


def _peak(loop: ClosedLoopMatrices, limit: float, near: FloatArray) -> tuple[float, float, FloatArray] | None:
    """Largest gain, its frequency and those of its rivals [rad/s]; None where the loop is not stable.

    `near`: frequencies [rad/s] of the peaks of a similar loop.
    """
    real, imaginary, _, vectors, info = lapack.dgeev(loop.A, compute_vl=0)
    if info or not real.max() < limit:
        return None
    form = _response(loop, real + 1j * imaginary, vectors)
    omega = np.concatenate([_frequencies(form.poles), near])
    omega.sort()
    gains = largest_gains(form.at(omega) if form.triangular is not None else _modal(form, omega))
    top = int(gains.argmax())
    best, at = float(gains[top]), float(omega[top])
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
    inner = inner[gains[inner] > RIVAL * best]
    frequencies = []
    for i in inner[np.argsort(-gains[inner])][:MAX_RIVALS]:
        w = float(omega[i])
        reach = float(np.abs(form.poles - 1j * w).min())
        w, gain = climb(form.with_derivatives, w, float(gains[i]), reach, PEAK_TOLERANCE)
        frequencies.append(w)
        if gain > best:
            best, at = gain, w
    direct = _gain(loop.D)
    if direct > best:
        best, at = direct, np.inf
    return (best, at, np.array(frequencies)) if np.isfinite(best) else None


def _modal(form: FrequencyResponse, omega: FloatArray) -> ComplexArray:
    response = (1.0 / (1j * omega[:, None] - form.poles)) @ form.residues
    return np.asarray(response.reshape(-1, *form.D.shape) + form.D)


def _response(loop: ClosedLoopMatrices, poles: ComplexArray, vectors: FloatArray) -> FrequencyResponse:
    lu, pivots, info = lapack.dgetrf(vectors)
    if info or lapack.dgecon(lu, np.sqrt(len(vectors)))[0] < 1e3 * len(vectors) * EPS:
        return FrequencyResponse.of(loop.A, loop.B, loop.C, loop.D)
    left, right = loop.C @ vectors, lapack.dgetrs(lu, pivots, loop.B)[0]
    return FrequencyResponse(poles, complex_columns(poles, left), complex_rows(poles, right), loop.D, None)


def _frequencies(poles: ComplexArray) -> FloatArray:
    """Zero, resonances, magnitudes of the poles, and some between them [rad/s]."""
    upper = poles[poles.imag >= 0.0]
    sizes = np.abs(upper)
    resonances = np.sqrt(np.maximum((upper.imag - upper.real) * (upper.imag + upper.real), 0.0))
    candidates = np.concatenate([sizes, resonances[resonances > 0.0]])
    candidates.sort()
    return np.concatenate(
        [[0.0, 0.3 * candidates[0]], candidates, np.sqrt(candidates[:-1] * candidates[1:]), [3.0 * candidates[-1]]]
    )


def _slope(loop: ClosedLoopMatrices, omega: float) -> FloatArray:
    """Gradient of the largest singular value at `omega` [rad/s] with respect to the gain matrix."""
    if not np.isfinite(omega):
        U, _, Vh = scipy.linalg.svd(loop.D)
        return np.asarray(np.outer(U[:, 0] @ loop.left_z, loop.right_w @ Vh[0]))
    n = len(loop.A)
    lu, pivots, _ = lapack.zgetrf(1j * omega * np.eye(n) - loop.A)
    X = lapack.zgetrs(lu, pivots, loop.B.astype(complex))[0]
    U, _, Vh, _ = lapack.zgesdd(loop.C @ X + loop.D)
    u, v = U[:, 0], Vh[0].conj()
    y = lapack.zgetrs(lu, pivots, (loop.C.T @ u)[:, None], trans=2)[0][:, 0]
    return np.asarray(
        np.real(np.outer(y.conj() @ loop.left + u.conj() @ loop.left_z, loop.right @ (X @ v) + loop.right_w @ v))
    )


def _gain(D: FloatArray) -> float:
    return float(lapack.dgesdd(D, compute_uv=0)[1][0]) if D.any() else 0.0
