"""Measured noise of a guide camera over the magnitude of its star, from many frames, as a file.

A file (JSON) holds where it is from (``command``, ``commit``, ``seed``, ``frames``) and ``curves``, each with its
``detector``: all that the noise depends on beside the magnitude. Between the measured magnitudes the ratio of noise and
bound of Cramer and Rao is interpolated linearly, and the bound is that of the magnitude itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number, load_json, read_text
from pointing_analysis.image.centroid import centroid, noise_equivalent_angle
from pointing_analysis.image.star_camera import StarCamera
from pointing_analysis.units import RAD_PER_MAS

NOT_OF_THE_NOISE = ("magnitude", "readout_delay", "second_offset_mas", "noise_curve")
"""Values of a camera that a curve is not tied to; the offset of the other star is an angle in rad there."""
KEPT = 0.5
"""Part of the frames that must have angles: of fainter stars there is no noise to be had."""
COLUMNS = ("magnitude", "noise_mas", "bound_mas", "without_angles")


def detector_of(camera: StarCamera) -> dict[str, Any]:
    """Parameters of the noise of a camera besides the magnitude; equal for cameras of equal noise.

    Examples
    --------
    >>> from pointing_analysis.image.guide_camera import GuideCamera
    >>> from pointing_analysis.image.optics import Optics
    >>> optics = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
    >>> stars = ((12.0, 10.0), (14.0, 10.0), (14.0, 0.0))
    >>> one, two, three = (detector_of(StarCamera(optics, GuideCamera(magnitude=m, dark=d))) for m, d in stars)
    >>> one == two, two == three
    (True, False)
    """
    optics, star = camera.optics, camera.camera.to_mapping()
    pupil = hashlib.sha256(optics.pupil_file).hexdigest() if optics.pupil_file else ""
    lens: dict[str, Any] = {"wavelength": optics.wavelength, "pixel": optics.pixel}
    lens |= {"diameter": 0.0 if pupil else optics.aperture_diameter, "obscuration": optics.obscuration}
    lens |= {"vanes": optics.spider_vanes, "vane_width": optics.spider_width, "pupil_sha256": pupil}
    values = {name: value for name, value in star.items() if name not in NOT_OF_THE_NOISE}
    return {**lens, **values, "second_offset": list(camera.camera.second_offset)}


@dataclass(frozen=True)
class NoisePoint:
    """Angles of many frames of one star.

    Parameters
    ----------
    magnitude : float
    noise : float
        Rms of their error over both axes [rad], of the frames with angles; NaN where none has some.
    bound : float
        Of Cramer and Rao [rad].
    without : float
        Part of the frames without angles.
    """

    magnitude: float
    noise: float
    bound: float
    without: float


def measure(camera: StarCamera, frames: int, seed: int) -> NoisePoint:
    """Centroids of a star at rest in as many frames as asked for, anywhere within the pixel in the middle.

    Parameters
    ----------
    camera : StarCamera
    frames, seed : int
        The random numbers of a magnitude do not depend on which others are measured.

    Examples
    --------
    >>> from pointing_analysis.image.guide_camera import GuideCamera
    >>> from pointing_analysis.image.optics import Optics
    >>> optics = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
    >>> point = measure(StarCamera(optics, GuideCamera(magnitude=12.0)), 100, seed=1)
    >>> 0.85 < point.noise / point.bound < 1.15, point.without
    (True, 0.0)
    """
    star = camera.camera
    key = round(1e6 * (star.magnitude + 100.0)), round(1e9 * star.exposure)
    rng, errors = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)), []
    for _ in range(frames):
        place = camera.optics.pixel * rng.uniform(-0.5, 0.5, 2)
        found = centroid(camera.read_out(camera.expected(np.tile(place, (2, 1))), rng), camera)
        if not found.reason:
            errors.append(found.place - place)
    noise = float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
    return NoisePoint(star.magnitude, noise, noise_equivalent_angle(camera), 1.0 - len(errors) / frames)


@dataclass(frozen=True)
class NoiseCurve:
    """Noise of a detector over the magnitude.

    Parameters
    ----------
    detector : mapping
        Of :func:`detector_of`.
    magnitude, noise, bound, without : ndarray, shape (n,)
        The first increasing; [rad]; see :class:`NoisePoint`.
    """

    detector: Mapping[str, Any]
    magnitude: FloatArray
    noise: FloatArray
    bound: FloatArray
    without: FloatArray

    @classmethod
    def of(cls, camera: StarCamera, points: Sequence[NoisePoint]) -> NoiseCurve:
        """From measured points; those of stars that too many frames do not see are left out.

        Raises
        ------
        ValueError
            Fewer than two are left.
        """
        kept = sorted((p for p in points if p.without <= 1.0 - KEPT), key=lambda p: p.magnitude)
        if len(kept) < 2:
            raise InputError(f"magnitudes must have two stars detected in half of the frames, got {len(kept)}")
        columns = (np.array([getattr(p, name) for p in kept]) for name in ("magnitude", "noise", "bound", "without"))
        return cls(detector_of(camera), *columns)

    def covers(self, magnitude: float) -> bool:
        """Whether the magnitude is between measured ones."""
        return bool(self.magnitude[0] <= magnitude <= self.magnitude[-1])

    def at(self, camera: StarCamera) -> float:
        """Noise of an angle of a frame [rad] for the guide star of a camera with this detector."""
        ratio = np.interp(camera.camera.magnitude, self.magnitude, self.noise / self.bound)
        return float(ratio) * noise_equivalent_angle(camera)

    def to_mapping(self) -> dict[str, Any]:
        """For a file."""
        scaled = (self.magnitude, self.noise / RAD_PER_MAS, self.bound / RAD_PER_MAS, self.without)
        table = {name: [float(f"{x:.7g}") for x in values] for name, values in zip(COLUMNS, scaled)}
        return {"detector": dict(self.detector), **table}


def to_text(curves: Sequence[NoiseCurve], provenance: Mapping[str, Any]) -> str:
    """Content of a file."""
    return json.dumps({**provenance, "curves": [curve.to_mapping() for curve in curves]}, indent=1) + "\n"


def load_curves(path: Path) -> tuple[NoiseCurve, ...]:
    """Read a file.

    Raises
    ------
    ValueError
        It cannot be read or holds no curves, one line.
    """
    content = load_json(read_text(path), path)
    try:
        return tuple(_curve(entry) for entry in content["curves"])
    except (KeyError, TypeError, ValueError) as error:
        reason = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path} must hold curves of examples/guide_camera_noise.py, got {reason}") from None


def _curve(entry: Mapping[str, Any]) -> NoiseCurve:
    """A curve of a file; KeyError, TypeError or ValueError: it is none."""
    columns = [entry[name] for name in COLUMNS]
    if not all(isinstance(column, list) and all(map(is_number, column)) for column in columns):
        raise InputError(f"values that are not numbers in {', '.join(COLUMNS)}")
    if len({len(column) for column in columns}) != 1 or len(columns[0]) < 2:
        raise InputError("columns of different length, or fewer than two magnitudes")
    magnitude, noise, bound, without = (np.array(column, dtype=float) for column in columns)
    if any(b <= a for a, b in pairwise(magnitude)) or not (noise > 0.0).all() or not (bound > 0.0).all():
        raise InputError("magnitudes that do not increase, or a noise that is not positive")
    return NoiseCurve(dict(entry["detector"]), magnitude, noise * RAD_PER_MAS, bound * RAD_PER_MAS, without)


def curve_for(camera: StarCamera, curves: Sequence[NoiseCurve]) -> NoiseCurve | None:
    """The curve of the detector of a camera; None where there is none."""
    detector = detector_of(camera)
    return next((curve for curve in curves if curve.detector == detector), None)
