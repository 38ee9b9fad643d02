"""The Euler-Bernoulli beam element: section, local axes, stiffness and consistent mass.

Two nodes of six degrees of freedom and the consistent mass of the cubic and linear shape functions
(Przemieniecki, *Theory of Matrix Structural Analysis*, 1968, sections 5.6 and 11.3). Neglected: shear
deformation and the rotary inertia of the cross-section in bending; torsion keeps the polar inertia
``density (Iy + Iz)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError

_BENDING_K = np.array([[12.0, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
_BENDING_M = np.array([[156.0, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
_AXIAL, _TORSION, _IN_XY, _IN_XZ = (np.ix_(rows, rows) for rows in ((0, 6), (3, 9), (1, 5, 7, 11), (2, 4, 8, 10)))
"""Rows and columns of an element's matrices, translation then rotation of the first node, then of the second."""


@dataclass(frozen=True)
class Section:
    """Cross-section and material of a beam, in the beam's own axes (x along, y and z across).

    Parameters
    ----------
    E, G : float
        Young's and shear modulus, Pa.
    density : float
        kg/m3; 0 for a massless link.
    A : float
        Area, m2.
    Iy, Iz : float
        Second moments of area about y (bending in x-z) and z (bending in x-y), m4.
    J : float
        Torsion constant, m4.
    """

    E: float
    G: float
    density: float
    A: float
    Iy: float
    Iz: float
    J: float

    def __post_init__(self) -> None:
        for key in ("E", "G", "A", "Iy", "Iz", "J"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"section: {key} must be positive, got {value}")
        if not (np.isfinite(self.density) and self.density >= 0):
            raise InputError(f"section: density must not be negative, got {self.density}")


def beam_axes(start: FloatArray, end: FloatArray, up: FloatArray | None, what: str) -> FloatArray:
    """Rotation (3 x 3) whose rows are the local axes of a beam: **v_local = R @ v_body**.

    Raises
    ------
    ValueError
        The beam has no length or ``up`` is parallel to it.
    """
    along = end - start
    length = float(np.sqrt(along @ along))
    if length < 1e-9:
        raise InputError(f"{what}: end points must be different, got a length of {length:.3g} m")
    x = along / length
    if up is None:
        up = np.array([0.0, 1.0, 0.0]) if abs(x[2]) > 0.99 else np.array([0.0, 0.0, 1.0])
    z = _cross(x, up)
    norm = float(np.sqrt(z @ z))
    if norm < 1e-6 * float(np.sqrt(up @ up)) or norm == 0.0:
        raise InputError(f"{what}: up must not be parallel to the beam, got {up.tolist()}")
    z = z / norm
    return np.array([x, _cross(z, x), z])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product; of two vectors alone ``numpy.cross`` takes ten times as long, for its axes."""
    (a1, a2, a3), (b1, b2, b3) = a.tolist(), b.tolist()
    return np.array([a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1])


def element_matrices(section: Section, length: float) -> tuple[FloatArray, FloatArray]:
    """Stiffness and consistent mass matrix (12 x 12) of a beam element in its own axes.

    The order is translation then rotation of the first node, then of the second.
    """
    stiffness, mass = np.zeros((12, 12)), np.zeros((12, 12))
    pair_k, pair_m = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    line = section.density * section.A * length
    for index, rigidity, inertia in (
        (_AXIAL, section.E * section.A, line),
        (_TORSION, section.G * section.J, section.density * (section.Iy + section.Iz) * length),
    ):
        stiffness[index] += rigidity / length * pair_k
        mass[index] += inertia * pair_m
    # In the x-z plane a positive rotation about y lowers z: the slope changes sign.
    for index, rigidity, sign in (
        (_IN_XY, section.E * section.Iz, 1.0),
        (_IN_XZ, section.E * section.Iy, -1.0),
    ):
        turn = np.array([1.0, sign * length, 1.0, sign * length])
        scale = np.outer(turn, turn)
        stiffness[index] += rigidity / length**3 * scale * _BENDING_K
        mass[index] += line / 420.0 * scale * _BENDING_M
    return stiffness, mass
