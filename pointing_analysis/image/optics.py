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
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import PICTURE
from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.files.settings import POSITIVE, STRICT, CheckedTable, Excluded, Refused, setting, settings_class
from pointing_analysis.files.structured_text import load_toml, read_text
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


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ImageOptics(CheckedTable):
    """The keys of the table.

    Raises
    ------
    InputError
        A number out of its range, no aperture.
    """

    aperture_diameter: float | None = setting(None, "diameter of the aperture", "m", POSITIVE)
    obscuration: float = setting(0.0, "diameter of the obscuration over that of the aperture", "", 0.0, Excluded(1.0))
    spider_vanes: int = setting(0, "vanes of the spider", "", 0, MAX_VANES)
    spider_width: float = setting(0.0, "width of a vane", "m", 0.0)
    wavelength: float = setting(..., "wavelength", "m", POSITIVE, Excluded(1.0))
    pixel_mas: float = setting(..., "width of a pixel on the sky", "mas", POSITIVE)
    weight_mas: float | None = setting(
        None,
        "sigma of the Gaussian weight of the second moments",
        "mas",
        POSITIVE,
        absent="wavelength over aperture",
    )
    pupil: str = setting("", "FITS file in place of the circular aperture")

    def __post_init__(self) -> None:
        if self.aperture_diameter is None and not self.pupil:
            raise Refused("", "has no 'aperture_diameter'")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Optics(ImageOptics):
    """Aperture, wavelength and detector: the keys of the table, and the content of the file that `pupil` names.

    Examples
    --------
    >>> optics = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
    >>> round(optics.resolution / RAD_PER_MAS, 1), round(optics.nyquist / optics.cutoff, 3)
    (75.6, 0.995)
    """

    pupil_file: bytes = Field(default=b"", repr=False, exclude=True)

    @property
    def pixel(self) -> float:
        """Width of a pixel on the sky [rad]."""
        return self.pixel_mas * RAD_PER_MAS

    @property
    def has_spider(self) -> bool:
        """Whether vanes cover a part of the circular aperture."""
        return bool(self.spider_vanes and self.spider_width and not self.pupil_file)

    @cached_property
    def aperture(self) -> Pupil:
        """The aperture.

        Raises
        ------
        InputError
            A pupil file that cannot be used, or is not there.
        """
        if self.pupil_file:
            from pointing_analysis.image.fits_files import read_pupil

            return read_pupil(self.pupil_file, self.wavelength)
        if self.pupil or self.aperture_diameter is None:
            raise Refused("pupil", f"must be a FITS file, got {self.pupil!r} without its content")
        if self.has_spider:
            return with_spider(self.aperture_diameter, self.obscuration, self.spider_vanes, self.spider_width)
        return AnnularPupil(self.aperture_diameter, self.obscuration)

    @property
    def cutoff(self) -> float:
        """Largest spatial frequency of the aperture [cycles/rad]."""
        return self.aperture.extent / self.wavelength

    @property
    def resolution(self) -> float:
        """Wavelength over aperture [rad]."""
        return self.wavelength / self.aperture.extent

    @property
    def nyquist(self) -> float:
        """Largest spatial frequency that the pixels sample without ambiguity [cycles/rad]."""
        return 0.5 / self.pixel

    @property
    def moment_weight(self) -> float:
        """Sigma of the Gaussian weight of the second moments [rad]."""
        return self.resolution if self.weight_mas is None else self.weight_mas * RAD_PER_MAS

    def diffraction(self, frequencies: FloatArray) -> ComplexArray:
        """Optical transfer function of the aperture: (..., 2) [cycles/rad] -> (...)."""
        return self.aperture.autocorrelation(self.wavelength * frequencies)

    def detector(self, frequencies: FloatArray) -> FloatArray:
        """Transfer function of a square pixel: (..., 2) [cycles/rad] -> (...)."""
        return np.asarray(np.sinc(frequencies[..., 0] * self.pixel) * np.sinc(frequencies[..., 1] * self.pixel))

    @property
    def text(self) -> str:
        """One line for tables and captions."""
        aperture = "pupil of a FITS file" if self.pupil_file else f"aperture {self.aperture_diameter:g} m"
        if self.obscuration and not self.pupil_file:
            aperture += f", obscuration {self.obscuration:g}"
        if self.has_spider:
            aperture += f", {self.spider_vanes} vanes of {1e3 * self.spider_width:g} mm"
        return f"{aperture}, {1e9 * self.wavelength:g} nm, pixel {self.pixel_mas:g} mas"


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
    own = {key: value for key, value in table.items() if key not in LAYOUT}
    try:
        optics = Optics.of_table(own, pupil_file=pupil_file if own.get("pupil") else b"")
        if not math.isfinite(optics.cutoff):
            raise InputError("aperture over wavelength must be finite")
    except Refused as error:
        raise InputError(f"{where}: {error.within('optics')}") from None
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return optics


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
