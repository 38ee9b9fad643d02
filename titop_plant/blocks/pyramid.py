"""Directions of the wheels of a pyramid (numpy only)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.arrays import FloatArray


def pyramid_axes(cant: float, azimuths: Sequence[float]) -> FloatArray:
    """Spin axes of a pyramid about +z, shape (3, n): elevation `cant` [rad] above the xy plane, azimuths [rad]."""
    return np.array([[np.cos(cant) * np.cos(a), np.cos(cant) * np.sin(a), np.sin(cant)] for a in azimuths]).T
