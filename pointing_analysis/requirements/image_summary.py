"""Figures of the star's image of a run with known optics, for the tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pointing_analysis.arrays import FloatArray
from pointing_analysis.formatting.number_text import percent
from pointing_analysis.image.motion_blur import some_exposures, worst_transfer
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quality import figures
from pointing_analysis.indices.errors import RAD_PER_MAS, ErrorSeries
from pointing_analysis.requirements.exposure import quantile_key
from pointing_analysis.requirements.image_samples import share

MOST = 1000
"""Exposures of a run that the figures are made of, spread evenly over it; requirements use all."""


@dataclass(frozen=True)
class ImageSummary:
    """Values that a part of the exposures keeps, each for itself.

    Parameters
    ----------
    optics : in words
    exposure : [s]
    exposures : number that was used
    part : of the exposures, between 0 and 1
    mtf : of the motion at the Nyquist frequency of the pixels, along the worst direction; at least
    mtf_half : the same at half of that frequency
    strehl : Strehl ratio of the motion; at least
    ee80 : radius of 80 % of the energy [mas]; at most
    ellipticity : at most
    """

    optics: str
    exposure: float
    exposures: int
    part: float
    mtf: float
    mtf_half: float
    strehl: float
    ee80: float
    ellipticity: float

    @classmethod
    def of(cls, paths: FloatArray, optics: Optics, exposure: float, part: float) -> ImageSummary:
        """Of exposures (m, N + 1, 2) [rad], at least one, none with a missing sample."""
        star = figures(paths, optics, ("strehl", "ee80", "ellipticity"))
        mtf, half = (worst_transfer(paths, times * optics.nyquist)[0] for times in (1.0, 0.5))
        return cls(
            optics.text,
            exposure,
            len(paths),
            part,
            share(mtf, part, lower=True),
            share(half, part, lower=True),
            share(star["strehl"], part, lower=True),
            share(star["ee80"], part, lower=False) / RAD_PER_MAS,
            share(star["ellipticity"], part, lower=False),
        )

    @property
    def rows(self) -> tuple[tuple[str, float, str, str], ...]:
        """Name, value, unit and judged quantity of each figure."""
        window, part = f"{1e3 * self.exposure:g} ms", percent(self.part, 10)
        return (
            (f"MTF at Nyquist, {part}", self.mtf, "", f"MTF({window}, Nyquist), {part}"),
            (f"Strehl ratio of the motion, {part}", self.strehl, "", f"Strehl({window}), {part}"),
            (f"EE80 radius, {part}", self.ee80, "mas", f"EE80({window}), {part}"),
            (f"ellipticity, {part}", self.ellipticity, "", f"ellipticity({window}), {part}"),
        )

    def as_dict(self, number: Any) -> dict[str, Any]:
        """Values for JSON, each through `number`."""
        names = ("mtf", "mtf_half", "strehl", "ee80", "ellipticity")
        keys = ("mtf_nyquist", "mtf_half_nyquist", "strehl", "ee80_mas", "ellipticity")
        values = {f"{key}_{quantile_key(self.part)}": number(getattr(self, name)) for name, key in zip(names, keys)}
        return {"optics": self.optics, "exposure_s": self.exposure, "exposures": self.exposures, **values}


@dataclass(frozen=True, eq=False)
class StarExposures:
    """Exposures of a star in a run, whose figures are computed when they are asked for first.

    Most of the time that a short run takes to summarise goes into them, and not everybody asks. Equal are those with
    equal figures.

    Parameters
    ----------
    paths : ndarray, shape (m, N + 1, 2)
        [rad], at most `MOST`, none with a missing sample.
    optics : Optics
    exposure : float
        [s]
    part : float
        Of the exposures that keeps the figures.
    """

    paths: FloatArray
    optics: Optics
    exposure: float
    part: float

    @classmethod
    def of(cls, series: ErrorSeries, optics: Optics, exposure: float, part: float) -> StarExposures | None:
        """Of an error series; None where no exposure is complete.

        Raises
        ------
        ValueError
            The exposure is no whole number of samples, or longer than the run.
        """
        paths, _ = some_exposures(series.values, series.dt, exposure, MOST)
        return cls(paths, optics, exposure, part) if len(paths) else None

    @cached_property
    def figures(self) -> ImageSummary:
        """Their figures."""
        return ImageSummary.of(self.paths, self.optics, self.exposure, self.part)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StarExposures) and self.figures == other.figures

    def __hash__(self) -> int:
        return hash((len(self.paths), self.exposure))
