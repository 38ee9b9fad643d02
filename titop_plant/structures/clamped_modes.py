"""Modal data from mass and stiffness matrices clamped at a rigid interface.

With the coordinates divided into those of the interface (c), which move as a rigid body ``R_c`` with P, and the others
(f), the modes are those of ``M_ff, K_ff``. The rigid mass is ``R' M R`` and the participation ``L = Phi' (M R)_f``, of
one mass matrix, so the residual mass is positive semidefinite with any number of modes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, eigh

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.structures.modal_data import ChildPort, ModalData

MASSLESS = 1e-9
"""Inverse square of a frequency, relative to the largest, of a mode of coordinates without mass, within rounding."""


@dataclass(frozen=True)
class FreeStructure:
    """Matrices of a free structure.

    Attributes
    ----------
    name : str
    M, K : ndarray, shape (n, n)
        kg, kg m, kg m2 and N/m, N, N m; unit modal mass for generalised coordinates.
    rigid : ndarray, shape (n, 6)
        Coordinates for unit rigid motions about P.
    """

    name: str
    M: FloatArray
    K: FloatArray
    rigid: FloatArray


def clamped_body(
    free: FreeStructure,
    parent: tuple[str, FloatArray],
    clamped: NDArray[np.intp],
    ports: Mapping[str, tuple[FloatArray, slice]],
    n_modes: int | None,
    damping: ArrayLike,
    massless: bool = False,
) -> ModalData:
    """Modal data of a structure whose interface is clamped.

    Parameters
    ----------
    free : FreeStructure
    parent : (str, ndarray of shape (3,))
        Name and position of P.
    clamped : ndarray of int
        Coordinates of the interface.
    ports : mapping of str to (ndarray of shape (3,), slice)
        Position and six coordinates of each child port.
    n_modes : int, optional
        Number of lowest modes to keep. Default: all.
    damping : array_like, shape (n_modes,)
        Damping ratios.
    massless : bool
        Accept coordinates without mass: modes of infinite frequency are left out.

    Returns
    -------
    ModalData
        Modes in ascending order of frequency. The sign of each mode is chosen so that its largest
        participation (scaled by the rigid mass) is positive: the same matrices always give the same signs.

    Raises
    ------
    ValueError
        More modes than coordinates, a mechanism, or coordinates without mass where these are not accepted.
    """
    others = np.delete(np.arange(free.M.shape[0]), clamped)
    M, K = free.M[np.ix_(others, others)], free.K[np.ix_(others, others)]
    if n_modes is not None and not 0 <= n_modes <= others.size:
        raise InputError(f"{free.name}: modes must be 0 to {others.size}, got {n_modes}")
    if massless:
        squares, shapes = _finite_modes(free.name, M, K, n_modes)
    else:
        squares, shapes = _modes(free.name, M, K, others.size if n_modes is None else n_modes)
    keep = squares.size
    mass_matrix = free.rigid.T @ free.M @ free.rigid
    participation = shapes.T @ (free.M @ free.rigid)[others]
    scaled = participation / np.sqrt(np.maximum(np.diag(mass_matrix), 1e-300))
    sign = np.sign(scaled[np.arange(keep), np.abs(scaled).argmax(axis=1)]) if keep else np.zeros(0)
    full = np.zeros((free.M.shape[0], keep))
    full[others] = shapes * sign
    return ModalData(
        free.name,
        *parent,
        0.5 * (mass_matrix + mass_matrix.T),
        np.sqrt(squares),
        np.broadcast_to(damping, (keep,)),
        sign[:, None] * participation,
        tuple(ChildPort(port, position, full[rows]) for port, (position, rows) in ports.items()),
    )


def _modes(name: str, M: FloatArray, K: FloatArray, keep: int) -> tuple[FloatArray, FloatArray]:
    if keep == 0:
        return np.zeros(0), np.zeros((M.shape[0], 0))
    try:
        squares, shapes = eigh(K, M, subset_by_index=(0, keep - 1))
    except LinAlgError as error:
        raise InputError(f"{name}: every node must have mass in all six directions, got {error}") from None
    if squares[0] <= 1e-12 * float(np.abs(np.diag(K)).max()) / float(np.diag(M).max()):
        raise InputError(f"{name}: structure must have no mechanism, got a mode with w^2 = {squares[0]:.3g} rad2/s2")
    return squares, shapes


def _finite_modes(name: str, M: FloatArray, K: FloatArray, n_modes: int | None) -> tuple[FloatArray, FloatArray]:
    """Modes by their inverse squares, which coordinates without mass have zero."""
    scale = np.sqrt(np.abs(np.diag(K)))
    scale[scale == 0.0] = 1.0
    scaled = np.outer(1.0 / scale, 1.0 / scale)
    try:
        inverse, shapes = eigh(M * scaled, K * scaled)
    except LinAlgError:
        raise InputError(
            f"{name}: clamped structure must have no mechanism, got a stiffness that is not positive"
        ) from None
    if inverse[-1] <= 0.0 or inverse[0] < -MASSLESS * inverse[-1]:
        raise InputError(
            f"{name}: mass matrix must be positive semidefinite, got 1/w^2 of {inverse[0]:.3g} to {inverse[-1]:.3g} s2"
        )
    order = np.flatnonzero(inverse > MASSLESS * inverse[-1])[::-1][:n_modes]
    root = np.sqrt(inverse[order])
    return 1.0 / inverse[order], shapes[:, order] / scale[:, None] / root
