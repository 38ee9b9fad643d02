"""The optics of a telescope as far as an image needs them, read from a file or from a recording.

A table ``[optics]``::

    [optics]
    aperture_diameter = 1.5      # m
    obscuration = 0.3            # its diameter over that of the aperture; default 0
    spider_vanes = 0             # default 0
    spider_width = 0.0           # m, of a vane
    wavelength = 550e-9          # m
    pixel_mas = 38.0             # of the detector, on the sky
    weight_mas = 76.0            # sigma of the Gaussian weight of the moments; default: wavelength / aperture
    pupil = ""                   # FITS file in place of the circular aperture (`pointing_analysis.image.fits_files`)

Further keys, of the layout of the telescope's mirrors, are left alone.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import PICTURE
from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.files.structured_text import is_number, load_toml, read_text
from pointing_analysis.image.pupil import AnnularPupil, Pupil, with_spider
from pointing_analysis.read.recording import Recording
from pointing_analysis.units import RAD_PER_MAS

METADATA = "optics"
"""Key of the optics in the metadata of a bag: the table as JSON."""
PUPIL = "pupil.fits"
"""Attachment of a bag with the pupil, where it is a file."""
LAYOUT = ("primary_focal_length", "mirror_distance", "back_focal_distance")
"""Keys of the same table in a telescope's file that make no difference to an image."""
MAX_VANES = 64
NONE_KNOWN = "no optics are known for this recording (give --optics FILE)"


@dataclass(frozen=True)
class Optics:
    """Aperture, wavelength and detector.

    Parameters
    ----------
    wavelength : [m]
    pixel : width of a pixel on the sky [rad]
    diameter : of the aperture [m]; 0 where a pupil is given
    obscuration : its diameter over that of the aperture
    vanes, vane_width : of the spider; [m]
    weight : sigma of the Gaussian weight of the second moments [rad]; 0 for wavelength / aperture
    pupil_file : content of a FITS file in place of the circular aperture, or empty

    Examples
    --------
    >>> optics = Optics(550e-9, 38 * RAD_PER_MAS, 1.5, 0.3)
    >>> round(optics.resolution / RAD_PER_MAS, 1), round(optics.nyquist / optics.cutoff, 3)
    (75.6, 0.995)
    """

    wavelength: float
    pixel: float
    diameter: float = 0.0
    obscuration: float = 0.0
    vanes: int = 0
    vane_width: float = 0.0
    weight: float = 0.0
    pupil_file: bytes = field(default=b"", repr=False)

    @cached_property
    def pupil(self) -> Pupil:
        """The aperture.

        Raises
        ------
        InputError
            A pupil file that cannot be used.
        """
        if self.pupil_file:
            from pointing_analysis.image.fits_files import read_pupil

            return read_pupil(self.pupil_file, self.wavelength)
        if self.vanes and self.vane_width:
            return with_spider(self.diameter, self.obscuration, self.vanes, self.vane_width)
        return AnnularPupil(self.diameter, self.obscuration)

    @property
    def cutoff(self) -> float:
        """Largest spatial frequency of the aperture [cycles/rad]."""
        return self.pupil.extent / self.wavelength

    @property
    def resolution(self) -> float:
        """Wavelength over aperture [rad]."""
        return self.wavelength / self.pupil.extent

    @property
    def nyquist(self) -> float:
        """Largest spatial frequency that the pixels sample without ambiguity [cycles/rad]."""
        return 0.5 / self.pixel

    @property
    def moment_weight(self) -> float:
        """Sigma of the Gaussian weight of the second moments [rad]."""
        return self.weight or self.resolution

    def diffraction(self, frequencies: FloatArray) -> ComplexArray:
        """Optical transfer function of the aperture: (..., 2) [cycles/rad] -> (...)."""
        return self.pupil.autocorrelation(self.wavelength * frequencies)

    def detector(self, frequencies: FloatArray) -> FloatArray:
        """Transfer function of a square pixel: (..., 2) [cycles/rad] -> (...)."""
        return np.asarray(np.sinc(frequencies[..., 0] * self.pixel) * np.sinc(frequencies[..., 1] * self.pixel))

    @property
    def text(self) -> str:
        """One line for tables and captions."""
        aperture = "pupil of a FITS file" if self.pupil_file else f"aperture {self.diameter:g} m"
        if self.obscuration and not self.pupil_file:
            aperture += f", obscuration {self.obscuration:g}"
        if self.vanes and self.vane_width and not self.pupil_file:
            aperture += f", {self.vanes} vanes of {1e3 * self.vane_width:g} mm"
        return f"{aperture}, {1e9 * self.wavelength:g} nm, pixel {self.pixel / RAD_PER_MAS:g} mas"


NUMBERS = {
    "aperture_diameter": (0.0, math.inf, "above 0 m"),
    "obscuration": (-1e-300, 1.0, "at least 0 and below 1"),
    "spider_vanes": (-1e-300, MAX_VANES + 1, f"a whole number from 0 to {MAX_VANES}"),
    "spider_width": (-1e-300, math.inf, "0 m or more"),
    "wavelength": (0.0, 1.0, "above 0 m and below 1 m"),
    "pixel_mas": (0.0, math.inf, "above 0 mas"),
    "weight_mas": (0.0, math.inf, "above 0 mas"),
}
"""Range of each number (both ends excluded), and the range in words."""
NEEDED = ("wavelength", "pixel_mas")


def from_mapping(table: Any, where: str, pupil_file: bytes = b"") -> Optics:
    """Optics from a table.

    Parameters
    ----------
    table : mapping of the keys above
    where : name of the table, for the messages
    pupil_file : content of the FITS file that ``pupil`` names

    Raises
    ------
    InputError
        A key that is missing or unknown, a number out of its range, a pupil that cannot be used.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: optics must be a table, got {type(table).__name__}")
    unknown = set(table) - {*NUMBERS, "pupil", *LAYOUT}
    if unknown:
        raise InputError(
            f"{where}: keys of optics must be among {', '.join([*NUMBERS, 'pupil'])}, got {sorted(unknown)}"
        )
    pupil = table.get("pupil", "")
    if not isinstance(pupil, str):
        raise InputError(f"{where}: optics.pupil must be the name of a FITS file, got {pupil!r}")
    if pupil and not pupil_file:
        raise InputError(f"{where}: optics.pupil must be a FITS file, got {pupil!r} without its content")
    numbers = {key: _number(table, key, where) for key in NUMBERS if key in table}
    for key in (*NEEDED, *(() if pupil else ("aperture_diameter",))):
        if key not in numbers:
            raise InputError(f"{where}: optics must have {key}, got {', '.join(table) or 'nothing'}")
    found = Optics(
        numbers["wavelength"],
        numbers["pixel_mas"] * RAD_PER_MAS,
        0.0 if pupil else numbers["aperture_diameter"],
        numbers.get("obscuration", 0.0),
        int(numbers.get("spider_vanes", 0)),
        numbers.get("spider_width", 0.0),
        numbers.get("weight_mas", 0.0) * RAD_PER_MAS,
        pupil_file if pupil else b"",
    )
    try:
        if not math.isfinite(found.cutoff):
            raise InputError("aperture over wavelength must be finite")
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    return found


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    value, (low, high, words) = table[key], NUMBERS[key]
    whole = key != "spider_vanes" or isinstance(value, int)
    if not is_number(value) or not low < value < high or not whole:
        raise InputError(f"{where}: optics.{key} must be {words}, got {value!r}")
    return float(value)


def load_optics(path: str | os.PathLike[str]) -> tuple[dict[str, Any], bytes]:
    """Read the table ``[optics]`` of a TOML file, and the pupil that it names, which is looked for beside it.

    Returns
    -------
    table : the keys of an image; `from_mapping` makes optics of it
    pupil_file : content of the FITS file, or empty

    Raises
    ------
    InputError
        A file that cannot be read, no table, optics that cannot be used.
    """
    file = Path(path)
    content = load_toml(read_text(file), file)
    table = content.get("optics") if isinstance(content, dict) else None
    if not isinstance(table, dict):
        raise InputError(f"{file}: must hold a table [optics]")
    data = (
        read_pupil_file(file.parent / table["pupil"]) if isinstance(table.get("pupil"), str) and table["pupil"] else b""
    )
    from_mapping(table, str(file), data)
    return {key: value for key, value in table.items() if key not in LAYOUT}, data


def read_pupil_file(path: Path) -> bytes:
    """Content of a pupil file.

    Raises
    ------
    InputError
        It cannot be read, or is too large.
    """
    try:
        return read_bytes(path, PICTURE)
    except OSError as error:
        raise InputError(f"cannot read the pupil {path}: {error.strerror}") from None


def optics_of(run: Recording) -> Optics | None:
    """Optics that a recording names (`METADATA`); None where it names none.

    Raises
    ------
    InputError
        Optics that cannot be used.
    """
    found = run.parameters.get(METADATA)
    if found is None:
        return None
    key = json.dumps(found, sort_keys=True, default=str)
    # Optics made once: the autocorrelation of a pupil is worth keeping
    pupil_file, where = run.attachments.get(PUPIL, b""), str(run.path)
    name = (key, hash(pupil_file))
    if name not in _CACHE:
        if len(_CACHE) > 8:
            _CACHE.clear()
        _CACHE[name] = from_mapping(json.loads(key), where, pupil_file)
    return _CACHE[name]


R = TypeVar("R", bound=Recording)


def with_optics(run: R, table: Any, pupil_file: bytes = b"") -> R:
    """The recording with these optics in place of its own.

    Parameters
    ----------
    run : Recording
    table, pupil_file : as `load_optics` gives them
    """
    return cast(R, run.changed({**run.parameters, METADATA: table}, {PUPIL: pupil_file} if pupil_file else {}))


_CACHE: dict[tuple[str, int], Optics] = {}
