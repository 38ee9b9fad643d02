"""The guide camera of a telescope as numbers: star, exposure, detector.

A table ``[camera]`` of the telescope's parameter file; its pixels are those of ``[optics]``::

    [camera]
    magnitude = 14.0             # of the guide star
    zero_magnitude_flux = 8.8e9  # photons/(s m2) of magnitude 0 in the camera's band
    throughput = 0.5             # electrons per photon at the aperture, for any colour
    exposure = 0.02              # s, whole ticks
    readout_delay = 0.002        # s, from the end of the exposure to the tick at which the angles are there
    window = 15                  # pixels along each axis, odd
    read_noise = 3.0             # electrons
    dark = 10.0                  # electrons/s of a pixel
    full_well = 50000.0          # electrons
    cosmic_rate = 5e-6           # hits/s of a pixel
    cosmic_charge = 2000.0       # electrons, mean of a hit
    second_magnitude = 99.0      # of another star; 99: none
    second_offset_mas = [300.0, 0.0]
    centroid = "maximum_likelihood"   # or "moments"
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.pupil import PixelPupil
from pointing_analysis.units import RAD_PER_MAS

METHODS = ("maximum_likelihood", "moments")
OFFSET = 100
"""Bias of a pixel [counts]: the read noise must not be clipped at zero. One count is one electron."""
NO_STAR = 99.0
"""Magnitude that means no star."""
MOST_COUNTS = 60_000
"""Largest full well: with offset and noise it is below the 65535 of a pixel of 16 bit."""
WINDOWS = 7, 63


@dataclass(frozen=True)
class GuideCamera:
    """Star, exposure and detector of a guide camera.

    Parameters
    ----------
    magnitude : float
        Of the guide star.
    zero_magnitude_flux : float
        Of magnitude 0 in the camera's band [photons/(s m2)].
    throughput : float
        Electrons per photon at the aperture.
    exposure, readout_delay : float
        [s]. **Angles are there `readout_delay` after the end of the exposure that they are the mean of.**
    window : int
        Pixels along each axis, odd.
    read_noise : float
        [electrons].
    dark : float
        [electrons/s] of a pixel.
    full_well : float
        [electrons].
    cosmic_rate, cosmic_charge : float
        Hits of a pixel [1/s], mean charge of a hit [electrons], which is exponentially distributed, in one pixel.
    second_magnitude : float
        Of another star in the field; 99 for none.
    second_offset : (float, float)
        Its place from the guide star [rad].
    centroid : {"maximum_likelihood", "moments"}

    Examples
    --------
    >>> camera = GuideCamera(magnitude=14.0, exposure=0.02)
    >>> round(camera.electrons(1.608, camera.magnitude))
    355
    """

    magnitude: float = 14.0
    zero_magnitude_flux: float = 8.8e9
    throughput: float = 0.5
    exposure: float = 0.02
    readout_delay: float = 0.002
    window: int = 15
    read_noise: float = 3.0
    dark: float = 10.0
    full_well: float = 50_000.0
    cosmic_rate: float = 5e-6
    cosmic_charge: float = 2000.0
    second_magnitude: float = NO_STAR
    second_offset: tuple[float, float] = (0.0, 0.0)
    centroid: str = METHODS[0]

    def electrons(self, area: float, magnitude: float) -> float:
        """Electrons of a star in an exposure, of all its light.

        Parameters
        ----------
        area : float
            Of the aperture [m2].
        magnitude : float
        """
        if magnitude >= NO_STAR:
            return 0.0
        photons = self.zero_magnitude_flux * math.pow(10.0, -0.4 * magnitude) * area * self.exposure
        return photons * self.throughput

    @property
    def floor_variance(self) -> float:
        """Variance of a pixel without light [electrons2]: read noise, dark current, whole counts."""
        return self.read_noise**2 + self.dark * self.exposure + 1.0 / 12.0


NUMBERS = {
    "magnitude": (-30.0, NO_STAR, "above -30 and below 99"),
    "zero_magnitude_flux": (0.0, math.inf, "above 0 photons/(s m2)"),
    "throughput": (0.0, 1.0 + 1e-12, "above 0, at most 1"),
    "exposure": (0.0, math.inf, "above 0 s"),
    "readout_delay": (-1e-300, math.inf, "0 s or more"),
    "read_noise": (-1e-300, 1000.0, "from 0 to 1000 electrons"),
    "dark": (-1e-300, math.inf, "0 electrons/s or more"),
    "full_well": (100.0, MOST_COUNTS + 1e-9, f"above 100, at most {MOST_COUNTS} electrons"),
    "cosmic_rate": (-1e-300, math.inf, "0 hits/s or more"),
    "cosmic_charge": (0.0, math.inf, "above 0 electrons"),
    "second_magnitude": (-30.0, NO_STAR + 1e-9, "above -30, at most 99"),
}
"""Range of each number (both ends excluded), and the range in words."""


def from_mapping(table: Mapping[str, Any], where: str) -> GuideCamera:
    """Camera from a table.

    Parameters
    ----------
    table : mapping of the keys above
    where : name of the file, for the messages

    Raises
    ------
    InputError
        A key that is missing or unknown, a value out of its range.
    """
    known = (*NUMBERS, "window", "second_offset_mas", "centroid")
    if odd := sorted(set(table) ^ set(known)):
        raise InputError(f"{where}: keys of camera must be {', '.join(known)}, got other keys: {', '.join(odd)}")
    values: dict[str, Any] = {}
    for key, (low, high, words) in NUMBERS.items():
        if not is_number(table[key]) or not low < table[key] < high:
            raise InputError(f"{where}: camera.{key} must be {words}, got {table[key]!r}")
        values[key] = float(table[key])
    window, offset, method = table["window"], table["second_offset_mas"], table["centroid"]
    least, most = WINDOWS
    if isinstance(window, bool) or not isinstance(window, int) or not least <= window <= most or window % 2 == 0:
        raise InputError(f"{where}: camera.window must be an odd number from {least} to {most}, got {window!r}")
    if not isinstance(offset, (list, tuple)) or len(offset) != 2 or not all(map(is_number, offset)):
        raise InputError(f"{where}: camera.second_offset_mas must be two numbers, got {offset!r}")
    if method not in METHODS:
        raise InputError(f"{where}: camera.centroid must be {' or '.join(METHODS)}, got {method!r}")
    x, y = (float(value) * RAD_PER_MAS for value in offset)
    return GuideCamera(**values, window=window, second_offset=(x, y), centroid=method)


def collecting_area(optics: Optics) -> float:
    """Area of the aperture that transmits [m2]; of a pupil file the sum of its intensities.

    Examples
    --------
    >>> round(collecting_area(Optics(550e-9, 38 * RAD_PER_MAS, 1.5, 0.3)), 3)
    1.608
    """
    pupil = optics.pupil
    if isinstance(pupil, PixelPupil):
        return float((abs(pupil.amplitude) ** 2).sum()) * pupil.scale**2
    return math.pi / 4.0 * optics.diameter**2 * (1.0 - optics.obscuration**2)
