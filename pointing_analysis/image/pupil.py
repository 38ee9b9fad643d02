r"""Pupils and their diffraction: the optical transfer function is the autocorrelation of the pupil.

At the spatial frequency f [cycles/rad] the pupil is shifted against itself by :math:`s = \lambda f` [m]:

.. math:: O(f) = \int P(r)\, P^*(r - \lambda f)\, d^2r \Big/ \int |P(r)|^2\, d^2r

Closed forms: of the circle :math:`(2/\pi)(\arccos\nu - \nu\sqrt{1-\nu^2})`, :math:`\nu = |f| \lambda / D`; of the
annulus (O'Neill 1956) areas that two circles have in common. A pupil of square pixels has an autocorrelation that is
exactly the bilinear interpolation of the one at whole pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import ComplexArray, FloatArray

RASTER = 512
"""Pixels across an aperture with a spider."""
SUPERSAMPLING = 4
"""Points per pixel and axis by which the edge of such an aperture is weighted."""


def _common_area(a: float, b: float, distance: FloatArray) -> FloatArray:
    """Area that two circles of radii a >= b have in common, by the distance of their centres."""
    d = np.clip(distance, a - b, a + b)
    # half angles by their tangents: arc cosines would lose half of the digits where the circles touch
    near, far = np.maximum(a + b - d, 0.0), a + b + d
    of_a = 2 * np.arctan2(np.sqrt(near * (d + b - a)), np.sqrt((d + a - b) * far))
    of_b = 2 * np.arctan2(np.sqrt(near * (d + a - b)), np.sqrt((d + b - a) * far))
    kite = np.sqrt(near * (d + b - a) * (d + a - b) * far)
    area = a**2 * of_a + b**2 * of_b - 0.5 * kite
    inside, apart = distance <= a - b, distance >= a + b
    return np.where(inside, math.pi * b**2, np.where(apart, 0.0, area))


@dataclass(frozen=True)
class AnnularPupil:
    """A circular aperture with a central obscuration.

    Parameters
    ----------
    diameter : float
        [m].
    obscuration : float
        Diameter of the obscuration over that of the aperture, 0 for a full circle.

    Examples
    --------
    At half of the cutoff a circle transmits 39 %, the obscuration takes from that:

    >>> shift = np.array([[0.75, 0.0]])
    >>> [float(AnnularPupil(1.5, e).autocorrelation(shift)[0].real.round(4)) for e in (0.0, 0.3)]
    [0.391, 0.3371]
    """

    diameter: float
    obscuration: float = 0.0

    @property
    def extent(self) -> float:
        """Largest shift with an overlap [m]."""
        return self.diameter

    @property
    def breaks(self) -> tuple[float, ...]:
        """Distances at which a circle begins or ceases to overlap the other one."""
        e = self.obscuration
        return tuple(sorted({e, (1 - e) / 2, (1 + e) / 2, 1.0} - {0.0})) if e else (0.5, 1.0)

    @property
    def angles(self) -> int:
        """A circle does not vary; the square pixels behind it do."""
        return 8

    @property
    def in_phase(self) -> bool:
        """No aberrations."""
        return True

    def autocorrelation(self, shift: FloatArray) -> ComplexArray:
        """Closed form: (..., 2) [m] -> (...)."""
        outer, inner = self.diameter / 2, self.diameter * self.obscuration / 2
        d = np.hypot(shift[..., 0], shift[..., 1])
        area = _common_area(outer, outer, d)
        if inner:
            area = area + _common_area(inner, inner, d) - 2 * _common_area(outer, inner, d)
        return np.asarray(area / (math.pi * (outer**2 - inner**2)), dtype=complex)


@dataclass(frozen=True)
class PixelPupil:
    """Any aperture as square pixels, each with a complex amplitude.

    Parameters
    ----------
    amplitude : ndarray, shape (n, m)
        Rows along y, columns along x.
    scale : float
        [m] of a pixel.

    Raises
    ------
    ValueError
        No picture, nothing that transmits, values that are not finite.
    """

    amplitude: ComplexArray
    scale: float

    def __post_init__(self) -> None:
        a = self.amplitude
        if a.ndim != 2 or min(a.shape) < 2:
            raise InputError(f"pupil must be a picture of 2 x 2 pixels or more, got the shape {a.shape}")
        if not np.isfinite(a).all():
            raise InputError(f"pupil must be finite, got {int((~np.isfinite(a)).sum())} pixels that are not")
        if not np.abs(a).max() > 0.0:
            raise InputError("pupil must transmit somewhere, got zeros only")
        if not 0.0 < self.scale < math.inf:
            raise InputError(f"scale of the pupil must be positive [m], got {self.scale:g}")

    @cached_property
    def _support(self) -> ComplexArray:
        """The part that transmits."""
        rows, columns = (np.flatnonzero(np.abs(self.amplitude).any(axis=axis)) for axis in (1, 0))
        return self.amplitude[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    @cached_property
    def extent(self) -> float:
        """Greatest width of the part that transmits, over all directions [m]."""
        rows, columns = np.nonzero(np.abs(self._support))
        angles = np.arange(0.0, math.pi, math.pi / 180)
        along = np.outer(np.cos(angles), columns) + np.outer(np.sin(angles), rows)
        widths = np.ptp(along, axis=1) + np.abs(np.cos(angles)) + np.abs(np.sin(angles))
        return float(widths.max()) * self.scale

    @property
    def breaks(self) -> tuple[float, ...]:
        """No closed form: the axis in eight parts."""
        return tuple((i + 1) / 8 for i in range(8))

    @property
    def angles(self) -> int:
        """Enough for narrow vanes."""
        return 64

    @cached_property
    def in_phase(self) -> bool:
        """Whether no pixel has a phase."""
        return bool(np.all(self.amplitude.imag == 0.0) and np.all(self.amplitude.real >= 0.0))

    @cached_property
    def _at_pixels(self) -> ComplexArray:
        """Autocorrelation at whole pixels, zero shift in the middle, a border of zeros about it."""
        from scipy import fft

        a = self._support
        shape = [2 * n + 1 for n in a.shape]
        fast = [fft.next_fast_len(n) for n in shape]
        spectrum = fft.fft2(a, s=fast)
        found = np.roll(fft.ifft2(np.abs(spectrum) ** 2), [n // 2 for n in shape], axis=(0, 1))[: shape[0], : shape[1]]
        return np.asarray(found / np.sum(np.abs(a) ** 2), dtype=complex)

    def autocorrelation(self, shift: FloatArray) -> ComplexArray:
        """Bilinear between whole pixels, which is exact: (..., 2) [m] -> (...)."""
        table = self._at_pixels
        place = [shift[..., k] / self.scale + table.shape[1 - k] // 2 for k in (1, 0)]
        low = [np.clip(np.floor(p).astype(int), 0, n - 2) for p, n in zip(place, table.shape)]
        part = [p - i for p, i in zip(place, low)]
        beyond = (part[0] < 0) | (part[0] > 1) | (part[1] < 0) | (part[1] > 1)
        found = sum(
            (part[0] if i else 1 - part[0]) * (part[1] if j else 1 - part[1]) * table[low[0] + i, low[1] + j]
            for i in (0, 1)
            for j in (0, 1)
        )
        return np.asarray(np.where(beyond, 0.0, found), dtype=complex)


Pupil = AnnularPupil | PixelPupil
"""An aperture: its extent and its autocorrelation."""


def with_spider(diameter: float, obscuration: float, vanes: int, width: float) -> PixelPupil:
    """Annular aperture with the vanes of a spider, the first along +x, all from the obscuration to the edge.

    Parameters
    ----------
    diameter : [m]
    obscuration : of the diameter
    vanes : their number
    width : of a vane [m]
    """
    if not 0.0 <= width < diameter / 2:
        raise InputError(f"spider_width must be at least 0 and below half of the aperture, got {width:g} m")
    fine = RASTER * SUPERSAMPLING
    line = (np.arange(fine) + 0.5 - fine / 2) * (diameter / fine)
    x, y = line[None, :], line[:, None]
    radius = np.hypot(x, y)
    free = (radius <= diameter / 2) & (radius >= obscuration * diameter / 2)
    for k in range(vanes):
        c, s = math.cos(2 * math.pi * k / vanes), math.sin(2 * math.pi * k / vanes)
        free &= ~((c * x + s * y > 0) & (np.abs(c * y - s * x) < width / 2))
    grey = free.reshape(RASTER, SUPERSAMPLING, RASTER, SUPERSAMPLING).mean(axis=(1, 3))
    return PixelPupil(np.asarray(grey, dtype=complex), diameter / RASTER)
