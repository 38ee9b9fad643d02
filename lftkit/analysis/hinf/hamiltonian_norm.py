"""H-infinity norm by a Hamiltonian matrix, over the whole frequency axis or a band; no modal form is needed.

The frequencies at which a singular value equals a level are imaginary eigenvalues of a Hamiltonian matrix (Boyd,
Balakrishnan and Kabamba 1989). Between two of them the gain is on one side of the level, and a point in the middle says
on which: a peak cannot escape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings, Peak
from lftkit.analysis.hinf.peak_search import CANCELLATION, cancellation, direct_gain, highest_peak_of, peak_frequencies
from lftkit.arrays import FloatArray, Matrices

SQUARES = float(np.sqrt(10.0 * EPS))  # least gain over the sum of its terms' magnitudes that squares of gains show


@dataclass(frozen=True)
class HamiltonianModel:
    """Gain with Hamiltonian level tests: a :class:`~lftkit.analysis.hinf.level_iteration.GainModel`.

    Parameters
    ----------
    system : tuple of ndarray
        Balanced matrices, shapes (n, n), (n, m), (p, n), (p, m).
    response : FrequencyResponse
        The same for the search of peaks; no pole on the imaginary axis. The gains are those of direct solutions.
    rtol : float
        Relative distance of the two sides.
    band : tuple of float
        Lowest and highest frequency [rad/s].
    settings : NormSettings
    """

    system: Matrices
    response: FrequencyResponse
    rtol: float
    band: tuple[float, float] = (0.0, np.inf)
    settings: NormSettings = SETTINGS

    @cached_property
    def _terms(self) -> float:
        """Largest sum of the magnitudes of a gain's terms at the resonances and poles in the band."""
        low, high = self.band
        omega = peak_frequencies(self.response.poles.tolist())
        omega = np.clip(omega[:: -(-len(omega) // self.settings.samples)], low, high)
        return max(_terms_at(self.system, float(w)) for w in omega)

    def first_peak(self) -> Peak:
        """The highest peak near the resonances and the ends of the band."""
        return self._highest(np.append(peak_frequencies(self.response.poles.tolist()), self.band))[0]

    def bracket(self, peak: Peak) -> tuple[float, float]:
        """Gain at `peak` and the level above it, which is above zero.

        The matrix has squares of gains: where the terms of a gain cancel, their rounding is that of the terms' square.
        """
        value, rtol = peak.gain, self.rtol
        noise = cancellation(self.response)
        if value == noise == 0.0:
            _, B, C, _ = self.system
            slowest = np.abs(self.response.poles.real).min()
            noise = CANCELLATION * float(linalg.norm(B) * linalg.norm(C) / slowest) + np.finfo(float).tiny
        if not value > noise:
            return value, value + noise
        terms, level = max(self._terms, _terms_at(self.system, peak.omega)), max(value, peak.possible) * (1.0 + rtol)
        seen = float(np.hypot(level, SQUARES * terms))
        if not self.response.modal:
            return value, seen
        return value, min(seen, max(level, noise / CANCELLATION + CANCELLATION * terms))  # no gain exceeds their sum

    def higher_peak(self, level: float, peak: Peak) -> Peak | None:
        """The highest peak near the crossings of the level and the middles between them.

        Without crossings the gain is on one side of the level in the whole band, and its ends say on which.
        """
        crossings = level_crossings(self.system, level, self.settings)
        inside = crossings[(crossings > self.band[0]) & (crossings < self.band[1])]
        if not inside.size:
            end = max((Peak(omega, direct_gain(self.system, omega)) for omega in self.band), key=lambda one: one.gain)
            return end if end.gain > level else None
        edges = np.unique([self.band[0], *inside, min(self.band[1], 2.0 * float(inside[-1]))])
        candidates = np.concatenate([edges, 0.5 * (edges[:-1] + edges[1:])])
        highest, modal = self._highest(candidates)
        if not highest.gain > level:  # the response may be less precise than a direct solution
            gains = [direct_gain(self.system, float(omega)) for omega in candidates]
            best = int(np.argmax(gains))
            highest = Peak(float(candidates[best]), gains[best])
        if highest.gain > level:
            return highest
        return highest._replace(possible=modal) if modal > level else None

    def _highest(self, frequencies: FloatArray) -> tuple[Peak, float]:
        """The highest peak near some of the frequencies inside the band, and its gain in the response."""
        low, high = self.band
        inside = np.unique(frequencies[(frequencies >= low) & (frequencies <= high)])
        omega, gain, _ = highest_peak_of(self.response, inside, self.rtol, self.settings, self.band)
        return Peak(omega, direct_gain(self.system, omega)), gain


def _terms_at(system: Matrices, omega: float) -> float:
    """Norm of the sums of the magnitudes of the terms ``C (j omega - A)^-1 B`` at a frequency."""
    A, B, C, _ = system
    if not omega < np.inf:
        return 0.0
    states = np.abs(lapack.zgesv(1j * omega * np.eye(len(A)) - A, B.astype(complex))[2])
    return float(linalg.norm(np.abs(C) @ states))


def level_crossings(system: Matrices, level: float, settings: NormSettings = SETTINGS) -> FloatArray:
    """Frequencies at which a singular value of the response may equal `level` [rad/s], ascending.

    Eigenvalues count as imaginary generously, because the gain at the crossings and between them decides.
    """
    real, imaginary = hamiltonian_eigenvalues(system, level)
    sizes = np.hypot(real, imaginary)
    size = float(sizes.max(initial=0.0))
    gap = float(np.abs(1.0 - (linalg.svdvals(system[3]) / level) ** 2).min(initial=1.0))
    solved = EPS * size * max(1.0 / max(gap, EPS) - 1.0, 0.0)  # rounding where the level is near a gain of D
    near = np.abs(real) <= settings.imaginary * sizes + settings.displaced * size + 2.0 * np.sqrt(solved * sizes)
    # Others come in pairs, reflected at the axis, as far as rounding lets them: one without a partner is imaginary
    values = real + 1j * imaginary
    distance = np.abs(values[:, None] + values.conj())
    np.fill_diagonal(distance, np.inf)
    near |= 2.0 * np.abs(real) <= settings.unpaired * np.asarray(distance.min(axis=1, initial=np.inf))
    return np.asarray(np.unique(np.abs(imaginary[near])))


def hamiltonian_eigenvalues(system: Matrices, level: float) -> tuple[FloatArray, FloatArray]:
    """Real and imaginary parts (2 n,) of the eigenvalues of the Hamiltonian matrix of a level.

    They are imaginary where a singular value of the response equals `level`, which is no singular value of D.

    Raises
    ------
    ArithmeticError
        The QR algorithm did not converge.
    """
    A, B, C, D = system
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
        _, solution, info = lapack.dposv(gap, both)
        if info:  # a level below the norm of D
            solution = lapack.dgesv(gap, both)[2]
        H += np.concatenate((b, -across.T)) @ solution
    else:
        H[:n, n:] = b @ b.T
        H[n:, :n] = -(c.T @ c)
    workspace = 66 * 2 * n  # what LAPACK asks for, at most
    real, imaginary, _, _, info = lapack.dgeev(H, compute_vl=0, compute_vr=0, overwrite_a=1, lwork=workspace)
    if info:
        raise ArithmeticError(f"the eigenvalues of a Hamiltonian matrix of order {2 * n} did not converge")
    return real, imaginary
