"""FITS files: pupils of others in, jitter kernels and paths out. Needs astropy (``pip install 'los-testbed[image]'``).

A pupil is the first picture of the file: the amplitude that each pixel transmits, from 0 to 1. Its header must have
``PUPLSCAL`` (as files of poppy and STPSF have it) or ``PIXELSCL``: metres per pixel. A second picture of the same shape
named ``OPD`` is the wave front error [m].
"""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from lftkit.support.input_limits import PICTURE
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.image.pupil import PixelPupil

SCALES = ("PUPLSCAL", "PIXELSCL")
"""Keys of the header with the metres per pixel."""
WAVE_FRONT = "OPD"


def astropy_fits() -> Any:
    """The module astropy.io.fits.

    Raises
    ------
    ValueError
        It is not installed.
    """
    try:
        from astropy.io import fits
    except ModuleNotFoundError:
        raise InputError("astropy must be installed for FITS files: pip install 'los-testbed[image]'") from None
    return fits


def read_pupil(content: bytes, wavelength: float) -> PixelPupil:
    """Pupil from the content of a FITS file.

    Parameters
    ----------
    content : bytes
    wavelength : [m], for the phase of a wave front error

    Raises
    ------
    ValueError
        No FITS file, no picture, no scale in the header, a picture that cannot be a pupil.
    """
    fits = astropy_fits()
    try:
        with warnings.catch_warnings(), fits.open(io.BytesIO(content), memmap=False) as file:
            warnings.simplefilter("ignore")
            pictures = [unit for unit in file if getattr(unit, "is_image", False) and unit.shape]
            # A header of some kilobytes, or a compressed picture, can stand for any number of pixels
            pixels = sum(math.prod(unit.shape) for unit in pictures)
            if 8 * pixels > PICTURE:
                raise InputError(f"pictures must have at most {PICTURE // 8} pixels together, got {pixels}")
            found = [(unit.name, dict(unit.header), np.array(unit.data)) for unit in pictures]
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"pupil must be a readable FITS file, got: {first}") from None
    if not found:
        raise InputError("pupil must be a FITS file with an image, got none")
    _, header, data = found[0]
    scale = next((header[key] for key in SCALES if key in header), None)
    if not is_number(scale) or not 0.0 < scale < math.inf:
        got = "none" if scale is None else repr(scale)
        raise InputError(f"pupil must have the metres per pixel as {' or '.join(SCALES)} in its header, got {got}")
    if data.ndim != 2 or data.dtype.kind not in "biuf":
        raise InputError(f"pupil must be a picture of real numbers, got the shape {data.shape} of {data.dtype}")
    amplitude = data.astype(float)
    if np.isfinite(amplitude).all() and amplitude.min() < 0.0:
        raise InputError(f"pupil must have amplitudes of 0 or more, got {amplitude.min():g}")
    front = next((d for name, _, d in found[1:] if name == WAVE_FRONT), None)
    if front is not None and front.shape != data.shape:
        raise InputError(f"{WAVE_FRONT} must have the shape of the pupil {data.shape}, got {front.shape}")
    phase = 0.0 if front is None else 2 * math.pi * front.astype(float) / wavelength
    return PixelPupil(np.asarray(amplitude * np.exp(1j * phase), dtype=complex), float(scale))


def write_picture(path: Path, picture: FloatArray, header: dict[str, tuple[Any, str]]) -> None:
    """Write a picture; `header` has value and comment of each key."""
    fits = astropy_fits()
    _write(path, fits.PrimaryHDU(picture), header)


def write_table(path: Path, columns: dict[str, tuple[FloatArray, str]], header: dict[str, tuple[Any, str]]) -> None:
    """Write a table; `columns` has values and unit of each name."""
    fits = astropy_fits()
    made = [fits.Column(name=name, format="D", unit=unit, array=values) for name, (values, unit) in columns.items()]
    _write(path, fits.BinTableHDU.from_columns(made), header)


def _write(path: Path, unit: Any, header: dict[str, tuple[Any, str]]) -> None:
    for key, (value, comment) in header.items():
        unit.header[key] = (value, comment)
    with atomic_file(path) as temporary:
        unit.writeto(temporary)
