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

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError


@dataclass(frozen=True)
class TwoMirrorTelescope:
    """Paraxial data of a two-mirror telescope.

    Parameters
    ----------
    primary_focal_length : float
        f1 [m].
    mirror_distance : float
        d, from M1 to M2, less than f1 [m].
    back_focal_distance : float
        b, from M1's vertex back to the detector [m].

    Examples
    --------
    >>> optics = TwoMirrorTelescope(1.8, 1.55, 0.30)
    >>> round(optics.magnification, 6), round(optics.focal_length, 6)
    (7.4, 13.32)
    """

    primary_focal_length: float
    mirror_distance: float
    back_focal_distance: float

    def __post_init__(self) -> None:
        if not 0.0 < self.mirror_distance < self.primary_focal_length:
            raise InputError(
                f"mirror distance must be between 0 and the primary focal length "
                f"{self.primary_focal_length} m, got {self.mirror_distance} m"
            )

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
