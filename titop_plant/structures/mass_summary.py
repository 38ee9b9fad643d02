"""Mass properties of a body beside those of its source, and whether its modes have the mass.

The effective mass of mode k along an axis is ``L_k^2``. With all modes of a structure the sum is its mass, less that
of the clamped points themselves; the modes that are kept should have 90 % of the mass in each direction of translation
(ASCE 7-16, *Minimum Design Loads*, section 12.9.1.1). What they have not is the residual mass: it follows P rigidly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import Marked, TextTable, numbers
from titop_plant.ports import AXES
from titop_plant.structures.kinematics import read_only, rigid_properties
from titop_plant.structures.modal_data import ModalData
from titop_plant.structures.residual_mass import effective_masses

ENOUGH = 0.9
"""Least sum of the effective masses in a direction of translation, as a share of the mass."""
SAME = 0.02
"""Largest difference of model and source that is no finding, as a share of mass, radius of gyration and inertia."""
FLOOR = 1e-3
"""Least moment of inertia, as a share of the largest, that differences are a share of: an OP2 has single precision."""


@dataclass(frozen=True)
class MassProperties:
    """Mass, centre of mass and inertia of a rigid body.

    Attributes
    ----------
    mass : float
        kg.
    center : ndarray, shape (3,)
        Centre of mass in the body frame [m].
    inertia : ndarray, shape (3, 3)
        Tensor about the centre of mass [kg m2].
    """

    mass: float
    center: FloatArray
    inertia: FloatArray

    @classmethod
    def of(cls, mass_matrix: ArrayLike, point: ArrayLike) -> MassProperties:
        """Properties of a rigid mass matrix (6, 6) at a point (3,).

        Examples
        --------
        >>> from titop_plant.structures.modal_data import from_inertia
        >>> found = MassProperties.of(from_inertia(2.0, np.diag([1.0, 2.0, 3.0]), [0.5, 0.0, 0.0]), np.zeros(3))
        >>> found.mass, found.center.tolist(), np.diag(found.inertia).tolist()
        (2.0, [0.5, 0.0, 0.0], [1.0, 2.0, 3.0])
        """
        mass, offset, inertia = rigid_properties(read_only(mass_matrix, (6, 6), "mass_matrix"))
        return cls(mass, np.asarray(point, dtype=float) + offset, inertia)


@dataclass(frozen=True)
class MassSummary:
    """Mass properties and effective masses of a body; printed, two tables in Markdown and what to note.

    Attributes
    ----------
    name : str
    model : MassProperties
    source : MassProperties or None
        Of the files from which the body was made.
    frequencies : ndarray, shape (n,)
        Clamped [rad/s].
    shares : ndarray, shape (n, 6)
        Effective mass (3) and inertia (3) at P of each mode as a share of those of the body at P; 0 where the body has
        none.
    """

    name: str
    model: MassProperties
    source: MassProperties | None
    frequencies: FloatArray
    shares: FloatArray

    @property
    def sums(self) -> FloatArray:
        """Sums of the shares over the modes, shape (6,)."""
        return np.asarray(self.shares.sum(axis=0), dtype=float)

    @property
    def low(self) -> tuple[str, ...]:
        """Directions of translation in which the modes have less than 90 % of the mass."""
        return tuple(AXES[k] for k in range(3) if self.sums[k] < ENOUGH)

    @property
    def findings(self) -> tuple[str, ...]:
        """What to note, a sentence each: low sums of effective masses, other mass properties than the source."""
        texts = [
            f"{self.name}: the modes should have {ENOUGH:.0%} of the mass in {axis}, got "
            f"{self.sums[AXES.index(axis)]:.1%}: the rest follows the parent point rigidly; keep further modes if it "
            "matters there"
            for axis in self.low
        ]
        if self.source is not None:
            for label, mine, theirs, scale in self._pairs(self.source):
                if abs(mine - theirs) > SAME * scale:
                    texts.append(
                        f"{self.name}: {label} should be that of the source within {SAME:.0%}, got {mine:.6g} and "
                        f"{theirs:.6g}"
                    )
        return tuple(texts)

    def _pairs(self, source: MassProperties) -> list[tuple[str, float, float, float]]:
        """Label, value of the model and the source, and what their difference is a share of."""
        mine, theirs = self.model, source
        mass = max(mine.mass, theirs.mass)
        inertia = float(max(np.abs(mine.inertia).max(), np.abs(theirs.inertia).max()))
        size = float(np.sqrt(inertia / mass)) if mass > 0 else 0.0  # a radius of gyration
        rows = [("mass [kg]", mine.mass, theirs.mass, mass)]
        rows += [(f"centre {a} [m]", mine.center[k], theirs.center[k], size) for k, a in enumerate("xyz")]
        for i, j, label in ((0, 0, "xx"), (1, 1, "yy"), (2, 2, "zz"), (0, 1, "xy"), (0, 2, "xz"), (1, 2, "yz")):
            about = float(np.sqrt(abs(mine.inertia[i, i] * mine.inertia[j, j])))  # small ones within single precision
            scale = max(about, FLOOR * inertia)
            rows.append((f"inertia {label} [kg m2]", mine.inertia[i, j], theirs.inertia[i, j], scale))
        return [(label, float(a), float(b), float(scale)) for label, a, b, scale in rows]

    def properties(self) -> TextTable:
        """Mass properties of the model, and of the source where it is known; inertia about the centre of mass."""
        rows: list[Sequence[str]] = []
        for label, mine, theirs, scale in self._pairs(self.source or self.model):
            if self.source is None:
                rows.append((label, digits(mine, 6)))
                continue
            share = abs(mine - theirs) / scale if scale > 0 else 0.0
            mark = Marked(f"{100.0 * share:.2g} %", "ok" if share <= SAME else "bad")
            rows.append((label, digits(mine, 6), digits(theirs, 6), mark))
        heads = ("model",) if self.source is None else ("model", "source", "difference")
        return TextTable.of(("property", *numbers(*heads)), rows, f"mass properties of {self.name}")

    def modes(self) -> TextTable:
        """Frequency and effective masses of each mode, and their sums, in percent of those of the body at P."""
        axes = tuple(f"{axis[0] if k < 3 else 'r' + axis[0]} [%]" for k, axis in enumerate(AXES))
        rows: list[Sequence[str]] = [
            (str(k), digits(float(w) / (2.0 * pi), 5), *(f"{100.0 * share:.2f}" for share in line))
            for k, (w, line) in enumerate(zip(self.frequencies, self.shares), start=1)
        ]
        sums = [
            Marked(f"{100.0 * share:.2f}", "bad" if k < 3 and share < ENOUGH else "ok")
            for k, share in enumerate(self.sums)
        ]
        rows.append(("sum", "", *sums))
        return TextTable.of(numbers("mode", "frequency [Hz]", *axes), rows, f"effective masses of {self.name}")

    def __str__(self) -> str:
        tables = "\n\n".join(f"{table.title}:\n\n{table.markdown()}" for table in (self.properties(), self.modes()))
        return "\n\n".join((tables, *self.findings))


def mass_summary(data: ModalData, source: ArrayLike | None = None) -> MassSummary:
    """Mass properties and effective masses of a body.

    Parameters
    ----------
    data : ModalData
    source : array_like, shape (6, 6), optional
        Rigid mass matrix at the same P of what the body was made from, as of
        :func:`~titop_plant.nastran.nastran_mass` [kg, kg m, kg m2].

    Returns
    -------
    MassSummary

    Raises
    ------
    ValueError
        A source of another shape.

    Examples
    --------
    A 2 kg slider along x inside a 3 kg casing: in y and z no mode has any mass.

    >>> from titop_plant.structures.modal_data import from_inertia
    >>> M = from_inertia(5.0, np.eye(3), np.zeros(3))
    >>> body = ModalData("slider", "P", np.zeros(3), M, [2.0], [0.01], np.sqrt(2.0) * np.eye(1, 6))
    >>> found = mass_summary(body)
    >>> found.sums.round(6).tolist()[:3], found.low
    ([0.4, 0.0, 0.0], ('x translation', 'y translation', 'z translation'))
    """
    diagonal = np.diag(data.mass_matrix)
    whole = np.where(diagonal > 0, diagonal, np.inf)
    stated = None if source is None else MassProperties.of(source, data.parent_position)
    mine = MassProperties.of(data.mass_matrix, data.parent_position)
    return MassSummary(data.name, mine, stated, data.frequencies, effective_masses(data) / whole)
