"""Rigid kinematics between points of a body: skew matrices, tau matrices, rotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from lftkit.arrays import FloatArray
from lftkit.errors import InputError


def read_only(array: ArrayLike, shape: Sequence[int | None], what: str) -> FloatArray:
    """Read-only float copy of an array after a check of its shape and finiteness.

    Parameters
    ----------
    array : array_like
        Given data.
    shape : sequence of int or None
        Expected shape; ``None`` matches any length.
    what : str
        Name of the body and the quantity, for the error message.

    Raises
    ------
    ValueError
        Not numeric, wrong shape, or not finite.
    """
    try:
        copy: FloatArray = np.array(array, dtype=float, order="C")
    except (TypeError, ValueError):
        raise InputError(
            f"{what} must be numbers in an array of shape {_shape_text(shape)}, got {type(array).__name__}"
        ) from None
    if copy.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, copy.shape)):
        raise InputError(f"{what} must have shape {_shape_text(shape)}, got {copy.shape}")
    if not np.all(np.isfinite(copy)):
        raise InputError(f"{what} must be finite, got {copy.size - np.isfinite(copy).sum()} entries that are not")
    copy.setflags(write=False)
    return copy


def _shape_text(shape: Sequence[int | None]) -> str:
    return "(" + ", ".join("n" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"


def skew(vector: ArrayLike) -> FloatArray:
    """Matrix of the vector product: ``skew(u) @ v`` is ``u x v``.

    Parameters
    ----------
    vector : array_like, shape (3,)

    Examples
    --------
    >>> (skew([1.0, 0.0, 0.0]) @ [0.0, 1.0, 0.0]).tolist()
    [0.0, 0.0, 1.0]
    """
    x, y, z = np.asarray(vector, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def tau(point: ArrayLike, base: ArrayLike) -> FloatArray:
    """Kinematic matrix from the twist of one point of a rigid body to another.

    **accel_point = tau(point, base) @ accel_base**, i.e. ``a_P = a_B + skew(P->B) omega_dot``; a
    wrench at ``point`` acts at ``base`` as ``tau(point, base).T @ wrench``.

    Parameters
    ----------
    point, base : array_like, shape (3,)
        Positions in the same frame, m.

    Returns
    -------
    ndarray, shape (6, 6)

    Examples
    --------
    A point 2 m out along x on a body that spins up about z accelerates along +y:

    >>> (tau([2.0, 0.0, 0.0], [0.0, 0.0, 0.0]) @ [0, 0, 0, 0, 0, 1.0])[:3].tolist()
    [0.0, 2.0, 0.0]
    """
    matrix = np.eye(6)
    matrix[:3, 3:] = skew(np.asarray(base, dtype=float) - np.asarray(point, dtype=float))
    return matrix


def check_rotation(dcm: ArrayLike, what: str) -> FloatArray:
    """Direction cosine matrix after a check of orthonormality and orientation.

    Parameters
    ----------
    dcm : array_like, shape (3, 3)
    what : str
        Name for the error message.

    Raises
    ------
    ValueError
        Not orthonormal to 1e-9, or left-handed.
    """
    matrix = read_only(dcm, (3, 3), what)
    defect = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if defect > 1e-9:
        raise InputError(f"{what} must be orthonormal, got P P' - I = {defect:.3g}")
    if np.dot(np.cross(matrix[0], matrix[1]), matrix[2]) < 0:
        raise InputError(f"{what} must be a right-handed rotation (determinant +1), got determinant -1")
    return matrix


def rotate_twist(dcm: FloatArray) -> FloatArray:
    """The 6 x 6 matrix that rotates both halves of a twist or a wrench."""
    return np.asarray(block_diag(dcm, dcm), dtype=float)


def rigid_properties(mass_matrix: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Mass, vector from the point to the centre of mass (3,) and inertia about that (3, 3) of a rigid mass matrix.

    Parameters
    ----------
    mass_matrix : ndarray, shape (6, 6)
        At a point: kg, kg m, kg m2.
    """
    mass = float(np.trace(mass_matrix[:3, :3]) / 3)
    moment = mass_matrix[3:, :3]  # m skew(P->cg)
    offset = np.array([moment[2, 1] - moment[1, 2], moment[0, 2] - moment[2, 0], moment[1, 0] - moment[0, 1]])
    offset = np.asarray(offset / (2 * mass), dtype=float)
    inertia = mass_matrix[3:, 3:] + mass * skew(offset) @ skew(offset)
    return mass, offset, np.asarray(0.5 * (inertia + inertia.T), dtype=float)
