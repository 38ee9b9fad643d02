"""The guide camera in the model of the loop: low-pass and noise from exposure and star, where they are not given.

``sensors.camera`` of a parameter file selects the camera:

============  ====================================================================================================
vector        low-pass ``camera_filter`` and noise ``camera_noise`` as given: the paper's camera
magnitude     the same kind of measurement with the low-pass and the noise of the table ``camera``
image         frames with a star (:mod:`pointing_analysis.image.star_camera`); model of the loop as for magnitude
============  ====================================================================================================

The angles of a frame are the mean of the line of sight over the exposure T and are there a time d after its end::

    e^(-s d) (1 - e^(-s T)) / (s T)  =  1 - a s + (d^2 / 2 + d T / 2 + T^2 / 6) s^2 - ...,   a = d + T / 2
    c0 / (s^2 + c1 s + c0),  c0 = 1 / b,  c1 = a / b,  b = a^2 - (d^2 / 2 + d T / 2 + T^2 / 6)

The low-pass agrees in all terms up to s^2. The noise is that of a measured curve over the magnitude
(:mod:`pointing_analysis.image.noise_curve`): the file that ``noise_curve`` names; else ``camera_noise.json``, where it
has one of this detector, and for other detectors the Cramer-Rao bound (``docs/image_quality.md``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.errors import InputError
from pointing_analysis.image.guide_camera import GuideCamera
from pointing_analysis.image.optics import ImageOptics, from_mapping, read_pupil_file
from titop_plant.interface import DT, RATE
from titop_plant.telescope.tables.parameter_check import ParameterFile

if TYPE_CHECKING:
    from pointing_analysis.image.star_camera import StarCamera

VECTOR, MAGNITUDE, IMAGE = CAMERAS = ("vector", "magnitude", "image")
TABLE, KIND = "camera", "camera"
"""Name of the table; key of the table ``sensors`` that selects the camera."""
NOISE_CURVE = "noise_curve"
"""Key of the table for the file of measured noise."""
STORED_CURVES = Path(__file__).with_name("camera_noise.json")
"""Measured noise of the reference telescope's detector."""
FOLLOWING = ("camera_filter", "camera_noise")
"""Keys of ``sensors`` that follow from the table unless the camera is a vector."""
IMAGE_OPTICS = tuple(ImageOptics.SETTINGS)
"""Values of ``optics`` that only an image needs: they are in no plant and no design, so not in the hash either."""


def exposure_low_pass(exposure: float, delay: float) -> tuple[float, float, float]:
    """Low-pass ``c0 / (s^2 + c1 s + c2)`` of the mean over an exposure that is there a time after its end.

    Parameters
    ----------
    exposure, delay : float
        [s].

    Examples
    --------
    The mean over 20 ms that is there 2 ms later is 12 ms old:

    >>> c0, c1, c2 = exposure_low_pass(0.02, 0.002)
    >>> round(1e3 * c1 / c2, 9), c0 == c2
    (12.0, True)
    """
    age = delay + 0.5 * exposure
    b = age**2 - (0.5 * delay**2 + 0.5 * delay * exposure + exposure**2 / 6.0)
    return 1.0 / b, age / b, 1.0 / b


def whole_ticks(value: float) -> int | None:
    """Ticks of a time [s]; None if they are not whole.

    Examples
    --------
    >>> whole_ticks(0.02), whole_ticks(0.0205)
    (20, None)
    """
    if not math.isfinite(value * RATE):
        return None
    ticks = round(value * RATE)
    return ticks if math.isclose(ticks * DT, value, rel_tol=1e-9, abs_tol=1e-12) else None


def star_camera(optics: ImageOptics, camera: GuideCamera, where: str) -> StarCamera:
    """The camera that makes images.

    Parameters
    ----------
    optics : ImageOptics
    camera : GuideCamera
    where : str
        Name of the file, for the messages.

    Raises
    ------
    ValueError
        Optics that make no image, one line.
    """
    from pointing_analysis.image.star_camera import StarCamera

    pupil = read_pupil_file(Path(optics.pupil)) if optics.pupil else b""
    return StarCamera(from_mapping(optics.to_mapping(), where, pupil), camera)


def star_noise(camera: StarCamera, file: str, where: str) -> float:
    """Noise of an angle of a frame [rad], from a measured curve where there is one.

    Parameters
    ----------
    camera : StarCamera
    file : str
        Of the measured noise; empty: the stored one, and the Cramer-Rao bound where it does not have this
        detector or magnitude.
    where : str
        Name of the parameter file, for the messages.

    Raises
    ------
    ValueError
        A named file that cannot be read, or that has no such detector or magnitude.
    """
    from pointing_analysis.image.centroid import noise_equivalent_angle
    from pointing_analysis.image.noise_curve import curve_for, load_curves

    curve, magnitude = curve_for(camera, load_curves(Path(file or STORED_CURVES))), camera.camera.magnitude
    if curve is not None and curve.covers(magnitude):
        return curve.at(camera)
    if not file:
        return noise_equivalent_angle(camera)
    if curve is None:
        raise InputError(f"{where}: {TABLE}.{NOISE_CURVE} must have a curve of this detector, got none in {file}")
    low, high = curve.magnitude[0], curve.magnitude[-1]
    raise InputError(
        f"{where}: {TABLE}.magnitude must be from {low:g} to {high:g} with {NOISE_CURVE} {file}, got {magnitude:g}"
    )


def with_guide_camera(tables: dict[str, Any], content: Mapping[str, Any], file: ParameterFile) -> dict[str, Any]:
    """The tables with low-pass and noise of the camera as that of the camera makes them.

    Parameters
    ----------
    tables : mapping
        Merged with the reference.
    content : mapping
        Content of the file.
    file : ParameterFile

    Raises
    ------
    ValueError
        Another kind of camera, a low-pass or a noise that is given beside the table, a table that cannot be used.
    """
    kind = tables["sensors"][KIND]
    if kind not in CAMERAS:
        raise file.error(f"sensors.{KIND}", f"must be {', '.join(CAMERAS[:-1])} or {CAMERAS[-1]}, got {kind!r}")
    if kind == VECTOR and TABLE not in content:
        return tables
    table = GuideCamera.of_part(tables[TABLE])
    for key in ("exposure", "readout_delay"):
        ticks = whole_ticks(value := getattr(table, key))
        if ticks is None or ticks < (key == "exposure"):
            raise file.error(f"{TABLE}.{key}", f"must be whole milliseconds, got {value!r} s")
    camera = star_camera(ImageOptics.of_part(tables["optics"]), table, file.path)
    if kind == VECTOR:
        return tables
    for key in FOLLOWING:
        if key in content.get("sensors", {}):
            raise file.error(f"sensors.{key}", f"must be absent where sensors.{KIND} is {kind}, got a value")
    low_pass = list(exposure_low_pass(table.exposure, table.readout_delay))
    noise = star_noise(camera, table.noise_curve, file.path)
    return {**tables, "sensors": {**tables["sensors"], "camera_filter": low_pass, "camera_noise": noise}}


def without_images(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables without what only images need: those of plant, loop and designs.

    What the camera's table makes of low-pass and noise stays, under ``sensors``.
    """
    optics = {key: value for key, value in tables["optics"].items() if key not in IMAGE_OPTICS}
    sensors = {key: value for key, value in tables["sensors"].items() if key != KIND}
    kept = {key: value for key, value in tables.items() if key != TABLE}
    return {**kept, "optics": optics, "sensors": sensors}
