r"""Integrals over the spatial frequencies that an aperture transmits.

An image has no frequency beyond the aperture's cutoff, so every integral over the whole image plane (peak, moments,
encircled energy) is one over a disc of frequencies. In polar coordinates the angles are equally spaced (exact for
trigonometric polynomials); radii are those of Gauss and Legendre in an angle :math:`\varphi` with :math:`f = c - h \cos
\varphi` on each part between two frequencies where the transfer function has a kink or a branch point, which that
substitution smooths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.image.optics import Optics

POINTS, POINTS_PER_PHASE = 14, 0.25
"""Radii in each part between two kinks, and what a phase of the motion [rad] adds."""
ANGLES_PER_PHASE = 0.6
"""Angles over half a turn that a phase of the motion [rad] adds to those that the aperture needs."""


@dataclass(frozen=True)
class Quadrature:
    """Frequencies of half a disc with their weights, and the transfer functions there.

    Parameters
    ----------
    radii : ndarray, shape (r,)
        [cycles/rad].
    steps : ndarray, shape (r,)
        Weights of an integral over the radius [cycles/rad].
    frequencies : ndarray, shape (r a, 2)
        Those of each radius together [cycles/rad].
    weights : ndarray, shape (r a,)
        Of an integral over the half plane; one over the plane is twice the real part.
    diffraction, image : ndarray, shape (r a,)
        Transfer function of the aperture alone, of aperture and pixel.
    """

    radii: FloatArray
    steps: FloatArray
    frequencies: FloatArray
    weights: FloatArray
    diffraction: ComplexArray
    image: ComplexArray

    @property
    def angles(self) -> int:
        """Angles at each radius."""
        return len(self.weights) // len(self.radii)

    @classmethod
    def of(cls, optics: Optics, phase: float = 0.0) -> Quadrature:
        """For optics, and motion whose phases at the cutoff reach `phase` [rad]."""
        points = POINTS + math.ceil(POINTS_PER_PHASE * phase)
        count = 4 * math.ceil((optics.aperture.angles + ANGLES_PER_PHASE * phase) / 4)  # the same along x and y
        node, weight = np.polynomial.legendre.leggauss(points)
        turn, part = 0.5 * math.pi * (node + 1), 0.5 * math.pi * weight
        ends = optics.cutoff * np.array([0.0, *optics.aperture.breaks])
        middle, half = (ends[1:] + ends[:-1]) / 2, np.diff(ends) / 2
        radii = (middle[:, None] - half[:, None] * np.cos(turn)).ravel()
        steps = (half[:, None] * np.sin(turn) * part).ravel()
        angle = math.pi * (np.arange(count) + 0.5) / count
        frequencies = radii[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        flat = frequencies.reshape(-1, 2)
        diffraction = optics.diffraction(flat)
        weights = np.repeat(steps * radii * math.pi / count, count)
        return cls(radii, steps, flat, weights, diffraction, diffraction * optics.detector(flat))

    def over_plane(self, values: ComplexArray) -> FloatArray:
        """Integral over the plane of a function whose value at -f is the conjugate: (..., r a) -> (...)."""
        return np.asarray(2.0 * (values @ self.weights).real)
