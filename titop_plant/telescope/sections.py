"""The tables of a parameter file as frozen objects: their keys with units and limits.

Values and their sources are in ``reference.toml``. A table and the object made of it have the same name,
:attr:`titop_plant.telescope.telescope.Telescope.fsm` is that of ``[fsm]``. All values are in SI units; names of angles
in degrees end in ``_deg``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic.dataclasses import dataclass

from lftkit.arrays import FloatArray
from pointing_analysis.files.settings import (
    ANY,
    POSITIVE,
    STRICT,
    CheckedTable,
    Excluded,
    Missing,
    Refused,
    setting,
    settings_class,
)
from pointing_analysis.image.guide_camera import GuideCamera
from pointing_analysis.image.optics import ImageOptics
from titop_plant.blocks.stepper import Stepper
from titop_plant.blocks.wheel_bearing import ReactionWheel
from titop_plant.interface import DT
from titop_plant.ports import AXES
from titop_plant.sensors import TICKS_PER_SECOND, whole_ticks
from titop_plant.telescope.optics import TwoMirrorTelescope

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

LOOP_FREQUENCIES = (1e-2, 3000.0)
"""Frequencies [rad/s] at which figures of the loop are looked for; the edge of the bands is among them."""

PMA_AZIMUTHS = 3
"""Azimuths of the proof-mass actuators, two at each: a command holds six forces."""


def refuse_other_rates(key: str, rate: float) -> None:
    """Refuse a rate of samples [Hz] that does not divide that of the ticks."""
    if whole_ticks(rate) is None:
        raise Refused(key, f"must divide {TICKS_PER_SECOND} Hz (50, 40, 25, ...), got {rate!r} Hz")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Material(CheckedTable):
    """A material."""

    E: float = setting(..., "modulus of elasticity", "Pa", POSITIVE)
    G: float = setting(..., "shear modulus", "Pa", POSITIVE)
    density: float = setting(..., "density", "kg/m3", POSITIVE)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class SectionTable(CheckedTable):
    """Cross section of a beam: ``tube`` (diameter, thickness), ``box`` (height, width, thickness), ``bar``."""

    shape: str = setting(..., "shape")
    material: str = setting(..., "name of the material")
    height: float | None = setting(None, "height", "m", POSITIVE)
    width: float | None = setting(None, "width", "m", POSITIVE)
    diameter: float | None = setting(None, "outer diameter", "m", POSITIVE)
    thickness: float | None = setting(None, "thickness of the wall", "m", POSITIVE)

    @property
    def size(self) -> dict[str, float]:
        """Dimensions that are given, by name."""
        known = {name: getattr(self, name) for name in ("height", "width", "diameter", "thickness")}
        return {name: value for name, value in known.items() if value is not None}


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Equipment(CheckedTable):
    """A unit with the inertia of a homogeneous block, at a position or at a node."""

    name: str = setting(..., "name")
    mass: float = setting(..., "mass", "kg", POSITIVE)
    size: Vector = setting(..., "size of the block", "m", POSITIVE, length=3)
    position: Vector | None = setting(None, "position of its centre", "m", length=3)
    node: str | None = setting(None, "node that it is on")

    def __post_init__(self) -> None:
        if self.position is None and self.node is None:
            raise Refused("", "needs a 'position' or a 'node'")


def _missing_names(table: Mapping[str, Any], key: str, needed: Sequence[str]) -> list[str]:
    """Names that a table in a table lacks, where it is there."""
    inner = table.get(key)
    return [f"{key}.{name}" for name in needed if name not in inner] if isinstance(inner, Mapping) else []


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class StructureTable(CheckedTable):
    """Keys of both structures, see :mod:`titop_plant.telescope.bodies`."""

    SECTIONS: ClassVar[tuple[str, ...]]
    """Names of the cross sections that the frame has."""

    modal_data: str = setting("", "file of modal data in place of the frame")
    modes: int = setting(..., "modes of the clamped structure", "", 0)
    damping: float = setting(..., "damping ratio", "", 0.0)
    sections: Mapping[str, SectionTable] = setting(..., "cross sections by name")
    equipment: tuple[Equipment, ...] = setting(..., "units on the structure")

    @classmethod
    def is_section(cls, name: str) -> bool:
        """Whether the frame has a cross section of this name."""
        return name in cls.SECTIONS

    @classmethod
    def missing(cls, table: Mapping[str, Any]) -> list[str]:
        """Keys of the frame that the table lacks; a file of modal data needs none."""
        return (
            []
            if table.get("modal_data")
            else [*super().missing(table), *_missing_names(table, "sections", cls.SECTIONS)]
        )


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class BodyTable(StructureTable):
    """The central body."""

    POINTS: ClassVar = ("A1", "A2", "I_w", "I_p")
    SECTIONS: ClassVar = (
        *("thrust_tube", "web", "deck_brace", "wall_brace", "edge", "longeron"),
        *(f"bracket_{point}" for point in POINTS),
    )

    width_x: float = setting(..., "width along x", "m")
    width_y: float = setting(..., "width along y", "m")
    deck_heights: Vector = setting(..., "heights of the decks", "m", length=3)
    longeron_factors: Vector = setting(..., "walls of the longerons over their thickness", "", length=4)
    ports: Mapping[str, Vector] = setting(..., "points by name", "m", length=3)

    @classmethod
    def is_section(cls, name: str) -> bool:
        """Whether the frame has a cross section of this name: brackets of further points, too."""
        return super().is_section(name) or name.startswith("bracket_")

    @classmethod
    def missing(cls, table: Mapping[str, Any]) -> list[str]:
        """Keys of the frame that the table lacks; a file of modal data needs none."""
        points = [] if table.get("modal_data") else _missing_names(table, "ports", cls.POINTS)
        return [*super().missing(table), *points]


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class PayloadTable(StructureTable):
    """The telescope payload."""

    SECTIONS: ClassVar = (
        *("foot", "spoke", "ring", "bipod", "m1_blank", "strut", "top_ring", "vane", "bracket_I_f", "bracket_DET"),
    )

    bench_height: float = setting(..., "height of the bench", "m")
    bench_radius: float = setting(..., "radius of the bench", "m")
    bench_angles: Vector = setting(..., "angles of the nodes of its ring", "deg", length=6)
    m1_height: float = setting(..., "height of the vertex of M1", "m")
    pad_radius: float = setting(..., "radius of the pads of the bipods", "m")
    pad_angles: Vector = setting(..., "their angles", "deg", length=3)
    tower_radius: float = setting(..., "radius of the ring around M2", "m")
    tower_angles: Vector = setting(..., "angles of its nodes", "deg", length=3)
    strut_factors: Vector = setting(..., "walls of the struts over their thickness", "", length=6)
    detector_xy: Vector = setting(..., "position of the detector", "m", length=2)
    fsm_position: Vector = setting(..., "position of the steering mirror", "m", length=3)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class FurtherMode(CheckedTable):
    """A mode beside the printed ones."""

    frequency: float = setting(..., "frequency", "rad/s", POSITIVE)
    direction: str = setting(..., "direction of the root's motion", choices=AXES)
    share: float = setting(..., "share of the residual mass", "", POSITIVE, 1.0)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class PrintedModes(CheckedTable):
    """Modal data of a flexible body in the parameter file."""

    mass: float = setting(..., "mass", "kg", POSITIVE)
    inertia_at_cg: Matrix = setting(..., "inertia about the centre of mass", "kg m2", length=(3, 3))
    center_of_mass: Vector = setting(..., "centre of mass from the root", "m", length=3)
    frequencies: Vector = setting(..., "frequencies of the clamped body", "rad/s", POSITIVE, length=ANY)
    damping: float = setting(..., "damping ratio", "", 0.0)
    participation: Matrix = setting(..., "participation of the root's motion", "sqrt(kg)", length=(ANY, 6))
    further_modes: tuple[FurtherMode, ...] = setting((), "modes beside them")

    def __post_init__(self) -> None:
        super().__post_init__()
        modes, rows = len(self.frequencies), len(self.participation)
        if modes != rows:
            raise Refused("participation", f"must have a row for each of {modes} frequencies, got {rows}")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class TurningTable(CheckedTable):
    """Rotation of a solar array."""

    drive_axis: Vector = setting(..., "axis of the rotation in the spacecraft's frame", length=3)
    theta_range: Vector = setting(..., "smallest and largest angle", "rad", length=2)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.theta_range
        for i, angle in enumerate(self.theta_range):
            if abs(angle) >= 2.0 * math.pi:
                expected = "must be between -2 pi and 2 pi rad, where tau = tan(theta/4) is regular"
                raise Refused(f"theta_range[{i}]", f"{expected}, got {angle:g}")
        if low > high or (low < high and not low <= 0.0 <= high):
            expected = "must be increasing and contain 0, or be one angle twice"
            raise Refused("theta_range", f"{expected}, got {low:g} to {high:g}")
        if not any(self.drive_axis):
            raise Refused("drive_axis", "must be a direction, got zeros")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ArraysTable(PrintedModes, TurningTable):
    """Solar arrays of one kind, at A1 and A2."""

    relative_uncertainty: float = setting(..., "half-width of the frequencies, relative", "", 0.0, 0.99)
    dcm_A1: Matrix = setting(..., "from the body's frame to that of the array at A1", length=(3, 3))  # noqa: N815
    dcm_A2: Matrix = setting(..., "from the body's frame to that of the array at A2", length=(3, 3))  # noqa: N815


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class IsolatorTable(CheckedTable):
    """The isolator and its platform."""

    mass: float = setting(..., "mass of the platform", "kg", POSITIVE)
    inertia_at_cg: Matrix = setting(..., "its inertia", "kg m2", length=(3, 3))
    center_of_mass: Vector = setting(..., "its centre of mass from I_p", "m", length=3)
    stiffness: Vector = setting(..., "stiffness", "N/m, Nm/rad", POSITIVE, length=6)
    damping: Vector = setting(..., "damping", "N s/m, Nm s/rad", 0.0, length=6)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class MirrorTable(CheckedTable):
    """The fast steering mirror."""

    mass: float = setting(..., "mass", "kg", POSITIVE)
    inertia: Vector = setting(..., "inertia", "kg m2", length=3)
    stiffness: float = setting(..., "stiffness of the joint", "Nm/rad", POSITIVE)
    damping: float = setting(..., "damping of the joint", "Nm s/rad", 0.0)
    los_sensitivity: float = setting(..., "line of sight by the mirror's angle", "rad/rad", POSITIVE)
    authority: float = setting(..., "largest angle", "rad", POSITIVE)

    @property
    def dynamics(self) -> tuple[float, float]:
        """Natural frequency [rad/s] and damping ratio on its joint, with the mean inertia of both axes."""
        inertia = (self.inertia[0] + self.inertia[1]) / 2.0
        frequency = math.sqrt(self.stiffness / inertia)
        return frequency, self.damping / (2.0 * frequency * inertia)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class OscillatorTable(CheckedTable):
    """A proof-mass actuator."""

    moving_mass: float = setting(..., "moving mass", "kg", POSITIVE)
    casing_mass: float = setting(..., "mass of the casing", "kg", POSITIVE)
    inertia: Vector = setting(..., "inertia, z along the motion", "kg m2", length=3)
    stiffness: float = setting(..., "stiffness", "N/m", POSITIVE)
    damping: float = setting(..., "damping", "N s/m", 0.0)
    authority: float = setting(..., "largest force", "N", POSITIVE)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ProofMassTable(OscillatorTable):
    """Proof-mass actuators on the platform: at each azimuth an axial and a tangential one; none without azimuths."""

    azimuths_deg: Vector = setting(..., "azimuths", "deg")
    mounting_radius: float = setting(..., "distance from the centre of the platform", "m")
    height: float = setting(..., "height above I_p", "m")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.azimuths_deg) not in (0, PMA_AZIMUTHS):
            raise Refused("azimuths_deg", f"must hold {PMA_AZIMUTHS} angles, or none, got {len(self.azimuths_deg)}")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class AttitudeTable(CheckedTable):
    """The attitude control."""

    bandwidth: float = setting(..., "bandwidth", "rad/s", POSITIVE)
    damping: float = setting(..., "damping ratio", "", 0.0)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Drive(CheckedTable):
    """Drive of a solar array: gearbox, largest disturbance torque and, where the file has one, its motor."""

    gearbox_stiffness: float = setting(..., "stiffness of the gearbox", "Nm/rad", 0.0)
    gearbox_damping: float = setting(..., "damping of the gearbox", "Nm s/rad", 0.0)
    torque_bound: float = setting(..., "largest disturbance torque", "Nm", 0.0)
    stepper: Stepper | None = setting(None, "stepper motor", absent="none")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stepper is not None and self.gearbox_stiffness == 0.0:
            raise Refused("stepper", "needs a gearbox_stiffness above zero, got 0")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class DriveTable(Drive):
    """Drives of the solar arrays; micro-steps without a stepper motor are harmonics of ``step_frequency``."""

    step_frequency: float = setting(..., "frequency of the micro-steps", "rad/s", POSITIVE)
    step_harmonics: Vector = setting(..., "amplitudes of its harmonics")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class BodyOnBoardTable(PrintedModes):
    """A flexible body at a point of the central body; those of one kind may share what they leave out."""

    name: str = setting(..., "name")
    point: str = setting(..., "point of the central body")
    like: str = setting("", "body before it whose values it has")
    parameters: str = setting(
        "",
        "beginning of the names of its uncertain parameters, which bodies with the same one share",
        absent="its name",
    )
    modal_data: str = setting("", "file of modal data in place of the modes")
    relative_uncertainty: float = setting(0.0, "half-width of its frequencies, relative", "", 0.0, 0.99)
    uncertain_modes: int | None = setting(None, "how many of its frequencies are uncertain", absent="all")
    dcm: Matrix | None = setting(None, "from the spacecraft's frame to its own", length=(3, 3), absent="the same")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ArrayTable(BodyOnBoardTable, TurningTable, Drive):
    """A solar array."""

    driven: bool = setting(True, "whether it has a drive")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Broadband(CheckedTable):
    """One-sided densities of a wheel's broadband noise on its mount, interpolated on logarithmic axes."""

    frequency: Vector = setting(..., "frequencies", "Hz")
    radial_force: Vector | None = setting(None, "density of the radial force", "N2/Hz", 0.0)
    axial_force: Vector | None = setting(None, "density of the axial force", "N2/Hz", 0.0)
    radial_torque: Vector | None = setting(None, "density of the radial torque", "Nm2/Hz", 0.0)
    axial_torque: Vector | None = setting(None, "density of the axial torque", "Nm2/Hz", 0.0)

    def __post_init__(self) -> None:
        f, (_, *known) = self.frequency, self.SETTINGS
        if len(f) < 2 or not f[0] > 0.0 or any(b <= a for a, b in itertools.pairwise(f)):
            raise Refused("frequency", f"must be two or more increasing frequencies above 0 Hz, got {list(f)}")
        densities = {name: density for name in known if (density := getattr(self, name)) is not None}
        if not densities:
            raise Refused("", f"must have a density, one of {', '.join(known)}, got none")
        for name, density in densities.items():
            if len(density) != len(f):
                raise Refused(name, f"must hold {len(f)} numbers, one for each frequency, got {len(density)}")

    def density(self, name: str) -> FloatArray:
        """Values of one of its densities, zeros where the file gives none."""
        values = getattr(self, name)
        return np.zeros(len(self.frequency)) if values is None else np.array(values, dtype=float)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class WheelKind(ReactionWheel):
    """A kind of reaction wheel."""

    maximum_speed: float | None = setting(None, "largest speed", "rad/s", POSITIVE, absent="that of speed_range")
    speed_range: Vector | None = setting(
        None, "smallest and largest speed", "rad/s", length=2, absent="both senses of maximum_speed"
    )
    broadband: Broadband | None = setting(None, "broadband noise", absent="none")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.maximum_speed is None and self.speed_range is None:
            raise Missing("", "has no 'maximum_speed' or 'speed_range'")
        if self.maximum_speed is not None and self.speed_range is not None:
            raise Refused("speed_range", f"must be absent beside maximum_speed, got {list(self.speed_range)}")
        low, high = self.range
        if low > high:
            raise Refused("speed_range", f"must be its smallest and its largest speed, got {[low, high]}")

    @property
    def range(self) -> tuple[float, float]:
        """Smallest and largest speed [rad/s]; equal: the wheel turns at this speed, or stays at rest."""
        low, high = self.speed_range or (-float(self.maximum_speed or 0.0), float(self.maximum_speed or 0.0))
        return low, high


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class WheelsTable(WheelKind):
    """Reaction wheels of one kind in a pyramid."""

    cant_deg: float = setting(..., "angle of the axes above the deck", "deg")
    azimuths_deg: Vector = setting(..., "azimuths of the wheels", "deg")
    default_speed: Vector = setting(..., "speeds", "rad/s")
    mounting_radius: float = setting(..., "distance of their centres from I_w", "m")

    def __post_init__(self) -> None:
        super().__post_init__()
        wheels, speeds = len(self.azimuths_deg), len(self.default_speed)
        if wheels != speeds:
            raise Refused("default_speed", f"must hold a speed for each of {wheels} wheels, got {speeds}")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class WheelTable(WheelKind):
    """A reaction wheel."""

    name: str = setting(..., "name")
    axis: Vector = setting(..., "direction of the spin", length=3)
    position: Vector = setting((0.0, 0.0, 0.0), "its centre from I_w", "m", length=3)
    default_speed: float | None = setting(None, "speed", "rad/s", absent="the only one of its range")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.axis):
            raise Refused("axis", "must be a direction, got zeros")
        if self.default_speed is None and self.range[0] < self.range[1]:
            raise Missing("", "has no 'default_speed'")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class ImbalanceTable(CheckedTable):
    """Imbalance of one wheel: coefficients of the square of the speed, and harmonics of the speed."""

    radial_force: float = setting(..., "radial force of the fundamental", "N s2", 0.0)
    axial_force: float = setting(..., "axial force of the fundamental", "N s2", 0.0)
    radial_torque: float = setting(..., "radial torque of the fundamental", "Nm s2", 0.0)
    force_harmonics: Vector = setting(..., "frequencies of the forces over the speed")
    force_ratios: Vector = setting(..., "their amplitudes over the fundamental")
    torque_harmonics: Vector = setting(..., "frequencies of the torques over the speed")
    torque_ratios: Vector = setting(..., "their amplitudes over the fundamental")


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class DesignScenarioTable(CheckedTable):
    """Tones of the scenario design."""

    band: Vector = setting(..., "band of their frequencies", "rad/s", length=2)
    tones: int = setting(..., "their number", "", 0)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class SensorsTable(CheckedTable):
    """Sensors of the loop: standard deviations are those of a sample."""

    accelerometer_noise: Vector = setting(..., "noise of the accelerometers", "m/s2, rad/s2", 0.0, length=6)
    accelerometer_bias: Vector = setting(..., "their bias", "m/s2, rad/s2", length=6)
    camera_rate: float = setting(..., "frames per second", "Hz", 1.0)
    camera_noise: float = setting(..., "noise of a frame", "rad", 0.0)
    strain_gauge_noise: float = setting(..., "noise of the mirror's gauges", "rad", 0.0)
    camera_filter: Vector = setting(..., "c0, c1, c2 of the camera's low-pass c0 / (s^2 + c1 s + c2)", length=3)
    washout: float = setting(..., "corner of the high-pass of accelerations", "rad/s", POSITIVE)
    camera: str = setting(..., "kind of camera")

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_other_rates("camera_rate", self.camera_rate)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class DeviceLimits(CheckedTable):
    """Limits of real actuators and sensors, which act in runs with ``nonlinear``; 0: no such limit."""

    mirror_rate: float = setting(..., "largest rate of the mirror", "rad/s", 0.0)
    force_rate: float = setting(..., "largest rate of a force of the proof-mass actuators", "N/s", 0.0)
    stroke: float = setting(..., "largest displacement of a proof mass", "m", 0.0)
    cut_off: float = setting(..., "cut-off of the accelerometers' anti-alias filters", "Hz", 0.0, Excluded(0.5 / DT))
    acceleration_step: float = setting(..., "quantisation of the accelerometers", "m/s2 and rad/s2", 0.0)
    camera_step: float = setting(..., "quantisation of the camera", "rad", 0.0)
    gauge_step: float = setting(..., "quantisation of the mirror's gauges", "rad", 0.0)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class LimitsTable(CheckedTable):
    """Limits of a design, which are made of the requirements, see :mod:`titop_plant.telescope.requirements`."""

    ape_limit: float = setting(..., "limit of the absolute error", "rad", POSITIVE)
    rpe_limit: float = setting(..., "limit of the relative error with the mirror alone", "rad", POSITIVE)
    rpe_limit_fine: float = setting(..., "limit of the relative error with all actuators", "rad", POSITIVE)
    rpe_window: float = setting(..., "window of the relative error", "s", POSITIVE)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class WeightTable(LimitsTable):
    """Weights of the synthesis; tones below the edge of the bands are slow, those above are fast."""

    wheel_imbalance: Vector = setting(..., "amplitudes of the imbalance", "N, Nm", 0.0, length=5)
    wheel_imbalance_zero: float = setting(..., "zero of their weight", "rad/s")
    wheel_imbalance_pole: float = setting(..., "pole of their weight", "rad/s")
    band_edge: float = setting(..., "edge of the bands", "rad/s", *LOOP_FREQUENCIES)


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class RequirementTable(CheckedTable):
    """A pointing requirement."""

    name: str = setting(..., "name")
    text: str = setting(..., "requirement")
    loop: Any = setting((), "stages that it holds for")

    def __post_init__(self) -> None:
        names = self.loop if isinstance(self.loop, tuple) else (self.loop,)
        if not all(isinstance(name, str) for name in names):
            raise Refused("loop", f"must be a text or a list of texts, got {self.loop!r}")


TABLES: Mapping[str, tuple[type[CheckedTable], ...]] = {
    "optics": (TwoMirrorTelescope, ImageOptics),
    "body": (BodyTable,),
    "payload": (PayloadTable,),
    "solar_array": (ArraysTable,),
    "sadm": (DriveTable,),
    "isolator": (IsolatorTable,),
    "reaction_wheel": (WheelsTable,),
    "fsm": (MirrorTable,),
    "pma": (ProofMassTable,),
    "attitude_control": (AttitudeTable,),
    "sensors": (SensorsTable,),
    "camera": (GuideCamera,),
    "imbalance": (ImbalanceTable,),
    "design_scenario": (DesignScenarioTable,),
    "device_limits": (DeviceLimits,),
    "weights": (WeightTable,),
}
"""Classes of the tables of a parameter file: those of which it has one."""
