"""H-infinity norm of systems of few states: eigenvalues, Newton's method on the gain, one Hamiltonian matrix.

Everything is arranged to cost few calls, because at ten states the calls are the cost. Systems whose damping is so
light that rounding of the eigenvalues could decide a crossing are refused, and :mod:`lftkit.analysis.norms` takes its
other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS, complex_columns, complex_rows
from lftkit.analysis.frequency_response import FrequencyResponse, direct_response, refined_response
from lftkit.analysis.peak_search import climb
from lftkit.arrays import ComplexArray, FloatArray, Matrices

MAX_STATES = 40
MAX_LEVELS = 8
SEPARATION = 1e-3  # rounding of the poles over the distance from the axis of the eigenvalues at the level, at most
TRUSTED = 0.1  # relative rounding of the modal form over `rtol`, at most, where it alone says that there is no peak
CANCELLATION = 1e-12  # smallest norm over the bound of the sum of the modal terms
SMALL_GAP = 1e-4  # relative distance of the squares of level and norm of D below which crossings may be displaced
DIRECT = 1e-2  # relative rounding of a direct solution without refinement over `rtol`, at most


@dataclass(frozen=True)
class NormPeak:
    """Outcome: gain reached, level not exceeded, frequency of the gain [rad/s]."""

    value: float
    upper: float
    omega: float


def small_hinf_norm(system: Matrices, rtol: float) -> NormPeak | None:
    """H-infinity norm of a balanced system (A, B, C, D) in continuous time, or None where this way is not sound.

    Parameters
    ----------
    system : tuple of ndarray
        Shapes (n, n), (n, m), (p, n), (p, m); B and C are not zero.
    rtol : float
        Relative distance of the two sides.
    """
    form = _ModalForm.of(system)
    if form is None or form.rounding > SEPARATION * rtol**0.5 * form.decay:
        return None
    omega, gain = form.best(form.seeds())
    direct = float(lapack.dgesdd(system[3], compute_uv=0)[1][0])
    smallest = CANCELLATION * form.terms()
    for _ in range(MAX_LEVELS):
        omega, gain = form.climbed(omega, gain, rtol)
        value = _direct_gain(system, omega, form, rtol)
        if abs(value - gain) > TRUSTED * rtol * value or value <= smallest:
            return None
        upper = value * (1.0 + rtol)
        gap = 1.0 - (direct / upper) ** 2
        crossings = form.crossings(system, upper, gap)
        if not len(crossings):
            return NormPeak(value, upper, omega)
        omega, gain = form.best(np.concatenate([crossings, 0.5 * (crossings[:-1] + crossings[1:])]))
        if gain <= upper:  # the crossings are rounding, provided that the modal form tells so little apart
            sound = form.rounding <= TRUSTED * rtol * form.decay and gap > SMALL_GAP
            return NormPeak(value, upper, omega) if sound else None
    return None


@dataclass(frozen=True)
class _ModalForm:
    """The response in modal form and what rounding may have done to its poles.

    Parameters
    ----------
    response : FrequencyResponse
    decay : float
        Slowest decay of a pole [rad/s].
    condition : float
        Of the eigenvectors.
    rounding : float
        Rounding error of a pole [rad/s].
    """

    response: FrequencyResponse
    decay: float
    condition: float
    rounding: float

    @classmethod
    def of(cls, system: Matrices) -> _ModalForm | None:
        """The form, or None for a system that is not stable or has no basis of eigenvectors."""
        A, B, C, D = system
        n = len(A)
        real, imaginary, _, vectors, info = lapack.dgeev(A, compute_vl=0)
        decay = -float(real.max())
        if info or not decay > 0.0:
            return None
        lu, pivots, info = lapack.dgetrf(vectors)
        reciprocal = 0.0 if info else float(lapack.dgecon(lu, np.sqrt(n))[0])  # a column has the norm 1 or less
        if reciprocal < n * EPS:
            return None
        poles = real + 1j * imaginary
        left, right = C @ vectors, lapack.dgetrs(lu, pivots, B)[0]
        if imaginary.any():
            left, right = complex_columns(poles, left), complex_rows(poles, right)
        rounding = EPS * float(np.abs(poles).max()) / reciprocal
        return cls(FrequencyResponse(poles, left, right, D, None), decay, 1.0 / reciprocal, rounding)

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A [rad/s]."""
        return self.response.poles

    def terms(self) -> float:
        """Bound of the sum of the magnitudes of the modal terms."""
        return len(self.poles) * float(np.abs(self.response.residues).max()) / self.decay

    def seeds(self) -> FloatArray:
        """Frequencies of possible peaks: zero, resonances, magnitudes of the poles."""
        poles = self.poles[self.poles.imag >= 0.0]
        x, y = poles.real, poles.imag
        return np.concatenate([np.zeros(1), np.sqrt(np.maximum((y - x) * (y + x), 0.0)), np.abs(poles)])

    def best(self, seeds: FloatArray) -> tuple[float, float]:
        """Frequency of the largest gain at the `seeds` and at infinity, and that gain."""
        D = self.response.D
        response = np.empty((len(seeds) + 1, D.size), dtype=complex)
        np.matmul(1.0 / (1j * seeds[:, None] - self.poles), self.response.residues, out=response[:-1])
        response[-1] = 0.0
        gains = largest_gains(np.asarray(response.reshape(-1, *D.shape) + D, dtype=complex))
        index = int(gains.argmax())
        return (np.inf if index == len(seeds) else float(seeds[index])), float(gains[index])

    def climbed(self, omega: float, gain: float, rtol: float) -> tuple[float, float]:
        """Peak near `omega`."""
        if omega == np.inf or omega == 0.0:
            return omega, gain
        return climb(self.response.with_derivatives, omega, gain, self.distance(omega), rtol)

    def distance(self, omega: float) -> float:
        """Distance from j omega to the nearest pole [rad/s]."""
        return float(np.abs(self.poles - 1j * omega).min())

    def crossings(self, system: Matrices, level: float, gap: float) -> FloatArray:
        """Frequencies at which the gain may equal `level` [rad/s], ascending; none: the gain stays below.

        `gap`: smallest eigenvalue of ``I - D' D / level^2``, by whose inverse rounding grows.

        An eigenvalue of the Hamiltonian matrix counts as imaginary where rounding could have moved it from the axis. A
        double one, of a peak that just reaches the level, moves by the square root of the rounding times the distance
        of the pole.
        """
        values = _hamiltonian_eigenvalues(*system, level)
        size = np.abs(values)
        rounding = EPS * self.condition * float(size.max()) / gap
        decays = np.abs(values.real)
        near = decays <= 2.0 * np.sqrt(rounding * size) + rounding
        if not near.any():
            return _NONE
        values, decays = values[near], decays[near]
        distance = np.abs(1j * values.imag[:, None] - self.poles).min(axis=1)
        values = values[decays <= 2.0 * np.sqrt(rounding * distance) + rounding]
        return np.unique(np.abs(values.imag)) if len(values) else _NONE


_NONE = np.zeros(0)


def _hamiltonian_eigenvalues(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, level: float) -> ComplexArray:
    """Eigenvalues of the Hamiltonian matrix, imaginary where the gain equals `level`, which exceeds the norm of D."""
    n = len(A)
    H = np.empty((2 * n, 2 * n), order="F")
    H[:n, :n] = A
    b, c = B * level**-0.5, C * level**-0.5
    if D.any():
        d = D / level
        inputs = lapack.dposv(np.eye(D.shape[1]) - d.T @ d, np.hstack([d.T @ c, b.T]))[1]
        H[:n, :n] += b @ inputs[:, :n]
        H[:n, n:] = b @ inputs[:, n:]
        H[n:, :n] = -c.T @ lapack.dposv(np.eye(len(D)) - d @ d.T, c)[1]
    else:
        H[:n, n:] = b @ b.T
        H[n:, :n] = -c.T @ c
    H[n:, n:] = -H[:n, :n].T
    real, imaginary, _, _, info = lapack.dgeev(H, compute_vl=0, compute_vr=0, overwrite_a=True)
    if info:
        raise ArithmeticError(f"the eigenvalues of a Hamiltonian matrix of order {2 * n} did not converge")
    return np.asarray(real + 1j * imaginary)


def _direct_gain(system: Matrices, omega: float, form: _ModalForm, rtol: float) -> float:
    """Gain by a direct solution, refined where rounding could be felt."""
    exact = omega == np.inf or form.rounding <= DIRECT * rtol * form.distance(omega)
    response = direct_response(*system, omega) if exact else refined_response(*system, omega)
    return float(lapack.zgesdd(response, compute_uv=0)[1][0])
