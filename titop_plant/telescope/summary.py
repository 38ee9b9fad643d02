"""Summary of a telescope model: order, occurrences, poles, inertia, residual masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit import RealParameter
from lftkit.arrays import FloatArray
from titop_plant.structures.kinematics import rigid_properties
from titop_plant.structures.residual_mass import smallest_residual_fraction
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.mechanism_modes import MechanismMode, mechanism_modes
from titop_plant.telescope.telescope import Telescope


@dataclass(frozen=True)
class BodySummary:
    """Mass, modes and residual mass of a flexible body.

    Parameters
    ----------
    name : str
    mass : float
        kg.
    modes : int
    frequencies : tuple of 2 floats
        First and last clamped frequency kept [rad/s].
    min_residual_mass : float
        Smallest eigenvalue of ``M_rr - L'L`` [kg or kg m2]; **not negative for a physical body**.
    min_residual_fraction : float
        Smallest residual as a fraction of the rigid mass over all directions of motion.
    """

    name: str
    mass: float
    modes: int
    frequencies: tuple[float, float]
    min_residual_mass: float
    min_residual_fraction: float


@dataclass(frozen=True)
class PlantSummary:
    """Summary of a telescope model; poles are those at the nominal parameter values.

    Parameters
    ----------
    order : int
        Number of states.
    occurrences : dict
        Number of repetitions of each parameter in Delta, those of gains of sensors included.
    parameters : tuple of RealParameter
    roles : dict
        Of each parameter, see :mod:`titop_plant.telescope.tables.uncertain`.
    hurwitz : bool
        Whether every pole has a negative real part.
    slowest_pole : float
        Smallest magnitude of a pole [rad/s].
    largest_real_part : float
        rad/s.
    total_inertia : ndarray, shape (3, 3)
        About the centre of mass by the inverse low-frequency gain, arrays at rest in their drives [kg m2].
    mass : float
        Of the whole, by the same gain [kg].
    centre_of_mass : ndarray, shape (3,)
        From G [m].
    bodies : tuple of BodySummary
        None for a plant from a file, whose inertia and mass are NaN: they are not known.
    mechanisms : tuple of MechanismMode
        Modes of the rotors of wheels and drives; none in the reference telescope.
    """

    order: int
    occurrences: dict[str, int]
    parameters: tuple[RealParameter, ...]
    roles: dict[str, str]
    hurwitz: bool
    slowest_pole: float
    largest_real_part: float
    total_inertia: FloatArray
    mass: float
    centre_of_mass: FloatArray
    bodies: tuple[BodySummary, ...]
    mechanisms: tuple[MechanismMode, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Plain types for JSON; ``total_inertia`` is the diagonal, which the attitude law uses."""
        mass_properties = {
            "mass": self.mass,
            "centre_of_mass": self.centre_of_mass.tolist(),
            "total_inertia": np.diag(self.total_inertia).tolist(),
            "total_inertia_matrix": self.total_inertia.tolist(),
        }
        rotors = {mode.name: [mode.at_rest, mode.at_speed] for mode in self.mechanisms}
        return {
            "order": self.order,
            "occurrences": self.occurrences,
            "hurwitz": self.hurwitz,
            "slowest_pole": self.slowest_pole,
            "largest_real_part": self.largest_real_part,
            **(mass_properties if self.bodies else {}),
            "min_residual_mass": {b.name: b.min_residual_mass for b in self.bodies},
            "min_residual_fraction": {b.name: b.min_residual_fraction for b in self.bodies},
            "parameters": {
                p.name: {
                    "nominal": p.nominal,
                    "lower": p.lower,
                    "upper": p.upper,
                    "unit": p.unit,
                    "role": self.roles[p.name],
                }
                for p in self.parameters
            },
            "bodies": {b.name: {"mass": b.mass, "modes": b.modes, "frequencies": b.frequencies} for b in self.bodies},
            **({"mechanisms": rotors} if rotors else {}),
        }


def summarise(telescope: Telescope) -> PlantSummary:
    """Order, occurrences, poles, inertia, residual masses and modes of rotors of a telescope.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> found = summarise(load_telescope())
    >>> found.order, found.occurrences["solar_array.tau"], found.hurwitz
    (204, 32, True)
    """
    assembled = assembled_telescope(telescope)
    system = assembled.system
    poles = linalg.eigvals(system.at({}).A)
    mass, centre, _ = rigid_properties(assembled.rigid_mass)
    return PlantSummary(
        order=system.order,
        occurrences=with_sensors(system, telescope).occurrences(),
        parameters=tuple(telescope.uncertain.values()),
        roles=dict(telescope.roles),
        hurwitz=bool(poles.real.max() < 0.0),
        slowest_pole=float(np.abs(poles).min()),
        largest_real_part=float(poles.real.max()),
        total_inertia=assembled.inertia,
        mass=mass,
        centre_of_mass=centre,
        mechanisms=mechanism_modes(telescope),
        bodies=tuple(
            BodySummary(
                data.name,
                data.mass,
                data.n_modes,
                (float(data.frequencies.min(initial=np.inf)), float(data.frequencies.max(initial=0.0))),
                float(linalg.eigvalsh(data.residual_mass())[0]),
                smallest_residual_fraction(data),
            )
            for data in assembled.bodies
        ),
    )
