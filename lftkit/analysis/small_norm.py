"""H-infinity norm of systems of few states: eigenvalues, Newton's method on the gain, one Hamiltonian matrix.

Everything is arranged to cost few calls, because at ten states the calls are the cost. Systems whose damping is so
light that rounding of the eigenvalues could decide a crossing are refused, and :mod:`lftkit.analysis.norms` takes its
other way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import hypot
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import refined_response
from lftkit.analysis.peak_search import climb
from lftkit.arrays import ComplexArray, FloatArray, Matrices

MAX_STATES = 40
COMPILED_STATES = 12  # up to which compiled code is used where numba is installed
MAX_LEVELS = 8
SEPARATION = 1e-3  # rounding of the poles over the distance from the axis of the eigenvalues at the level, at most
TRUSTED = 0.1  # relative rounding of the modal form over `rtol`, at most, where it alone says that there is no peak
CANCELLATION = 1e-12  # smallest norm over the bound of the sum of the modal terms
SMALL_GAP = 1e-4  # relative distance of the squares of level and norm of D below which crossings may be displaced
AT_CIRCLE = 16.0 * EPS  # 1 - |z|^2 of a pole over the number of states, below which another way says what is stable
LARGE = 1e70  # gains between this and its inverse have fourth powers that are numbers
CLIMB = 0.1  # part of `rtol` to which a peak is climbed: the ways with and without compiled code agree to 1e-10
DIRECT = 1e-3  # relative rounding of a direct solution without refinement over `rtol`, at most
DIRECT_OF_MAP = 1e-2  # the same with the rounding of a map, which a direct solution does not have


class Origin(NamedTuple):
    """Where a mapped system comes from.

    Parameters
    ----------
    response : callable
        Response (p, m) of the matrices that were given at a frequency of the mapped system [rad/s], also at infinity.
    condition : float
        The mapped matrices are exact to so many roundings.
    """

    response: Callable[[float], ComplexArray]
    condition: float


@dataclass(frozen=True)
class NormPeak:
    """Outcome: gain reached, level not exceeded, frequency of the gain [rad/s]."""

    value: float
    upper: float
    omega: float


def small_hinf_norm(system: Matrices, rtol: float, origin: Origin | None = None) -> NormPeak | None:
    """H-infinity norm of a balanced system (A, B, C, D) in continuous time, or None where this way is not sound.

    Parameters
    ----------
    system : tuple of ndarray
        Shapes (n, n), (n, m), (p, n), (p, m); B and C are not zero.
    rtol : float
        Relative distance of the two sides.
    origin : Origin, optional
        Of a system that is an exact map of another one up to rounding: the gain is that of the other one, and nothing
        is decided by what the map may have lost.
    """
    form = _ModalForm.of(system, origin.condition if origin else 0.0)
    if form is None or (origin and form.nearest_to_circle() < AT_CIRCLE * len(system[0])):
        return None
    if form.rounding > SEPARATION * rtol**0.5 * form.decay:
        return None
    if not form.terms + float(abs(system[3]).max()) < LARGE:
        return None
    omega, gain, direct = form.best(form.seeds())
    smallest = max(CANCELLATION * form.terms, 1.0 / LARGE)
    for _ in range(MAX_LEVELS):
        omega, gain = form.climbed(omega, gain, rtol)
        value = form.direct_gain(system, omega, rtol, origin)
        if value is None:
            return None
        if abs(value - gain) > TRUSTED * rtol * value or value <= smallest:
            return None
        upper = value * (1.0 + rtol)
        gap = 1.0 - (direct / upper) ** 2
        crossings = form.crossings(system, upper, gap)
        if not crossings:
            return NormPeak(value, upper, omega)
        middles = [0.5 * (low + high) for low, high in pairwise(crossings)]
        omega, gain, _ = form.best(np.array(crossings + middles))
        if gain <= upper:  # the crossings are rounding, provided that the modal form tells so little apart
            sound = form.rounding <= TRUSTED * rtol * form.decay and gap > SMALL_GAP
            return NormPeak(value, upper, omega) if sound else None
    return None


class _ModalForm(NamedTuple):
    """The response in modal form and what rounding may have done to its poles.

    Parameters
    ----------
    poles : ndarray, shape (n,), complex
        Eigenvalues of A [rad/s].
    residues : ndarray, shape (n, p m), complex
    D : ndarray, shape (p, m)
    values : list of complex
        The poles once more.
    decay : float
        Slowest decay of a pole [rad/s].
    condition : float
        Of the eigenvectors.
    rounding : float
        Rounding error of a pole [rad/s].
    lost : float
        Roundings of the matrices themselves (0: they are exact).
    terms : float
        Bound of the sum of the magnitudes of the modal terms.
    """

    poles: ComplexArray
    residues: ComplexArray
    D: FloatArray
    values: list[complex]
    decay: float
    condition: float
    rounding: float
    lost: float
    terms: float

    @classmethod
    def of(cls, system: Matrices, lost: float) -> _ModalForm | None:
        """The form, or None for a system that is not stable or has no basis of eigenvectors."""
        A, B, C, D = system
        n = len(A)
        real, imaginary, _, vectors, info = lapack.dgeev(A, compute_vl=0)
        parts, heights = real.tolist(), imaginary.tolist()
        decay = -max(parts)
        if info or not decay > 0.0:
            return None
        lu, _, right, info = lapack.dgesv(vectors, B)
        reciprocal = 0.0 if info else float(lapack.dgecon(lu, n**0.5)[0])  # a column has the norm 1 or less
        if reciprocal < n * EPS:
            return None
        poles: ComplexArray = real.astype(complex)
        poles.imag = imaginary
        residues = _residues((C @ vectors).T, right, heights)
        values = list(map(complex, parts, heights))
        rounding = _rounding(max(map(abs, values)), lost) / reciprocal
        terms = n * float(abs(residues).max()) / decay
        return cls(poles, residues, D, values, decay, 1.0 / reciprocal, rounding, lost, terms)

    def seeds(self) -> FloatArray:
        """Frequencies of possible peaks: zero, resonances, magnitudes of the poles."""
        seeds = [0.0]
        for pole in self.values:
            x, y = -pole.real, pole.imag
            if y >= 0.0:
                seeds.append(abs(pole))
                if y > x:
                    seeds.append(((y - x) * (y + x)) ** 0.5)
        return np.array(seeds)

    def best(self, seeds: FloatArray) -> tuple[float, float, float]:
        """Frequency of the largest gain at the `seeds` and at infinity, that gain, and the one at infinity."""
        k = len(seeds)
        weights = np.zeros((k + 1, len(self.poles)), dtype=complex)
        np.divide(1.0, 1j * seeds[:, None] - self.poles, out=weights[:k])
        response = weights @ self.residues
        response += self.D.ravel()
        gains = _gains(response, self.D.shape)
        gain = max(gains)
        index = gains.index(gain)
        return (float(seeds[index]) if index < k else np.inf), gain, gains[k]

    def climbed(self, omega: float, gain: float, rtol: float) -> tuple[float, float]:
        """Peak near `omega`."""
        if omega == np.inf or omega == 0.0:
            return omega, gain
        return climb(self.with_derivatives, omega, gain, self.distance(omega), CLIMB * rtol)

    def with_derivatives(self, omega: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Response (p, m) at a finite frequency [rad/s] and its first and second derivative with respect to it."""
        term = 1.0 / (1j * omega - self.poles)
        first = -1j * term * term
        G, G1, G2 = (np.array((term, first, -2j * first * term)) @ self.residues).reshape(3, *self.D.shape)
        return G + self.D, G1, G2

    def distance(self, omega: float) -> float:
        """Distance from j omega to the nearest pole [rad/s]."""
        return min(abs(pole - 1j * omega) for pole in self.values)

    def nearest_to_circle(self) -> float:
        """Smallest ``1 - |z|^2`` of the poles ``z = (1 + s) / (1 - s)``."""
        return min(-4.0 * pole.real / abs(1.0 - pole) ** 2 for pole in self.values)

    def direct_gain(self, system: Matrices, omega: float, rtol: float, origin: Origin | None) -> float | None:
        """Gain by a direct solution, refined where rounding could be felt (of a mapped system: None there)."""
        if origin is not None:
            felt = omega < np.inf and self.rounding > DIRECT_OF_MAP * rtol * self.distance(omega)
            return None if felt else _norm(origin.response(omega))
        if omega == np.inf:
            return _norm(system[3])
        if self.rounding > DIRECT * rtol * self.distance(omega):
            return _norm(refined_response(*system, omega))
        return _norm(_response(system, 1j * omega))

    def crossings(self, system: Matrices, level: float, gap: float) -> list[float]:
        """Frequencies at which the gain may equal `level` [rad/s], ascending; none: the gain stays below.

        `gap`: smallest eigenvalue of ``I - D' D / level^2``, by whose inverse rounding grows.

        An eigenvalue of the Hamiltonian matrix counts as imaginary where rounding could have moved it from the axis. A
        double one, of a peak that just reaches the level, moves by the square root of the rounding times the distance
        of the pole.
        """
        real, imaginary = _hamiltonian_eigenvalues(*system, level)
        sizes = list(map(hypot, real, imaginary))
        rounding = _rounding(max(sizes), self.lost) * self.condition / gap
        found = {
            abs(y)
            for x, y, size in zip(real, imaginary, sizes)
            if abs(x) <= 2.0 * (rounding * size) ** 0.5 + rounding
            and abs(x) <= 2.0 * (rounding * self.distance(y)) ** 0.5 + rounding
        }
        return sorted(found)


def _rounding(size: float, lost: float) -> float:
    """Rounding of a matrix of the norm `size`, and of one that is exact to `lost` roundings of 1 and of its norm."""
    return EPS * (max(lost, 1.0) * size + lost)


def _residues(left: FloatArray, right: FloatArray, heights: list[float]) -> ComplexArray:
    """Residues (n, p m) from factors (n, p) and (n, m) in the real form of LAPACK, poles of the imaginary parts given.

    For a pair of poles with the factors ``lx + j ly`` and ``(rx - j ry) / 2`` the residue is half of
    ``lx rx + ly ry + j (ly rx - lx ry)``.
    """
    n = len(heights)
    left, right = left[:, :, None], right[:, None, :]
    own = (left * right).reshape(n, -1)
    residues = own.astype(complex)
    if any(heights):
        partner = [k + (y > 0.0) - (y < 0.0) for k, y in enumerate(heights)]
        across = (left * right[partner]).reshape(n, -1)
        residues += own[partner]
        residues.imag = across[partner] - across
        residues *= 0.5
    return residues


def _gains(responses: ComplexArray, shape: tuple[int, ...]) -> list[float]:
    """Largest singular value of each response, a row (p m) of the stack."""
    gains: list[float]
    if 1 in shape:
        parts = responses.view(float)
        gains = np.sqrt(np.einsum("ij,ij->i", parts, parts)).tolist()
    else:
        gains = largest_gains(responses.reshape(-1, *shape)).tolist()
    return gains


def _hamiltonian_eigenvalues(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, level: float
) -> tuple[list[float], list[float]]:
    """Eigenvalues of the Hamiltonian matrix, imaginary where the gain equals `level`, which exceeds the norm of D."""
    n = len(A)
    scale = level**-0.5
    b, c = B * scale, C * scale
    H = np.empty((2 * n, 2 * n), order="F")
    H[:n, :n] = A
    H[n:, n:] = -A.T
    if D.any():
        d = D / level
        across = d.T @ c
        both = np.concatenate((across, b.T), axis=1)
        H[:n, n:] = 0.0
        H[n:, :n] = -(c.T @ c)
        gap = d.T @ -d
        gap.flat[:: len(gap) + 1] += 1.0
        H += np.concatenate((b, -across.T)) @ lapack.dposv(gap, both)[1]
    else:
        H[:n, n:] = b @ b.T
        H[n:, :n] = -(c.T @ c)
    real, imaginary, _, _, info = lapack.dgeev(H, compute_vl=0, compute_vr=0, overwrite_a=1)
    if info:
        raise ArithmeticError(f"the eigenvalues of a Hamiltonian matrix of order {2 * n} did not converge")
    return real.tolist(), imaginary.tolist()


def _response(system: Matrices, point: complex) -> ComplexArray:
    """``D + C (point I - A)^-1 B``."""
    A, B, C, D = system
    shifted = np.multiply(A, -1.0 + 0.0j, order="F")
    shifted.flat[:: len(A) + 1] += point
    return np.asarray(C @ lapack.zgesv(shifted, B, overwrite_a=1)[2] + D)


def _norm(response: FloatArray | ComplexArray) -> float:
    """Largest singular value."""
    if 1 in response.shape:
        return float(np.sqrt(np.vdot(response, response).real))
    return float(lapack.zgesdd(response, compute_uv=0)[1][0])
