"""The image of a star, or of a pattern, by aperture, motion and pixels; its width at half maximum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pointing_analysis.arrays import BoolArray, ComplexArray, FloatArray
from pointing_analysis.image.motion_blur import centred, clipped_transfer, sizes
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quadrature import Quadrature

WINGS = 24.0
"""[wavelength over aperture] Empty border about a star's image: what the wings beyond it hold is folded back in."""


def mean_transfer(paths: FloatArray, frequencies: FloatArray, reach: float = math.inf) -> ComplexArray:
    """Transfer of the motion, mean over exposures that are laid on each other by their means: (m, N + 1, 2) -> (f,).

    What the star does farther than `reach` [rad] from the mean along either axis is left out.
    """
    total = np.zeros(len(frequencies), dtype=complex)
    for path in centred(paths):
        total += clipped_transfer(path, frequencies, reach)
    return np.asarray(total / len(paths))


@dataclass(frozen=True)
class ImageGrid:
    """Spatial frequencies that an image is the sum of: all that the aperture transmits, in steps of 1 / width.

    Parameters
    ----------
    optics : Optics
    line : ndarray, shape (n,)
        Places of the image along each axis [rad].
    width : float
        Of the field [rad], beyond which the image repeats itself.
    """

    optics: Optics
    line: FloatArray
    width: float

    @cached_property
    def axis(self) -> FloatArray:
        """Frequencies along each axis, shape (m,), zero in the middle [cycles/rad]."""
        count = math.ceil(self.optics.cutoff * self.width)
        return np.asarray(np.arange(-count, count + 1) / self.width)

    @cached_property
    def _inside(self) -> tuple[BoolArray, FloatArray]:
        f = np.stack(np.meshgrid(self.axis, self.axis), axis=-1)
        inside = np.hypot(f[..., 0], f[..., 1]) < self.optics.cutoff
        return inside, f[inside]

    @property
    def frequencies(self) -> FloatArray:
        """Those that the aperture transmits, shape (k, 2) [cycles/rad]."""
        return self._inside[1]

    def spectrum(self, transfer: ComplexArray, pixels: bool) -> ComplexArray:
        """Spectrum of the image, rows along y, of a transfer of the motion at `frequencies`: (k,) -> (m, m)."""
        inside, chosen = self._inside
        found = np.zeros(inside.shape, dtype=complex)
        found[inside] = self.optics.diffraction(chosen) * transfer
        if pixels:
            found[inside] *= self.optics.detector(chosen)
        return found


def star_image(
    paths: FloatArray, optics: Optics, *, half: int, step: float | None = None, pixels: bool = True
) -> FloatArray:
    """Image of a star of energy 1.

    Parameters
    ----------
    paths : (m, N + 1, 2) [rad], one exposure or several that are laid on each other by their means
    optics : Optics
    half : the image has 2 half + 1 places along each axis, its middle at the mean position
    step : distance of the places [rad]; default: a pixel
    pixels : whether the light is averaged over a pixel about each place; then the values are energies of pixels

    Returns
    -------
    (2 half + 1, 2 half + 1) energy per pixel of the detector; rows along y, columns along x

    Examples
    --------
    >>> from pointing_analysis.units import RAD_PER_MAS
    >>> optics = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
    >>> still = star_image(np.zeros((1, 2, 2)), optics, half=20)
    >>> float(still.sum().round(2)), float(still.max().round(2))
    (0.98, 0.16)
    """
    apart = optics.pixel if step is None else step
    line = np.asarray(apart * np.arange(-half, half + 1), dtype=np.float64)
    reach = half * apart + WINGS * optics.resolution  # a star farther away leaves only its wings in the image
    width = 2 * (min(float(sizes(paths).max()), reach) + reach)
    grid = ImageGrid(optics, line, width)
    spectrum = grid.spectrum(mean_transfer(paths, grid.frequencies, reach), pixels)
    turn = np.exp(2j * math.pi * np.outer(line, grid.axis))
    return np.asarray((turn @ spectrum @ turn.T).real * (optics.pixel / width) ** 2)


def blurred(pattern: FloatArray, step: float, paths: FloatArray, optics: Optics) -> FloatArray:
    """A pattern of light as the detector's pixels see it, on the pattern's own grid and periodic beyond its edge.

    Parameters
    ----------
    pattern : (n, m), rows along y
    step : distance of its points [rad]
    paths : (k, N + 1, 2) [rad]
    """
    from scipy import fft

    fy, fx = (fft.fftfreq(n, step) for n in pattern.shape)
    f = np.stack(np.meshgrid(fx, fy), axis=-1)
    inside = np.hypot(f[..., 0], f[..., 1]) < optics.cutoff
    transfer = np.zeros(pattern.shape, dtype=complex)
    chosen = f[inside]
    transfer[inside] = optics.diffraction(chosen) * optics.detector(chosen) * mean_transfer(paths, chosen)
    return np.asarray(fft.ifft2(fft.fft2(pattern) * transfer).real)


def widths(paths: FloatArray, optics: Optics, directions: int = 36) -> tuple[float, float]:
    """Full width at half maximum of the star's image with the pixel: smallest and largest over directions [rad].

    Examples
    --------
    A circular aperture has 1.029 times wavelength over aperture:

    >>> small, large = widths(np.zeros((1, 2, 2)), Optics(wavelength=550e-9, pixel_mas=1e-3, aperture_diameter=1.5))
    >>> round(large / (550e-9 / 1.5), 3)
    1.029
    """
    from scipy import optimize

    from pointing_analysis.image.quality import peak_of

    reach = float(sizes(paths).max()) + 4.0 * optics.resolution + 2.0 * optics.pixel
    q = Quadrature.of(optics, 2 * math.pi * optics.cutoff * 2.0 * reach)
    spectrum = q.image * mean_transfer(paths, q.frequencies)
    top, place = peak_of(q, spectrum, centred(paths)[0])

    def above(distance: float, angle: float) -> float:
        at = place + distance * np.array([math.cos(angle), math.sin(angle)])
        return float(q.over_plane(spectrum * np.exp(2j * math.pi * (q.frequencies @ at)))) - 0.5 * top

    def edge(angle: float) -> float:
        step = 0.1 * optics.resolution
        far = step
        while above(far, angle) > 0.0 and far < 2.0 * reach:
            far += step
        return float(optimize.brentq(above, far - step, far, args=(angle,), xtol=1e-12 * reach))

    found = [edge(angle) + edge(angle + math.pi) for angle in (math.pi * k / directions for k in range(directions))]
    return min(found), max(found)
