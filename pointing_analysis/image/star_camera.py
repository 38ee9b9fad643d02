r"""A guide star on the pixels of a camera: its image in an exposure, and the detector's noise.

The image is the sum over the spatial frequencies that the aperture transmits of
:mod:`pointing_analysis.image.star_image`, with the motion of the exposure in it. Here the frequencies are those of a
fixed field and only the half of them with f_x >= 0, the image being real; and the mean over the path is taken at
`NODES` places of each of its segments (Gauss and Legendre), for which the exponentials are a product of one along x and
one along y:

.. math:: M(f) = \sum_j w_j\, e^{-2\pi i f_x x_j}\, e^{-2\pi i f_y y_j}

**Rows of an image are along +y, columns along +x; a star at +x is at a larger column.**
"""

from __future__ import annotations

import math

import numpy as np

from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.image.guide_camera import OFFSET, GuideCamera, collecting_area
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.star_image import ImageGrid

NODES = 3
"""Places on each straight segment of a path."""
BORDER, STILL_BORDER = 12.0, 6.0
"""[wavelength over aperture] Empty border about the window: what the wings beyond it hold is folded back in.

The second one is that of a star at rest, the model of the centroid: 1.4e-4 of the peak, 1e-4 of a pixel.
"""
_ABSCISSAE, _WEIGHTS = np.polynomial.legendre.leggauss(NODES)


def along(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places of a path and their weights in its mean over the time: (N + 1, 2) -> (NODES N, 2), (NODES N,)."""
    middle, half = 0.5 * (path[:-1] + path[1:]), 0.5 * (path[1:] - path[:-1])
    places = middle[:, None, :] + _ABSCISSAE[None, :, None] * half[:, None, :]
    weights = np.tile(0.5 * _WEIGHTS, len(middle)) / len(middle)
    return places.reshape(-1, 2), weights


class StarCamera:
    """Images of a guide star.

    Parameters
    ----------
    optics : Optics
    camera : GuideCamera

    Attributes
    ----------
    line : ndarray, shape (n,)
        Centres of the pixels along an axis of the window [rad].
    reach : float
        Half width of the field from which light is in the window [rad].
    flux, second : float
        Electrons of the star and of the second one in an exposure.
    fx : ndarray
        Frequencies along x that are not negative [1/rad].

    Examples
    --------
    >>> from pointing_analysis.units import RAD_PER_MAS
    >>> optics = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
    >>> camera = StarCamera(optics, GuideCamera(magnitude=14.0))
    >>> still = camera.expected(np.zeros((2, 2)))
    >>> round(float(still.sum())), round(float(still.max()))
    (376, 58)
    """

    def __init__(self, optics: Optics, camera: GuideCamera) -> None:
        self.optics, self.camera = optics, camera
        half = camera.window // 2
        line = np.asarray(optics.pixel * np.arange(-half, half + 1), dtype=np.float64)
        self.line = line
        self.reach = (half + 0.5) * optics.pixel + BORDER * optics.resolution
        area = collecting_area(optics)
        self.flux, self.second = (camera.electrons(area, m) for m in (camera.magnitude, camera.second_magnitude))
        self.fx, fy, self._response = self._spectrum(line, self.reach)
        self._turn_x = np.exp(2j * math.pi * np.outer(self.fx, line))
        self._turn_y = np.exp(2j * math.pi * np.outer(line, fy))
        still = self._spectrum(line, self.reach + (STILL_BORDER - BORDER) * optics.resolution)
        self._still = (-2j * math.pi * still[0], -2j * math.pi * still[1][:, None], still[2])
        still_x, still_y = (np.exp(2j * math.pi * np.outer(f, line)) for f in still[:2])
        both_x = np.hstack([still_x, -2j * math.pi * still[0][:, None] * still_x])
        # the real part of a product: of each complex number on the left its two parts follow one another
        self._both_x = np.stack([both_x.real, -both_x.imag], axis=1).reshape(-1, both_x.shape[1])
        self._both_y = np.vstack([still_y.T, -2j * math.pi * still[1] * still_y.T])

    def _spectrum(self, line: FloatArray, border: float) -> tuple[FloatArray, FloatArray, ComplexArray]:
        """Frequencies along x, not negative, and along y; image of a star at rest in the middle of a field."""
        grid = ImageGrid(self.optics, line, 2.0 * border)
        response = grid.spectrum(np.ones(len(grid.frequencies), complex), pixels=True)
        fx = grid.axis[len(grid.axis) // 2 :]
        twice = np.where(fx > 0.0, 2.0, 1.0)
        return fx, grid.axis, response[:, len(fx) - 1 :] * twice * (self.optics.pixel / grid.width) ** 2

    @property
    def background(self) -> float:
        """Electrons of the dark current in a pixel."""
        return self.camera.dark * self.camera.exposure

    def moved(self, places: FloatArray, weights: FloatArray) -> FloatArray:
        """Image of a star of energy 1 that was at some places for these parts of the time: (j, 2), (j,) -> (n, n)."""
        seen = np.where(np.abs(places).max(axis=1) < self.reach, weights, 0.0)  # others come from the next period
        powers = np.empty((len(self.fx), 2, len(places)), complex)  # at the frequencies 0, 1, 2 ... of the grid
        powers[0], powers[1:] = 1.0, np.exp(-2j * math.pi * self.fx[1] * places.T)
        np.multiply.accumulate(powers, axis=0, out=powers)
        x, half = powers[:, 0] * seen, powers[:, 1]
        y = np.concatenate([half[:0:-1].conj(), half])  # fy are fx and their negatives
        return np.asarray((self._turn_y @ (self._response * (y @ x.T)) @ self._turn_x).real)

    def still(self, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Image of a star of energy 1 at rest, and its derivatives by x and y [1/rad]: (2,) -> three (n, n)."""
        turns_x, turns_y, response = self._still
        spectrum = response * np.exp(turns_y * place[1])
        spectrum *= np.exp(turns_x * place[0])
        rows, n = self._both_y @ spectrum, len(self.line)
        found = rows.view(np.float64) @ self._both_x
        return found[:n, :n], found[:n, n:], found[n:, :n]

    def expected(self, path: FloatArray) -> FloatArray:
        """Mean electrons of each pixel in an exposure.

        Parameters
        ----------
        path : ndarray, shape (N + 1, 2)
            Of the line of sight from the middle of the window [rad], at equal times, straight between them.
        """
        places, weights = along(path)
        image = self.flux * self.moved(places, weights) + self.background
        if self.second:
            image += self.second * self.moved(places + np.array(self.camera.second_offset), weights)
        return np.maximum(image, 0.0)

    def read_out(self, expected: FloatArray, rng: np.random.Generator | None) -> FloatArray:
        """Counts of a frame: whole numbers, `OFFSET` without light.

        Parameters
        ----------
        expected : ndarray, shape (n, n)
            Mean electrons.
        rng : Generator or None
            None: no noise and no hits.
        """
        if rng is None:
            electrons = expected
        else:
            electrons = rng.poisson(expected).astype(float)
            hits = rng.poisson(self.camera.cosmic_rate * self.camera.exposure * expected.size)
            if hits:
                at = rng.integers(expected.size, size=hits)
                np.add.at(electrons.reshape(-1), at, rng.exponential(self.camera.cosmic_charge, hits))
        electrons = np.minimum(electrons, self.camera.full_well)
        if rng is not None:
            electrons = electrons + self.camera.read_noise * rng.standard_normal(expected.shape)
        return np.asarray(np.clip(np.rint(electrons + OFFSET), 0.0, 65535.0))
