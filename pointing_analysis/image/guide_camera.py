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
    noise_curve = ""             # file of measured noise of this detector
"""

from __future__ import annotations

import math

from pydantic.dataclasses import dataclass

from pointing_analysis.files.settings import POSITIVE, STRICT, CheckedTable, Excluded, Refused, setting, settings_class
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


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class GuideCamera(CheckedTable):
    """Star, exposure and detector of a guide camera: the keys of the table.

    **Angles are there `readout_delay` after the end of the exposure that they are the mean of.** The charge of a cosmic
    hit is exponentially distributed, in one pixel.

    Raises
    ------
    InputError
        A value out of its range.

    Examples
    --------
    >>> camera = GuideCamera(magnitude=14.0, exposure=0.02)
    >>> round(camera.electrons(1.608, camera.magnitude))
    355
    """

    magnitude: float = setting(14.0, "magnitude of the guide star", "", Excluded(-30.0), Excluded(NO_STAR))
    zero_magnitude_flux: float = setting(
        8.8e9, "photons of magnitude 0 in the camera's band", "photons/(s m2)", POSITIVE
    )
    throughput: float = setting(0.5, "electrons per photon at the aperture", "", POSITIVE, 1.0)
    exposure: float = setting(0.02, "exposure", "s", POSITIVE)
    readout_delay: float = setting(0.002, "time from the end of the exposure to the angles", "s", 0.0)
    window: int = setting(15, "pixels along each axis, odd", "pixels", *WINDOWS)
    read_noise: float = setting(3.0, "read noise", "electrons", 0.0, 1000.0)
    dark: float = setting(10.0, "dark current of a pixel", "electrons/s", 0.0)
    full_well: float = setting(50_000.0, "full well", "electrons", Excluded(100.0), MOST_COUNTS)
    cosmic_rate: float = setting(5e-6, "cosmic hits of a pixel", "1/s", 0.0)
    cosmic_charge: float = setting(2000.0, "mean charge of a cosmic hit", "electrons", POSITIVE)
    second_magnitude: float = setting(
        NO_STAR, "magnitude of another star in the field; 99 for none", "", Excluded(-30.0), NO_STAR
    )
    second_offset_mas: tuple[float, ...] = setting((0.0, 0.0), "its place from the guide star", "mas", length=2)
    centroid: str = setting(METHODS[0], "method of the angles", choices=METHODS)
    noise_curve: str = setting("", "file of measured noise of this detector")

    def __post_init__(self) -> None:
        if self.window % 2 == 0:
            raise Refused("window", f"must be odd and {self.SETTINGS['window'].range}, got {self.window}")

    @property
    def second_offset(self) -> tuple[float, float]:
        """Place of the other star from the guide star [rad]."""
        x, y = (value * RAD_PER_MAS for value in self.second_offset_mas)
        return x, y

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


def collecting_area(optics: Optics) -> float:
    """Area of the aperture that transmits [m2]; of a pupil file the sum of its intensities.

    Examples
    --------
    >>> round(collecting_area(Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)), 3)
    1.608
    """
    pupil = optics.aperture
    if isinstance(pupil, PixelPupil):
        return float((abs(pupil.amplitude) ** 2).sum()) * pupil.scale**2
    return math.pi / 4.0 * pupil.extent**2 * (1.0 - optics.obscuration**2)
