"""Residual mass of modal data: check, repair and extension by further modes.

The residual mass ``R = M_rr - L' L`` is the mass of the body felt at its parent point well above all
modes kept. It is the direct feedthrough of a TITOP block; if it is not positive semidefinite the
assembled model is unstable or not well posed. Printed tables and truncated test data often have this
defect, by rounding.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, eigh, eigvalsh, solve_triangular

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.ports import AXES
from titop_plant.structures.kinematics import read_only
from titop_plant.structures.modal_data import ModalData

#: Negative residual, as a fraction of the rigid mass, that is accepted as a rounding error.
TOLERANCE = 1e-9


def smallest_residual_fraction(data: ModalData) -> float:
    """Smallest residual mass as a fraction of the rigid mass, over all directions of motion.

    The smallest eigenvalue of ``R d = lambda M_rr d``: 1 for a rigid body, 0 if the modes have the whole
    mass in some direction of motion, negative if the data are not physical. Dimensionless and
    independent of the units of length.
    """
    factor = _factor(data)
    if data.n_modes == 0:
        return 1.0
    whitened = solve_triangular(factor, data.participation.T, lower=True)
    return float(1.0 - eigvalsh(whitened @ whitened.T)[-1])


def check_residual_mass(data: ModalData, tolerance: float = TOLERANCE) -> None:
    """Raise an error if the residual mass is not positive semidefinite.

    Parameters
    ----------
    data : ModalData
    tolerance : float
        Negative residual, as a fraction of the rigid mass, that is accepted as a rounding error.

    Raises
    ------
    ValueError
        Names the body, the axis with the largest part in the most negative direction, the residual
        about that axis and the smallest eigenvalue.
    """
    fraction = smallest_residual_fraction(data)
    if fraction >= -tolerance:
        return
    residual = data.residual_mass()
    values, vectors = eigh(residual, data.mass_matrix)
    direction = vectors[:, 0] * np.sqrt(np.diag(data.mass_matrix))
    axis = int(np.abs(direction).argmax())
    unit = "kg" if axis < 3 else "kg m2"
    raise InputError(
        f"{data.name}: residual mass M_rr - L'L must be positive semidefinite, got {values[0]:.3g} "
        f"of the rigid mass in a direction that is mostly {AXES[axis]} (residual there "
        f"{residual[axis, axis]:.4g} {unit} of {data.mass_matrix[axis, axis]:.6g} {unit}; "
        f"smallest eigenvalue {eigvalsh(residual)[0]:.3g})"
    )


@dataclass(frozen=True)
class ResidualRepair:
    """Result of a repair of the residual mass.

    Parameters
    ----------
    data : ModalData
        The repaired data.
    scale : ndarray, shape (n,)
        Factor on each row of ``L`` (1: unchanged).
    before, after : float
        Smallest residual fraction (:func:`smallest_residual_fraction`) before and after.
    """

    data: ModalData
    scale: FloatArray
    before: float
    after: float

    @property
    def changed(self) -> bool:
        """Whether anything was changed."""
        return bool(np.any(self.scale != 1.0))


def repair_residual_mass(data: ModalData, *, mode: int | None = None, margin: float = 0.0) -> ResidualRepair:
    """Smallest scaling of the participation ``L`` that makes the residual mass positive semidefinite.

    ``M_rr - s^2 L'L`` is positive semidefinite if and only if ``s^2`` is at most one over the largest
    eigenvalue of ``L M_rr^-1 L'``; this ``s`` is used, or 1 if the data are already physical.

    Parameters
    ----------
    data : ModalData
    mode : int, optional
        Scale this row of ``L`` only (index from 0). Default: all rows by the same factor.
    margin : float
        Smallest residual fraction after the repair (0 <= margin < 1). With 0 the residual is singular
        in one direction, and the channel from acceleration to wrench is not invertible there.

    Returns
    -------
    ResidualRepair
        New data, factors, smallest residual fraction before and after.

    Raises
    ------
    ValueError
        ``mode`` or ``margin`` out of range, or the other modes alone exceed the rigid mass.
    """
    if not 0 <= margin < 1:
        raise InputError(f"{data.name}: margin must be in [0, 1), got {margin}")
    before = smallest_residual_fraction(data)
    scale = np.ones(data.n_modes)
    if before < margin:
        whitened = solve_triangular(_factor(data), data.participation.T, lower=True).T
        if mode is None:
            scale[:] = np.sqrt((1.0 - margin) / eigvalsh(whitened @ whitened.T)[-1])
        else:
            if not 0 <= mode < data.n_modes:
                raise InputError(f"{data.name}: mode must be 0 to {data.n_modes - 1}, got {mode}")
            others = np.delete(whitened, mode, axis=0)
            rest = (1.0 - margin) * np.eye(6) - others.T @ others
            if eigvalsh(rest)[0] <= 0:
                raise InputError(f"{data.name}: modes other than {mode} must leave residual mass, got none")
            row = solve_triangular(_lower(rest), whitened[mode], lower=True)
            scale[mode] = float(min(1.0, 1.0 / np.sqrt(row @ row)))
    repaired = dataclasses.replace(data, participation=scale[:, None] * data.participation)
    scale.setflags(write=False)
    return ResidualRepair(repaired, scale, before, smallest_residual_fraction(repaired))


@dataclass(frozen=True)
class ResidualMode:
    """A further mode whose effective mass is a share of the residual mass.

    Parameters
    ----------
    frequency : float
        Clamped frequency, rad/s.
    damping : float
        Damping ratio.
    direction : array_like, shape (6,)
        Motion ``d`` of the parent that excites the mode (translation, rotation).
    share : float
        Effective mass along d as a fraction of the residual ``d'R d``, 0 < share <= 1.
    """

    frequency: float
    damping: float
    direction: FloatArray
    share: float

    def __post_init__(self) -> None:
        direction = read_only(self.direction, (6,), "direction of a residual mode")
        object.__setattr__(self, "direction", direction)
        if not 0 < self.share <= 1:
            raise InputError(f"share of a residual mode must be in (0, 1], got {self.share}")
        if not np.any(direction):
            raise InputError("direction of a residual mode must be nonzero, got zeros")


def add_residual_modes(data: ModalData, modes: Sequence[ResidualMode]) -> ModalData:
    """Extend modal data by modes whose effective masses are shares of the residual mass, in sequence.

    With ``R`` the residual before the mode, a mode of direction d has
    ``L_k = sqrt(share) d'R / sqrt(d'R d)``: its effective mass along d is ``share`` of the residual mass, and
    by the Cauchy-Schwarz inequality ``R - L_k'L_k`` stays positive semidefinite. A table with two printed
    modes of a solar array is extended in this way; the total mass does not change.

    Parameters
    ----------
    data : ModalData
        Without child ports (mode shapes at children do not follow from the mass).
    modes : sequence of ResidualMode

    Returns
    -------
    ModalData
        The old modes followed by the new ones, in the given order.

    Raises
    ------
    ValueError
        The data have child ports, their residual is not physical, or it is zero along a direction.
    """
    if data.children:
        raise InputError(f"{data.name}: a body with residual modes must have no child ports, got {len(data.children)}")
    check_residual_mass(data)
    residual, rows = data.residual_mass(), []
    for k, mode in enumerate(modes):
        along = float(mode.direction @ residual @ mode.direction)
        rigid = float(mode.direction @ data.mass_matrix @ mode.direction)
        if along <= 1e-12 * rigid:
            raise InputError(
                f"{data.name}: residual mass along the direction of residual mode {k + 1} must be positive, "
                f"got {along:.3g}"
            )
        row = np.sqrt(mode.share / along) * (residual @ mode.direction)
        residual = residual - np.outer(row, row)
        rows.append(row)
    return dataclasses.replace(
        data,
        frequencies=np.append(data.frequencies, [mode.frequency for mode in modes]),
        damping=np.append(data.damping, [mode.damping for mode in modes]),
        participation=np.vstack([data.participation, *rows]),
    )


def _lower(matrix: FloatArray) -> FloatArray:
    factor: FloatArray = cholesky(matrix.reshape(6, 6), lower=True)
    return factor


def _factor(data: ModalData) -> FloatArray:
    """Cholesky factor of M_rr; it does not exist for a body without inertia about some axis."""
    try:
        return _lower(data.mass_matrix)
    except LinAlgError:
        raise InputError(
            f"{data.name}: mass_matrix must be positive definite for the check of the residual mass, "
            f"got a smallest eigenvalue of {eigvalsh(data.mass_matrix)[0]:.3g}"
        ) from None


def effective_masses(data: ModalData) -> FloatArray:
    """Effective mass (kg) and inertia (kg m2) of every mode about each axis at P.

    Returns
    -------
    ndarray, shape (n, 6)
        ``L**2``; with all modes of a structure a column sums to the diagonal of ``M_rr`` (minus the mass
        at the clamped point itself).
    """
    return np.asarray(np.square(data.participation), dtype=float)
