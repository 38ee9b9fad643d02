"""The tables of a parameter file as frozen objects; values and their sources are in ``reference.toml``.

A table and the object made of it have the same name, :attr:`titop_plant.telescope.telescope.Telescope.fsm` is that of
``[fsm]``. All values are in SI units; angles in degrees end in ``_deg``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

Table = TypeVar("Table")

LOOP_FREQUENCIES = (1e-2, 3000.0)
"""Frequencies [rad/s] at which figures of the loop are looked for; the edge of the bands is among them."""

FIRST_BAND_EDGE = 85.0
"""Edge between slow and fast tones [rad/s] of telescopes whose stored tables do not state it."""


@dataclass(frozen=True)
class Material:
    """A material: moduli of elasticity and shear [Pa], density [kg/m3]."""

    E: float
    G: float
    density: float


@dataclass(frozen=True)
class SectionTable:
    """Cross section of a beam: ``tube`` (diameter, thickness), ``box`` (height, width, thickness), ``bar`` [m]."""

    shape: str
    material: str
    height: float | None = None
    width: float | None = None
    diameter: float | None = None
    thickness: float | None = None

    @property
    def size(self) -> dict[str, float]:
        """Dimensions that are given, by name."""
        known = {name: getattr(self, name) for name in ("height", "width", "diameter", "thickness")}
        return {name: value for name, value in known.items() if value is not None}


@dataclass(frozen=True)
class Equipment:
    """A unit with the inertia of a homogeneous block: mass [kg], size [m], position [m] or the node that it is on."""

    name: str
    mass: float
    size: Vector
    position: Vector | None = None
    node: str | None = None


@dataclass(frozen=True)
class BodyTable:
    """The central body, see :mod:`titop_plant.telescope.bodies`."""

    modal_data: str
    modes: int
    damping: float
    width_x: float
    width_y: float
    deck_heights: Vector
    longeron_factors: Vector
    ports: Mapping[str, Vector]
    sections: Mapping[str, SectionTable]
    equipment: tuple[Equipment, ...]


@dataclass(frozen=True)
class PayloadTable:
    """The telescope payload, see :mod:`titop_plant.telescope.bodies`."""

    modal_data: str
    modes: int
    damping: float
    bench_height: float
    bench_radius: float
    bench_angles: Vector
    m1_height: float
    pad_radius: float
    pad_angles: Vector
    tower_radius: float
    tower_angles: Vector
    strut_factors: Vector
    detector_xy: Vector
    fsm_position: Vector
    sections: Mapping[str, SectionTable]
    equipment: tuple[Equipment, ...]


@dataclass(frozen=True)
class IsolatorTable:
    """Platform of the isolator, its six stiffnesses and dampings."""

    mass: float
    inertia_at_cg: Matrix
    center_of_mass: Vector
    stiffness: Vector
    damping: Vector


@dataclass(frozen=True)
class MirrorTable:
    """The fast steering mirror; ``authority`` is its largest angle [rad], ``los_sensitivity`` [rad/rad]."""

    mass: float
    inertia: Vector
    stiffness: float
    damping: float
    los_sensitivity: float
    authority: float

    @property
    def dynamics(self) -> tuple[float, float]:
        """Natural frequency [rad/s] and damping ratio on its joint, with the mean inertia of both axes."""
        inertia = (self.inertia[0] + self.inertia[1]) / 2.0
        frequency = math.sqrt(self.stiffness / inertia)
        return frequency, self.damping / (2.0 * frequency * inertia)


@dataclass(frozen=True)
class OscillatorTable:
    """A proof-mass actuator; ``authority`` is its largest force [N]."""

    moving_mass: float
    casing_mass: float
    inertia: Vector
    stiffness: float
    damping: float
    authority: float


@dataclass(frozen=True)
class ProofMassTable(OscillatorTable):
    """Proof-mass actuators on the platform: at each azimuth an axial and a tangential one; none without azimuths."""

    azimuths_deg: Vector
    mounting_radius: float
    height: float


@dataclass(frozen=True)
class AttitudeTable:
    """The attitude control."""

    bandwidth: float
    damping: float


@dataclass(frozen=True)
class DriveTable:
    """Drives of the solar arrays; micro-steps without a stepper motor are harmonics of ``step_frequency`` [rad/s]."""

    gearbox_stiffness: float
    gearbox_damping: float
    torque_bound: float
    step_frequency: float
    step_harmonics: Vector


@dataclass(frozen=True)
class ImbalanceTable:
    """Imbalance of one wheel: coefficients of the square of the speed, and harmonics of the speed."""

    radial_force: float
    axial_force: float
    radial_torque: float
    force_harmonics: Vector
    force_ratios: Vector
    torque_harmonics: Vector
    torque_ratios: Vector


@dataclass(frozen=True)
class DesignScenarioTable:
    """Tones of the scenario design: band of their frequencies [rad/s] and their number."""

    band: Vector
    tones: int


@dataclass(frozen=True)
class WeightTable:
    """Weights of the synthesis: limits of the errors [rad], window [s], amplitudes of the disturbances.

    The first four are made of the requirements, see :mod:`titop_plant.telescope.requirements`. Tones below the edge of
    the bands [rad/s] are slow, those above are fast.
    """

    ape_limit: float
    rpe_limit: float
    rpe_limit_fine: float
    rpe_window: float
    wheel_imbalance: Vector
    wheel_imbalance_zero: float
    wheel_imbalance_pole: float
    band_edge: float = FIRST_BAND_EDGE


@dataclass(frozen=True)
class OpticsTable:
    """Paraxial data of the two mirrors [m]."""

    primary_focal_length: float
    mirror_distance: float
    back_focal_distance: float


def frozen(value: Any) -> Any:
    """A value of a file with tuples instead of lists."""
    return tuple(frozen(item) for item in value) if isinstance(value, list) else value


def made(kind: type[Table], table: Mapping[str, Any], **parts: Any) -> Table:
    """The object of a table; `parts` replace values of its own.

    Keys that the object does not have are left out: further parts of the table have readers of their own.
    """
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    values = {key: frozen(value) for key, value in table.items() if key in known}
    return kind(**{**values, **parts})


def structure(kind: type[Table], table: Mapping[str, Any]) -> Table:
    """The object of the table of a structure, with its sections and its equipment."""
    sections = {name: made(SectionTable, section) for name, section in table["sections"].items()}
    equipment = tuple(made(Equipment, unit) for unit in table["equipment"])
    parts: dict[str, Any] = {"sections": sections, "equipment": equipment}
    if "ports" in table:
        parts["ports"] = {name: frozen(place) for name, place in table["ports"].items()}
    return made(kind, table, **parts)
