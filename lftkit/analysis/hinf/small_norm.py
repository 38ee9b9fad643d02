"""H-infinity norm of systems of few states: eigenvalues, Newton's method on the gain, one Hamiltonian matrix.

Everything is arranged to cost few calls, because at ten states the calls are the cost. Systems whose damping is so
light that rounding of the eigenvalues could decide a crossing are refused, and :mod:`lftkit.analysis.norms` takes its
other way.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from math import hypot, pi
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.hinf.hamiltonian_norm import hamiltonian_eigenvalues
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings, Peak, UndecidedError
from lftkit.analysis.hinf.peak_search import climb, direct_gain, largest_gain, peak_frequencies, response_at
from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.systems.sampled.bilinear import discrete_point, to_continuous, unwarped_frequency

AT_CIRCLE = 16.0 * EPS  # 1 - |z|^2 of a pole over the number of states, below which another way says what is stable


class HalfPlane(NamedTuple):
    """The mapped system, the one that was given, and what the map may have lost.

    It is the bilinear map of ``sign z`` (:mod:`lftkit.systems.sampled.bilinear`, with the period 2). The inverse that
    it needs is that of ``sign A + I``: well conditioned as long as no pole is near ``z = -sign``.

    Parameters
    ----------
    matrices, given : tuple of ndarray
        Shapes (n, n), (n, m), (p, n), (p, m): in continuous and in discrete time.
    sign : float
        1 or -1.
    condition : float
        Of ``sign A + I``, 1-norm: the mapped matrices are exact to so many roundings.
    """

    matrices: Matrices
    given: Matrices
    sign: float
    condition: float

    @classmethod
    def of(cls, system: Matrices, largest: float) -> Iterator[HalfPlane]:
        """The maps whose condition is at most the `largest`, first by the sign of the trace.

        The second one is for a peak at ``z = -sign``, which the first one has at infinity.
        """
        A, B, C, D = system
        first, one = 1.0 if A.trace() >= 0.0 else -1.0, np.eye(len(A))
        for sign in (first, -first):
            with suppress(ValueError):
                mapped = to_continuous(A * sign, B * sign, C, D, rcond=0.0)
                shifted, inverse = A * sign + one, 0.5 * (one - mapped[0])
                condition = float(abs(shifted).sum(axis=0).max() * abs(inverse).sum(axis=0).max())
                if condition <= largest:
                    yield cls(mapped, system, sign, condition)

    def angle(self, omega: float) -> float:
        """Angle on the unit circle [rad] of the frequency `omega` in continuous time."""
        turn = 2.0 * unwarped_frequency(omega)
        return turn if self.sign > 0.0 else pi - turn

    def response(self, omega: float) -> ComplexArray:
        """Response (p, m) of the matrices that were given, at the point of the circle of `omega`."""
        return response_at(self.given, self.sign * (-1.0 if omega == np.inf else discrete_point(1j * omega)))


class SmallModel(NamedTuple):
    """Gain of few states: a :class:`~lftkit.analysis.hinf.level_iteration.GainModel`.

    Parameters
    ----------
    system : tuple of ndarray
        Shapes (n, n), (n, m), (p, n), (p, m).
    rtol : float
        Relative distance of the two sides.
    origin : HalfPlane or None
        Of a mapped system.
    poles : ndarray, shape (n,), complex
        Eigenvalues of A [rad/s].
    residues : ndarray, shape (n, p m), complex
    values : list of complex
        The poles once more.
    decay : float
        Slowest decay of a pole [rad/s].
    condition : float
        Of the eigenvectors.
    rounding : float
        Rounding error of a pole [rad/s].
    terms : float
        No sum of the magnitudes of the modal terms exceeds it.
    direct : float
        Norm of D.
    settings : NormSettings
    """

    system: Matrices
    rtol: float
    origin: HalfPlane | None
    poles: ComplexArray
    residues: ComplexArray
    values: list[complex]
    decay: float
    condition: float
    rounding: float
    terms: float
    direct: float
    settings: NormSettings

    @classmethod
    def of(
        cls, system: Matrices, rtol: float, origin: HalfPlane | None = None, settings: NormSettings = SETTINGS
    ) -> SmallModel:
        """Model of a balanced system (A, B, C, D) in continuous time.

        Parameters
        ----------
        system : tuple of ndarray
            Shapes (n, n), (n, m), (p, n), (p, m); B and C are not zero.
        rtol : float
            Relative distance of the two sides.
        origin : HalfPlane, optional
            Of a system that is an exact map of another one up to rounding: the gain is that of the other one, and
            nothing is decided by what the map may have lost.
        settings : NormSettings

        Raises
        ------
        UndecidedError
            A system that is not stable, has no basis of eigenvectors, or is too near to the one or the other.
        """
        A, B, C, D = system
        n = len(A)
        real, imaginary, _, vectors, info = lapack.dgeev(A, compute_vl=0)
        parts, heights = real.tolist(), imaginary.tolist()
        decay = -max(parts)
        if info or not decay > 0.0:
            raise UndecidedError("a pole is not left of the imaginary axis")
        lu, _, right, info = lapack.dgesv(vectors, B)
        reciprocal = 0.0 if info else float(lapack.dgecon(lu, n**0.5)[0])  # a column has the norm 1 or less
        if reciprocal < n * EPS:
            raise UndecidedError("there is no basis of eigenvectors")
        poles: ComplexArray = real.astype(complex)
        poles.imag = imaginary
        residues = _residues((C @ vectors).T, right, heights)
        values = list(map(complex, parts, heights))
        rounding = _rounding(max(map(abs, values)), origin) / reciprocal
        terms = float((abs(residues).max(axis=1) / -real).sum())
        if rounding > settings.separation * rtol**0.5 * decay:
            raise UndecidedError("the damping is near rounding")
        # 1 - |z|^2 of the poles z = (1 + s) / (1 - s)
        if origin is not None and min(-4.0 * pole.real / abs(1.0 - pole) ** 2 for pole in values) < AT_CIRCLE * n:
            raise UndecidedError("a pole is near the unit circle")
        if not terms + float(abs(D).max()) < settings.large:
            raise UndecidedError("powers of the gains are no numbers")
        condition, direct = 1.0 / reciprocal, largest_gain(D)
        return cls(system, rtol, origin, poles, residues, values, decay, condition, rounding, terms, direct, settings)

    def first_peak(self) -> Peak:
        """The peak near the best of zero, the resonances and the magnitudes of the poles."""
        return self._climbed(*self._best(peak_frequencies(self.values)))

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain by a direct solution, which the modal form must reproduce, and the level above it."""
        omega, settings = peak.omega, self.settings
        # A direct solution is refined where rounding could be felt
        felt = settings.direct if self.origin is None else settings.direct_of_map
        refined = omega < np.inf and self.rounding > felt * self.rtol * self._distance(omega)
        if self.origin is None:
            value = direct_gain(self.system, omega, refined=refined)
        elif refined:
            raise UndecidedError("rounding of the map is felt")
        else:
            value = largest_gain(self.origin.response(omega))
        if abs(value - peak.gain) > settings.agreement * self.rtol * value:
            raise UndecidedError("the modal form differs from a direct solution")
        # The eigenvalues of the Hamiltonian matrix say the square of the level: where terms cancel, their rounding can
        # hide a peak
        hidden = (settings.cancelled * EPS / self.rtol) ** 0.5
        if value <= max(hidden * self.terms, 1.0 / settings.large):
            raise UndecidedError("the modal terms cancel")
        return value, value * (1.0 + self.rtol)

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """The peak near the best of the crossings of the level and the middles between them."""
        gap = 1.0 - (self.direct / level) ** 2
        # An eigenvalue of the Hamiltonian matrix counts as imaginary where rounding, which grows by the inverse of the
        # gap, could have moved it from the axis. A double one, of a peak that just reaches the level, moves by the
        # square root of the rounding times the distance of the pole.
        real, imaginary = (part.tolist() for part in hamiltonian_eigenvalues(self.system, level))
        sizes = list(map(hypot, real, imaginary))
        rounding = _rounding(max(sizes), self.origin) * self.condition / gap
        at_level = {
            abs(y)
            for x, y, size in zip(real, imaginary, sizes)
            if abs(x) <= 2.0 * (rounding * size) ** 0.5 + rounding
            and abs(x) <= 2.0 * (rounding * self._distance(y)) ** 0.5 + rounding
        }
        crossings = sorted(at_level)
        if not crossings:
            return None
        middles = [0.5 * (low + high) for low, high in pairwise(crossings)]
        omega, gain = self._best(np.array(crossings + middles))
        if gain > level:
            return self._climbed(omega, gain)
        if self.rounding > self.settings.agreement * self.rtol * self.decay or gap <= self.settings.small_gap:
            raise UndecidedError("crossings by rounding, and the modal form does not tell the gains apart")
        return None

    def with_derivatives(self, omega: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Response (p, m) at a finite frequency [rad/s] and its first and second derivative with respect to it."""
        D = self.system[3]
        term = 1.0 / (1j * omega - self.poles)
        first = -1j * term * term
        G, G1, G2 = (np.array((term, first, -2j * first * term)) @ self.residues).reshape(3, *D.shape)
        return G + D, G1, G2

    def _best(self, frequencies: FloatArray) -> tuple[float, float]:
        """Frequency of the largest gain at the `frequencies` and at infinity, and that gain."""
        D = self.system[3]
        response = (1.0 / (1j * frequencies[:, None] - self.poles)) @ self.residues
        response += D.ravel()
        # Largest singular value of each response, a row (p m) of the stack
        shape = D.shape
        gains: list[float]
        if 1 in shape:
            parts = response.view(float)
            gains = np.sqrt(np.einsum("ij,ij->i", parts, parts)).tolist()
        else:
            gains = largest_gains(response.reshape(-1, *shape)).tolist()
        gain = max(gains)
        return (np.inf, self.direct) if self.direct > gain else (float(frequencies[gains.index(gain)]), gain)

    def _climbed(self, omega: float, gain: float) -> Peak:
        """Peak near `omega`."""
        if omega == np.inf or omega == 0.0:
            return Peak(omega, gain)
        rtol = self.settings.climbed * self.rtol
        return Peak(*climb(self.with_derivatives, omega, gain, self._distance(omega), rtol, self.settings))

    def _distance(self, omega: float) -> float:
        """Distance from j omega to the nearest pole [rad/s]."""
        return min(abs(pole - 1j * omega) for pole in self.values)


def _rounding(size: float, origin: HalfPlane | None) -> float:
    """Rounding of a matrix of the norm `size`; of a mapped one of so many roundings of 1 and of its norm."""
    lost = origin.condition if origin else 0.0
    return EPS * (max(lost, 1.0) * size + lost)


def _residues(left: FloatArray, right: FloatArray, heights: list[float]) -> ComplexArray:
    """Residues (n, p m) from factors (n, p) and (n, m) in the real form of LAPACK, poles of the imaginary parts given.

    For a pair of poles with the factors ``lx + j ly`` and ``(rx - j ry) / 2`` the residue is half of
    ``lx rx + ly ry + j (ly rx - lx ry)``.
    """
    n = len(heights)
    left, right = left[:, :, None], right[:, None, :]
    of_poles = (left * right).reshape(n, -1)
    residues = of_poles.astype(complex)
    if any(heights):
        partner = [k + (y > 0.0) - (y < 0.0) for k, y in enumerate(heights)]
        across = (left * right[partner]).reshape(n, -1)
        residues += of_poles[partner]
        residues.imag = across[partner] - across
        residues *= 0.5
    return residues
