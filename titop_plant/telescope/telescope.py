"""The telescope of a parameter file: one frozen object that plant, loop, design, runs and verdicts read.

It is made once, by :func:`titop_plant.telescope.load.load_telescope`; nothing else of the project reads the tables of a
file. Each table is an attribute of its own name (:mod:`titop_plant.telescope.sections`), and what follows from several
of them is an attribute, too: what is on board, stages, requirements, uncertain parameters, ports, hash.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.proofs.trusted.digests import digest
from lftkit.support.input_files import read_bytes
from lftkit.systems.ports import Port
from lftkit.uncertainty.elements import RealParameter
from pointing_analysis.image.guide_camera import GuideCamera
from pointing_analysis.image.optics import ImageOptics
from pointing_analysis.requirements.requirement import Requirement
from titop_plant.interface import DT, FORCE_STAGES, MIRROR_STAGES, STAGES, DesignBasis
from titop_plant.physical_settings import ANGLE
from titop_plant.ports import LOAD
from titop_plant.sensors import CAMERA_PORT, Sensor, read_loop_sensors
from titop_plant.telescope import guide_camera, layout, requirements
from titop_plant.telescope.actuators import Actuator, reference_actuators
from titop_plant.telescope.devices import read_actuators, read_sensors
from titop_plant.telescope.layout import MountedBody, WheelOnBoard
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.optics import TwoMirrorTelescope
from titop_plant.telescope.places import REFERENCE_POINT
from titop_plant.telescope.plant_file import FILE, PLANT, plant_parameters, plant_system
from titop_plant.telescope.sections import (
    AttitudeTable,
    BodyTable,
    DesignScenarioTable,
    DeviceLimits,
    DriveTable,
    ImbalanceTable,
    IsolatorTable,
    Material,
    MirrorTable,
    PayloadTable,
    ProofMassTable,
    WeightTable,
)
from titop_plant.telescope.tables.uncertain import (
    CONSTANT,
    OPERATING,
    SPREAD,
    UNCERTAIN,
    Entry,
    factors,
    require_modes,
    spread_and_role,
    spread_of,
)
from titop_plant.telescope.uncertain_parameters import box_corners, moves, uncertain_parameters

if TYPE_CHECKING:
    from lftkit.systems.system import System

SOURCES = "disturbance"
"""Tables ``[[disturbance]]`` of a user's file: sources that act in every run of the telescope."""
DEVICE_LIMITS = "device_limits"
"""Table of what acts in runs with ``nonlinear``."""
OWN_BODIES = ("body", "payload")
"""Bodies whose modal data may be a file of the user."""


class Telescope:
    """A telescope.

    Two telescopes are equal if all values of their files are. It can be pickled; nothing of it can be changed, see
    :meth:`changed`.

    Parameters
    ----------
    tables : mapping
        All tables of a parameter file, checked and complete. They are copied.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> telescope = load_telescope()
    >>> telescope.fsm.los_sensitivity, len(telescope.wheels), telescope.stages
    (0.1, 4, ('none', 'isolator', 'fsm', 'fsm+pma'))
    """

    _tables: dict[str, Any]

    def __init__(self, tables: Mapping[str, Any]) -> None:
        object.__setattr__(self, "_tables", copy.deepcopy(dict(tables)))

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a telescope is immutable, use Telescope.changed, got a value for {name}")

    def __reduce__(self) -> tuple[type[Telescope], tuple[dict[str, Any]]]:
        return Telescope, (self._tables,)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Telescope) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)

    def __repr__(self) -> str:
        return f"Telescope({self.parameters_hash})"

    @cached_property
    def _text(self) -> str:
        return json.dumps(self._tables, sort_keys=True, default=str)

    def to_mapping(self) -> dict[str, Any]:
        """All values as plain tables, as a parameter file has them; a copy."""
        return copy.deepcopy(self._tables)

    def changed(self, values: Mapping[str, Any]) -> Telescope:
        """A telescope with other values.

        Parameters
        ----------
        values : mapping
            Tables with the values that differ, as in a file, unchecked; lists are replaced.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> load_telescope().changed({"pma": {"azimuths_deg": []}}).stages
        ('none', 'isolator', 'fsm')
        """
        return Telescope(_merged(self._tables, values))

    # ---- tables -----------------------------------------------------------------------------------------------------

    @cached_property
    def materials(self) -> Mapping[str, Material]:
        """Materials of the structures by name."""
        return {name: Material.of_part(table) for name, table in self._tables["materials"].items()}

    @cached_property
    def body(self) -> BodyTable:
        """The central body."""
        return BodyTable.of_part(self._tables["body"])

    @cached_property
    def payload(self) -> PayloadTable:
        """The telescope payload."""
        return PayloadTable.of_part(self._tables["payload"])

    def modal_file(self, structure: str) -> str:
        """File of modal data of ``body`` or ``payload``; empty where it is a frame, whose table has all keys."""
        return str(self._tables[structure].get("modal_data", ""))

    @cached_property
    def optics(self) -> TwoMirrorTelescope:
        """Paraxial data of the optics."""
        return TwoMirrorTelescope.of_part(self._tables["optics"])

    @cached_property
    def image_optics(self) -> ImageOptics:
        """Parameters of images, from the table ``optics``: in no plant and no design, so not in the hash."""
        return ImageOptics.of_part(self._tables["optics"])

    @cached_property
    def isolator(self) -> IsolatorTable:
        """Isolator."""
        return IsolatorTable.of_part(self._tables["isolator"])

    @cached_property
    def fsm(self) -> MirrorTable:
        """Fast steering mirror."""
        return MirrorTable.of_part(self._tables["fsm"])

    @cached_property
    def pma(self) -> ProofMassTable:
        """Proof-mass actuators."""
        return ProofMassTable.of_part(self._tables["pma"])

    @cached_property
    def attitude_control(self) -> AttitudeTable:
        """Attitude control."""
        return AttitudeTable.of_part(self._tables["attitude_control"])

    @cached_property
    def sadm(self) -> DriveTable:
        """Drives of the solar arrays without their own tables."""
        return DriveTable.of_part(self._tables["sadm"])

    @cached_property
    def imbalance(self) -> ImbalanceTable:
        """Imbalance of a wheel."""
        return ImbalanceTable.of_part(self._tables["imbalance"])

    @cached_property
    def design_scenario(self) -> DesignScenarioTable:
        """Tones of the scenario design."""
        return DesignScenarioTable.of_part(self._tables["design_scenario"])

    @cached_property
    def device_limits(self) -> DeviceLimits:
        """Limits of devices in a run with ``nonlinear``: in no linear plant and no design, so not in the hash."""
        return DeviceLimits.of_part(self._tables[DEVICE_LIMITS])

    @cached_property
    def weights(self) -> WeightTable:
        """Weights of the synthesis, with the limits that are made of the requirements."""
        return WeightTable.of_part(self._tables["weights"])

    @cached_property
    def camera(self) -> GuideCamera:
        """Guide star and detector."""
        return GuideCamera.of_part(self._tables["camera"])

    @cached_property
    def plant(self) -> System | None:
        """The system of a file in place of the assembly, see :mod:`titop_plant.telescope.plant_file`; None without."""
        if PLANT not in self._tables:
            return None
        forces = bool(self.pma.azimuths_deg)
        file = self._tables[PLANT][FILE]
        named = zip(layout.speed_names(len(self.wheels)), self.wheels)
        speeds = [name for name, wheel in named if wheel.varies]
        return plant_system(file, self.disturbance_ports, speeds, forces, float(self.fsm.los_sensitivity))

    # ---- on board ---------------------------------------------------------------------------------------------------

    @cached_property
    def solar_arrays(self) -> tuple[MountedBody, ...]:
        """Solar arrays, in the order of the file."""
        return layout.read_arrays(self._tables)

    @cached_property
    def appendages(self) -> tuple[MountedBody, ...]:
        """Flexible bodies without a drive, in the order of the file."""
        return layout.read_appendages(self._tables)

    @cached_property
    def wheels(self) -> tuple[WheelOnBoard, ...]:
        """Reaction wheels, in the order of the file."""
        return layout.read_wheels(self._tables)

    @property
    def turning_wheels(self) -> tuple[int, ...]:
        """Numbers, from 0, of the wheels that are not always at rest: those with imbalance and torque."""
        return tuple(i for i, wheel in enumerate(self.wheels) if wheel.turns)

    @property
    def wheel_axes(self) -> FloatArray:
        """Spin axes Gamma, shape (3, n), body frame."""
        return np.array([wheel.axis for wheel in self.wheels]).T

    @property
    def default_speeds(self) -> tuple[float, ...]:
        """Speeds of the wheels in the parameter file [rad/s]."""
        return tuple(wheel.default_speed for wheel in self.wheels)

    @property
    def driven_arrays(self) -> tuple[MountedBody, ...]:
        """Solar arrays with a drive: one signal of ``sadm_torque`` each."""
        return tuple(array for array in self.solar_arrays if array.drive is not None)

    @property
    def torque_bounds(self) -> FloatArray:
        """Largest disturbance torque of each array drive [Nm], shape (drives,)."""
        return np.array([float(array.drive.torque_bound) for array in self.solar_arrays if array.drive is not None])

    @property
    def motors(self) -> tuple[MountedBody, ...]:
        """Driven arrays with a stepper motor."""
        return tuple(array for array in self.driven_arrays if array.stepper is not None)

    @property
    def arrays_turn(self) -> bool:
        """Whether the telescope has the parameter of the arrays' angle."""
        return ANGLE in self.uncertain if self.plant else any(array.turns for array in self.solar_arrays)

    @property
    def on_bearings(self) -> bool:
        """Whether a wheel has a compliant bearing."""
        return any(wheel.bearing is not None for wheel in self.wheels)

    @property
    def mounted_points(self) -> tuple[str, ...]:
        """Points of the central body where arrays and appendages are, each once."""
        return tuple(dict.fromkeys(body.point for body in (*self.solar_arrays, *self.appendages)))

    @cached_property
    def nodes(self) -> Mapping[str, str]:
        """Nodes of the structure beside the bus's reference point, by the names of places.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> list(load_telescope().nodes)
        ['wheels', 'isolator', 'array_1', 'array_2', 'payload', 'M1', 'M2', 'detector']
        """
        nodes = layout.read_nodes(self._tables)
        return {place: node for place, node in nodes.items() if self.has_input(f"{LOAD}{node}")}

    def has_input(self, name: str) -> bool:
        """Whether sources can act on an input of the plant: all of an assembly, of a file's plant those that it has."""
        return self.plant is None or name in {port.name for port in self.plant.inputs}

    @property
    def loaded_nodes(self) -> tuple[str, ...]:
        """Nodes of all places, each once: the loads of a telescope that sources act on."""
        return tuple(dict.fromkeys(self.nodes.values()))

    def node_at(self, place: str) -> str:
        """Node of a place, the bus's reference point included."""
        return "G" if place == REFERENCE_POINT else layout.device_nodes(self.nodes)[place]

    @cached_property
    def source_tables(self) -> list[tuple[str, Mapping[str, Any]]]:
        """Tables of wheels and arrays that make disturbances, each with the name of its wheel or array."""
        return layout.read_source_tables(self._tables)

    @property
    def sources(self) -> tuple[Mapping[str, Any], ...]:
        """Tables ``[[disturbance]]`` of the file, each with the folder of the file."""
        return tuple(self._tables.get(SOURCES, ()))

    # ---- sensors, actuators, disturbances ---------------------------------------------------------------------------

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the loop in the order of the measurement."""
        return read_loop_sensors(self._tables["sensors"])

    @property
    def washout(self) -> float:
        """Corner of the high-pass of accelerations before the controllers [rad/s]."""
        return float(self._tables["sensors"]["washout"])

    @property
    def camera_noise(self) -> float:
        """Standard deviation of a frame of the camera [rad]."""
        return float(self._tables["sensors"]["camera_noise"])

    @property
    def camera_rate(self) -> float:
        """Frames per second of the camera."""
        return float(self._tables["sensors"]["camera_rate"])

    @property
    def frame_ticks(self) -> int:
        """Ticks from one frame of the camera to the next."""
        return self.loop_ports.ticks[CAMERA_PORT]

    @property
    def camera_kind(self) -> str:
        """Type of the camera, see :mod:`titop_plant.telescope.guide_camera`."""
        return str(self._tables["sensors"].get("camera", guide_camera.VECTOR))

    @property
    def takes_images(self) -> bool:
        """Whether the camera makes frames with a star."""
        return self.camera_kind == guide_camera.IMAGE

    @cached_property
    def placed_sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the tables ``[[sensor]]``, in the order of the file."""
        return read_sensors(self._tables)

    @cached_property
    def placed_actuators(self) -> tuple[Actuator, ...]:
        """Actuators of the tables ``[[actuator]]``, in the order of the file."""
        return read_actuators(self._tables)

    @cached_property
    def loop_ports(self) -> LoopPorts:
        """All sensors and actuators as rows of the loop; those at places are the last."""
        mirror, forces = float(self.fsm.authority), float(self.pma.authority)
        actuators = (*reference_actuators(mirror, forces), *self.placed_actuators)
        return LoopPorts((*self.sensors, *self.placed_sensors), actuators)

    @property
    def disturbance_ports(self) -> tuple[Port, ...]:
        """Inputs of micro-vibrations: imbalance of the wheels and, where there are drives, their torques."""
        drives, imbalance = len(self.driven_arrays), layout.imbalance_port(len(self.turning_wheels))
        return (imbalance, Port(layout.SADM_TORQUE, drives, "Nm")) if drives else (imbalance,)

    @property
    def channels(self) -> int:
        """Number of micro-vibration inputs, 22 for the reference."""
        return layout.IMBALANCE_CHANNELS * len(self.turning_wheels) + len(self.driven_arrays)

    # ---- control ----------------------------------------------------------------------------------------------------

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages of the control: those with forces only where there are actuators for them."""
        known = STAGES if self.plant is None else STAGES[1:]  # the isolator of a file's plant cannot be taken out
        forces = self.pma.azimuths_deg or self.placed_actuators
        return tuple(stage for stage in known if forces or stage not in FORCE_STAGES)

    @property
    def mirror_stages(self) -> tuple[str, ...]:
        """Those of them with the mirror's loop closed: the last one closes all loops that there are."""
        return tuple(stage for stage in self.stages if stage in MIRROR_STAGES)

    @cached_property
    def requirements(self) -> tuple[Requirement, ...]:
        """Pointing requirements, those of all stages."""
        return requirements.read_requirements(self._tables)

    @property
    def requirement_texts(self) -> tuple[str, ...]:
        """Their texts, as the file gives them."""
        return tuple(str(table["text"]) for table in self._tables["requirement"])

    @property
    def window_probability(self) -> float:
        """Part of the windows that must keep the finest limit, see `requirements.window_probability`."""
        return requirements.window_probability(self.requirements)

    @property
    def instant_probability(self) -> float:
        """Part of the instants at which the absolute error must be within the limit."""
        return requirements.instant_probability(self.requirements)

    @property
    def design_basis(self) -> DesignBasis:
        """Design basis of controllers for this telescope."""
        return DesignBasis(
            parameters_hash=self.parameters_hash,
            los_sensitivity=float(self.fsm.los_sensitivity),
            fsm_authority=float(self.fsm.authority),
            pma_authority=float(self.pma.authority),
        )

    # ---- uncertainty ------------------------------------------------------------------------------------------------

    @property
    def _entries(self) -> dict[str, Entry]:
        """Entries of the table of uncertain factors."""
        return dict(self._tables.get(UNCERTAIN, {}))

    @property
    def spreads(self) -> Mapping[str, float]:
        """Half-widths of the uncertain factors by entry."""
        return {name: spread_and_role(entry)[0] for name, entry in self._entries.items()}

    @property
    def roles(self) -> Mapping[str, str]:
        """Role of each uncertain parameter, see :mod:`titop_plant.telescope.tables.uncertain`.

        Examples
        --------
        >>> from titop_plant.telescope.load import load_telescope
        >>> [load_telescope().roles[name] for name in ("wheel_1.speed", "solar_array.tau", "solar_array.omega_1")]
        ['operating', 'operating', 'constant']
        """
        stated = {name: spread_and_role(entry)[1] for name, entry in self._entries.items()}
        return {name: OPERATING if moves(name) else stated.get(name, CONSTANT) for name in self.uncertain}

    @cached_property
    def factors(self) -> Mapping[str, RealParameter]:
        """Uncertain factors by entry, see :mod:`titop_plant.telescope.tables.uncertain`."""
        return factors(self.spreads)

    @cached_property
    def uncertain(self) -> Mapping[str, RealParameter]:
        """The varying and uncertain parameters by name, in the order of Delta."""
        if self.plant is not None:
            return plant_parameters(self.plant)
        return uncertain_parameters(self.wheels, self.solar_arrays, self.appendages, self.factors)

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """Ranges of the uncertain parameters by name: (lowest, highest)."""
        return {name: (p.lower, p.upper) for name, p in self.uncertain.items()}

    def corners(self) -> list[dict[str, float]]:
        """All corners of the box (2^7 for the reference); of more than eight parameters some random ones."""
        return box_corners(self.box)

    def with_uncertain(self, spreads: Iterable[str]) -> Telescope:
        """With further uncertain entries such as ``isolator.stiffness=10%``; a later one wins.

        Raises
        ------
        ValueError
            Another form, an unknown entry, a half-width out of its range, a mode that is none.
        """
        table = self._entries | {
            name: {**entry, SPREAD: spread} if isinstance(entry := self._entries.get(name), dict) else spread
            for name, spread in map(spread_of, spreads)
        }
        if table and self.plant is not None:
            raise InputError(f"uncertain entries must be blocks of the plant's file, got {', '.join(table)}")
        require_modes(table, self._tables)
        return Telescope({**self._tables, UNCERTAIN: table}) if table else self

    def without_uncertain(self) -> Telescope:
        """Without the entries of :meth:`with_uncertain`."""
        return Telescope({name: table for name, table in self._tables.items() if name != UNCERTAIN})

    # ---- variants ---------------------------------------------------------------------------------------------------

    def without_bearings(self) -> Telescope:
        """With rigid wheels."""
        return Telescope(layout.without_bearings(self._tables))

    def without_steppers(self) -> Telescope:
        """With drives whose gearbox ends at the body, with fixed harmonics."""
        return Telescope(layout.without_steppers(self._tables))

    def check_exposure(self, frame_ticks: int) -> None:
        """Refuse an exposure that is longer than the time between frames.

        Parameters
        ----------
        frame_ticks : int
            Ticks of a frame of the run.

        Raises
        ------
        ValueError
            It is longer.
        """
        exposure, frame = self.camera.exposure, frame_ticks * DT
        if self.camera_kind != guide_camera.VECTOR and exposure > frame * (1.0 + 1e-9):
            raise InputError(
                f"camera.exposure must be at most the {frame:g} s between frames of the run, got {exposure:g} s"
            )

    def linear_tables(self) -> dict[str, Any]:
        """Tables without what only images, or runs with limits of the devices, need."""
        tables = guide_camera.without_images(self._tables)
        tables.pop(DEVICE_LIMITS, None)
        return tables

    # ---- identity ---------------------------------------------------------------------------------------------------

    @property
    def parameters_hash(self) -> str:
        """Twelve hexadecimal digits that name the values: the first ones of :attr:`digest`."""
        return self.digest[:12]

    @cached_property
    def digest(self) -> str:
        """128 bits, as hexadecimal digits, that name the values; of a modal data file the content counts.

        Of the requirements only the limits in ``weights`` and the probabilities of windows and instants count: nothing
        else of them is in a plant or a design. Of the optics those of images do not count, nor does the table of the
        guide camera, of which the low-pass and the noise under ``sensors`` count where they follow from it, nor do
        limits of the devices, sources of disturbance and further sensors, which a telescope has beside its loop: a
        design that reads one is not told apart by its noise and rate.
        """
        known = layout.without_sources(self.linear_tables())
        content = {key: value for key, value in known.items() if key not in ("requirement", SOURCES, "sensor")}
        content["window_probability"] = self.window_probability
        content["instant_probability"] = self.instant_probability
        for name in OWN_BODIES:
            content[name] = _with_digest(content[name])
        if PLANT in content:
            content[PLANT] = _with_digest(content[PLANT], FILE)
        for name in (layout.ARRAYS, layout.APPENDAGES):
            if isinstance(content.get(name), list):
                content[name] = [_with_digest(table) for table in content[name]]
        return digest(content)


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables with the values of others."""
    result = dict(base)
    for key, value in over.items():
        nested = isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
        result[key] = _merged(base[key], value) if nested else value
    return result


def _with_digest(table: Mapping[str, Any], key: str = "modal_data") -> Mapping[str, Any]:
    """A table of a body or plant, of its file the content in place of the name."""
    file = table.get(key, "")
    return {**table, key: hashlib.sha256(read_bytes(file)).hexdigest()} if file else table


__all__ = ["DEVICE_LIMITS", "SOURCES", "Telescope"]
