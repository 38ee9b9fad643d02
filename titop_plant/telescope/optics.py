"""Line of sight of a two-mirror telescope as a linear function of small motions.

Signs: z is the optical axis, light comes from +z; the line of sight is a rotation about x and y.
A rotation theta about the origin displaces a point at height z by ``(z theta_y, -z theta_x)``: a rotation
about y is associated with displacements along +x, a rotation about x with displacements along -y.

With f1 the primary's focal length, f the system's, m = f / f1, d the distance of the mirrors, b the
distance from the primary's vertex back to the focus, ``d + b = m (f1 - d)``, per plane:

=========  ====================  ==================
element    tilt                  decenter
=========  ====================  ==================
M1         2                     1 / f1
M2         -2 (f1 - d) / f1      -(m - 1) / f
detector   0                     -1 / f
=========  ====================  ==================

A rigid translation of all elements gives 0, a rigid rotation gives 1. Source: paraxial optics (e.g.
Schroeder, Astronomical Optics, ch. 6).
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from pointing_analysis.files.settings import POSITIVE, STRICT, CheckedTable, Refused, setting, settings_class


@settings_class
@dataclass(frozen=True, config=STRICT)
class TwoMirrorTelescope(CheckedTable):
    """Paraxial data of a two-mirror telescope: f1, d and b.

    Raises
    ------
    ValueError
        Mirrors that are farther apart than the focal length of the first.

    Examples
    --------
    >>> optics = TwoMirrorTelescope(1.8, 1.55, 0.30)
    >>> round(optics.magnification, 6), round(optics.focal_length, 6)
    (7.4, 13.32)
    """

    primary_focal_length: float = setting(..., "focal length of M1", "m", POSITIVE)
    mirror_distance: float = setting(..., "from M1 to M2, less than that", "m", POSITIVE)
    back_focal_distance: float = setting(..., "from M1's vertex back to the detector", "m", POSITIVE)

    def __post_init__(self) -> None:
        f1, d = self.primary_focal_length, self.mirror_distance
        if d >= f1:
            raise Refused("mirror_distance", f"must be below the primary focal length {f1:g} m, got {d:g} m")

    @property
    def magnification(self) -> float:
        """Magnification ``m = f / f1``."""
        f1, d = self.primary_focal_length, self.mirror_distance
        return (d + self.back_focal_distance) / (f1 - d)

    @property
    def focal_length(self) -> float:
        """Focal length f of the system [m]."""
        return self.magnification * self.primary_focal_length

    def sensitivity(self, element: str) -> FloatArray:
        """Line of sight [rad] per motion of an element (translation [m], rotation [rad]), shape (2, 6).

        Parameters
        ----------
        element : {"M1", "M2", "DET"}

        Raises
        ------
        ValueError
            Unknown element.
        """
        f1, f, m = self.primary_focal_length, self.focal_length, self.magnification
        table = {
            "M1": (2.0, 1.0 / f1),
            "M2": (-2.0 * (f1 - self.mirror_distance) / f1, -(m - 1.0) / f),
            "DET": (0.0, -1.0 / f),
        }
        if element not in table:
            raise InputError(f"optical element must be one of {', '.join(table)}, got {element!r}")
        tilt, decenter = table[element]
        return np.array([[0.0, -decenter, 0.0, tilt, 0.0, 0.0], [decenter, 0.0, 0.0, 0.0, tilt, 0.0]])
