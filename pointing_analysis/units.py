"""Units of angle in radians."""

from __future__ import annotations

import math

RAD_PER_ARCSEC = math.pi / 648_000
RAD_PER_MAS = RAD_PER_ARCSEC / 1000
ANGLES = {
    "mas": RAD_PER_MAS,
    "arcsec": RAD_PER_ARCSEC,
    "arcmin": math.pi / 10_800,
    "mdeg": math.pi / 180_000,
    "deg": math.pi / 180,
    "nrad": 1e-9,
    "urad": 1e-6,
    "mrad": 1e-3,
    "rad": 1.0,
}
"""Radians by the name of a unit."""
NAMES = "mas, arcsec, arcmin, mdeg, deg, nrad, urad, mrad or rad"
"""The units in words."""
