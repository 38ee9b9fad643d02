"""Modal data of a flexible body: the data of a structure that a two-input two-output port (TITOP) block uses.

With mass-normalised modal coordinates ``eta`` of the modes clamped at the parent point P
(Alazard, Perez, Cumer & Loquen, "Two-Input Two-Output Port model for
mechanical systems", AIAA Guidance, Navigation, and Control Conference, 2015)::

    eta'' + 2 diag(zeta w) eta' + diag(w^2) eta = -L accel_P + sum Phi_C' wrench_C
    accel_C = tau_CP accel_P + Phi_C eta''
    wrench_P = -(M_rr accel_P + L' eta'') + sum tau_CP' wrench_C      (by the body on its parent)

The direct feedthrough from ``accel_P`` to ``wrench_P`` is ``-(M_rr - L' L)``: the residual mass,
which must be positive semidefinite (:mod:`titop_plant.structures.residual_mass`).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigvalsh

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.ports import AXES
from titop_plant.structures.kinematics import check_rotation, read_only, rigid_properties, rotate_twist, skew, tau


@dataclass(frozen=True)
class ChildPort:
    """A point of a flexible body where another body is attached.

    Parameters
    ----------
    name : str
        Name of the point.
    position : array_like, shape (3,)
        In the body frame, m.
    shapes : array_like, shape (6, n)
        Mass-normalised mode shapes at the point, clamped at the parent: three rows of translation
        (1/sqrt(kg)), three of rotation (1/(sqrt(kg) m)); **eta = 1 moves the point by +shapes**.
    """

    name: str
    position: FloatArray
    shapes: FloatArray = field(repr=False)

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("name of a child port must not be empty, got ''")
        object.__setattr__(self, "position", read_only(self.position, (3,), f"child {self.name!r}, position"))
        object.__setattr__(self, "shapes", read_only(self.shapes, (6, None), f"child {self.name!r}, shapes"))


@dataclass(frozen=True)
class ModalData:
    """Flexible body in modal form, clamped at its parent point.

    Parameters
    ----------
    name : str
        Name of the body, used in every error message.
    parent : str
        Name of the parent point P.
    parent_position : array_like, shape (3,)
        P in the body frame, m.
    mass_matrix : array_like, shape (6, 6)
        Rigid mass matrix ``M_rr`` at P (kg, kg m, kg m2); see :func:`from_inertia`.
    frequencies : array_like, shape (n,)
        Clamped natural frequencies w, rad/s, positive; n = 0 is a rigid body.
    damping : array_like, shape (n,)
        Damping ratios zeta, 0 <= zeta < 1.
    participation : array_like, shape (n, 6)
        Modal participation ``L`` at P: columns of translation in sqrt(kg), of rotation in
        sqrt(kg) m. **eta'' = -L accel_P** for an accelerated base.
    children : tuple of ChildPort
        Points for other bodies; ``shapes`` with one column per mode.

    Raises
    ------
    ValueError
        A shape does not fit, a mass is not positive, ``M_rr`` is not symmetric or not positive
        semidefinite, a frequency or damping is out of range, two points share a name. The message
        names the body and the quantity. The residual mass is *not* checked here (printed data are often
        slightly inconsistent): see :func:`titop_plant.structures.check_residual_mass`.

    Examples
    --------
    A 2 kg body on a spring of 8 N/m inside a 3 kg casing (the mode has 2 of the 5 kg as effective mass):

    >>> import numpy as np
    >>> body = ModalData("slider", "P", np.zeros(3), from_inertia(5.0, np.eye(3), np.zeros(3)),
    ...                  [2.0], [0.01], np.sqrt(2.0) * np.eye(1, 6))
    >>> float(round(body.residual_mass()[0, 0], 9))
    3.0
    """

    name: str
    parent: str
    parent_position: FloatArray
    mass_matrix: FloatArray = field(repr=False)
    frequencies: FloatArray = field(repr=False)
    damping: FloatArray = field(repr=False)
    participation: FloatArray = field(repr=False)
    children: tuple[ChildPort, ...] = ()

    def __post_init__(self) -> None:
        if not self.name or not self.parent:
            raise InputError(f"body {self.name!r}: body and parent point must have names, got {self.parent!r}")
        w = read_only(self.frequencies, (None,), f"{self.name}: frequencies")
        n = w.size
        shapes = {"parent_position": (3,), "mass_matrix": (6, 6), "damping": (n,), "participation": (n, 6)}
        object.__setattr__(self, "frequencies", w)
        for key, shape in shapes.items():
            object.__setattr__(self, key, read_only(getattr(self, key), shape, f"{self.name}: {key}"))
        object.__setattr__(self, "children", tuple(self.children))
        self._check_ranges()
        self._check_mass()
        self._check_children()

    def _check_ranges(self) -> None:
        bad = np.flatnonzero(self.frequencies <= 0)
        if bad.size:
            raise InputError(
                f"{self.name}: frequencies must be positive, got {self.frequencies[bad[0]]:.6g} rad/s "
                f"for mode {bad[0] + 1} (a clamped body has no rigid mode)"
            )
        bad = np.flatnonzero((self.damping < 0) | (self.damping >= 1))
        if bad.size:
            raise InputError(
                f"{self.name}: damping must be in [0, 1), got {self.damping[bad[0]]:.6g} for mode {bad[0] + 1}"
            )

    def _check_mass(self) -> None:
        diagonal = np.diag(self.mass_matrix)
        bad = np.flatnonzero(diagonal[:3] <= 0)
        if bad.size:
            raise InputError(f"{self.name}: mass must be positive, got {diagonal[bad[0]]:.6g} kg in {AXES[bad[0]]}")
        bad = np.flatnonzero(diagonal[3:] < 0)
        if bad.size:
            raise InputError(
                f"{self.name}: moment of inertia must not be negative, got {diagonal[3 + bad[0]]:.6g} kg m2 "
                f"in {AXES[3 + bad[0]]}"
            )
        scale = np.sqrt(np.maximum(diagonal, diagonal.max() * 1e-12))
        scaled = self.mass_matrix / np.outer(scale, scale)
        defect = np.abs(scaled - scaled.T)
        if defect.max() > 1e-6:
            i, j = np.unravel_index(int(defect.argmax()), (6, 6))
            raise InputError(
                f"{self.name}: mass_matrix must be symmetric, got {self.mass_matrix[i, j]:.6g} at "
                f"[{i}, {j}] and {self.mass_matrix[j, i]:.6g} at [{j}, {i}]"
            )
        smallest = float(eigvalsh(0.5 * (scaled + scaled.T))[0])
        if smallest < -1e-9:
            raise InputError(
                f"{self.name}: mass_matrix must be positive semidefinite, got a scaled eigenvalue of "
                f"{smallest:.3g} (is the inertia given at the centre of mass?)"
            )

    def _check_children(self) -> None:
        names = [self.parent, *(child.name for child in self.children)]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise InputError(f"{self.name}: points must have different names, got {sorted(twice)[0]!r} twice")
        for child in self.children:
            if child.shapes.shape[1] != self.n_modes:
                raise InputError(
                    f"{self.name}: child {child.name!r} must have shapes (6, {self.n_modes}) "
                    f"for {self.n_modes} modes, got {child.shapes.shape}"
                )

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return int(self.frequencies.size)

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(np.trace(self.mass_matrix[:3, :3]) / 3)

    @property
    def center_of_mass(self) -> FloatArray:
        """Centre of mass in the body frame, m, shape (3,)."""
        return np.asarray(self.parent_position + rigid_properties(self.mass_matrix)[1], dtype=float)

    def child(self, name: str) -> ChildPort:
        """Child port of this name.

        Raises
        ------
        ValueError
            Unknown port; the message lists the existing ones.
        """
        for child in self.children:
            if child.name == name:
                return child
        raise InputError(f"{self.name}: child port must be one of {[c.name for c in self.children]}, got {name!r}")

    def child_tau(self, name: str) -> FloatArray:
        """Kinematic matrix ``tau_CP`` (6 x 6) from the parent to a child: accel_C = tau_CP accel_P."""
        return tau(self.child(name).position, self.parent_position)

    def residual_mass(self) -> FloatArray:
        """Residual mass ``M_rr - L' L`` at P, shape (6, 6): the mass felt at P well above all modes."""
        residual = self.mass_matrix - self.participation.T @ self.participation
        return np.asarray(0.5 * (residual + residual.T))

    def truncate(self, n_modes: int) -> ModalData:
        """The same body with its first ``n_modes`` modes; the rest of the mass becomes residual.

        Raises
        ------
        ValueError
            Number outside 0 to the number of modes.
        """
        if not 0 <= n_modes <= self.n_modes:
            raise InputError(f"{self.name}: n_modes must be 0 to {self.n_modes}, got {n_modes}")
        return dataclasses.replace(
            self,
            frequencies=self.frequencies[:n_modes],
            damping=self.damping[:n_modes],
            participation=self.participation[:n_modes],
            children=tuple(dataclasses.replace(c, shapes=c.shapes[:, :n_modes]) for c in self.children),
        )

    def rotated(self, dcm: ArrayLike) -> ModalData:
        """The same body expressed in another frame with the same origin.

        Parameters
        ----------
        dcm : array_like, shape (3, 3)
            Direction cosine matrix, **v_new = dcm @ v_old**.

        Raises
        ------
        ValueError
            ``dcm`` is not orthonormal or is left-handed.
        """
        rotation = check_rotation(dcm, f"{self.name}: dcm")
        both = rotate_twist(rotation)
        return dataclasses.replace(
            self,
            parent_position=rotation @ self.parent_position,
            mass_matrix=both @ self.mass_matrix @ both.T,
            participation=self.participation @ both.T,
            children=tuple(ChildPort(c.name, rotation @ c.position, both @ c.shapes) for c in self.children),
        )


def from_inertia(mass: float, inertia_at_cg: ArrayLike, cg: ArrayLike, name: str = "") -> FloatArray:
    """Rigid mass matrix at a point P from mass, inertia and centre of mass.

    Parameters
    ----------
    mass : float
        kg, positive.
    inertia_at_cg : array_like, shape (3, 3)
        Inertia **tensor at the centre of mass** (off-diagonal terms with their sign in the tensor,
        i.e. minus the integral of x y dm), kg m2.
    cg : array_like, shape (3,)
        Vector from P to the centre of mass, m.
    name : str
        Name of the body for error messages.

    Returns
    -------
    ndarray, shape (6, 6)
        ``tau_GP' diag(m I, J_G) tau_GP``.

    Raises
    ------
    ValueError
        Mass not positive; inertia not symmetric or not positive semidefinite.

    Examples
    --------
    >>> float(from_inertia(2.0, np.zeros((3, 3)), [3.0, 0.0, 0.0])[5, 5])
    18.0
    """
    body = f"{name}: " if name else ""
    inertia = read_only(inertia_at_cg, (3, 3), f"{body}inertia_at_cg")
    lever = read_only(cg, (3,), f"{body}cg")
    if not np.isfinite(mass) or mass <= 0:
        raise InputError(f"{body}mass must be positive, got {mass:.6g} kg")
    if np.abs(inertia - inertia.T).max() > 1e-9 * max(1.0, float(np.abs(inertia).max())):
        raise InputError(f"{body}inertia_at_cg must be symmetric, got {inertia.tolist()}")
    if eigvalsh(inertia)[0] < -1e-9 * max(1e-9, float(np.abs(inertia).max())):
        raise InputError(f"{body}inertia_at_cg must be positive semidefinite, got {inertia.tolist()}")
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = mass * np.eye(3)
    matrix[:3, 3:] = -mass * skew(lever)
    matrix[3:, :3] = mass * skew(lever)
    matrix[3:, 3:] = inertia - mass * skew(lever) @ skew(lever)
    return matrix
