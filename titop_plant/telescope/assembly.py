"""The space telescope, assembled from TITOP blocks into one uncertain system.

::

    external wrench --> attitude G <--> central body --+-- I_w  wheel assembly
                                                       +-- A1 ..  SADM, rotation, solar array, each
                                                       +-- ..   appendages such as antennas
                                                       +-- I_p  isolator + 6 PMA --> payload --> FSM

=====================  ====  =====================================================================
input                  size  meaning
=====================  ====  =====================================================================
``wheel_imbalance``    20    per wheel: force x, y, z [N], torque x, y [Nm], wheel frame
``sadm_torque``        2     disturbance torque on each array about the drive axis [Nm]
``external_wrench``    6     on the body at G [N, Nm]
``wheel_torque``       4     torque on the structure along each spin axis, added to the attitude law's [Nm]
``fsm_command``        2     commanded mirror angles x, y [rad]
``pma_force``          6     motor forces [N]
=====================  ====  =====================================================================

=====================  ====  =====================================================================
output                 size  meaning
=====================  ====  =====================================================================
``accel_Ip``           6     twist of the platform, payload frame [m/s2, rad/s2]
``accel_M1``           6     twist of M1; ``accel_M2`` of M2
``los``                2     line of sight of the payload, rotation about x, y [rad]
``los_controlled``     2     with the mirror: los + los_sensitivity fsm_angle [rad]
``fsm_angle``          2     mirror angles relative to the mount [rad]
``pma_stroke``         6     [m]
``attitude``           3     rotation of G [rad]; ``attitude_rate`` its rate
``accel_G``            6     twist of G
``sadm_angle``         2     elastic angles of the gearboxes [rad]
``wheel_accel``        4     [rad/s2]
=====================  ====  =====================================================================

Rotation and rate are passed through the ports, the line of sight is a function of states, and nothing is
integrated twice: the realisation is minimal by construction (204 states for the reference). The sizes are those of the
reference, which has four wheels, two arrays and six proof-mass actuators. What is not on board has no port, nor
has a wheel that stays at rest; the forces of proof-mass actuators stay an input without effect, since every command
holds six forces. Sensors and actuators at places (:mod:`titop_plant.telescope.devices`) are outputs and, with `motors`,
inputs of their names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import linalg

from lftkit import Connection, Port, System, connect, invert, static_gain, transform
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from titop_plant import ports
from titop_plant.blocks.attitude_control import attitude, attitude_control, total_inertia
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror, fast_steering_mirror
from titop_plant.blocks.flexible_body import flexible_body, rigid_body
from titop_plant.blocks.isolator import Isolator, actuated_platform, isolator
from titop_plant.blocks.reaction_wheel import wheel_assembly
from titop_plant.blocks.revolute_joint import MOTOR
from titop_plant.blocks.uncertain_gain import uncertain_gain
from titop_plant.structures.modal_data import ModalData
from titop_plant.telescope import components as component
from titop_plant.telescope.bodies import build_body, build_payload
from titop_plant.telescope.layout import SADM_TORQUE, WHEEL_TORQUE, MountedBody
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.placed.mounting import (
    actuator_blocks,
    actuator_wires,
    actuator_wrenches,
    sensor_blocks,
    sensor_outputs,
    sensor_wires,
)
from titop_plant.telescope.places import PAYLOAD_NODES, body_of
from titop_plant.telescope.tables.uncertain import DAMPING, GAIN, MIRROR, STIFFNESS, factors_of_modes
from titop_plant.telescope.telescope import Telescope

FSM_COMMAND = Port("fsm_command", 2, "rad")
PMA_FORCE = Port("pma_force", 6, "N")
MOTOR_TORQUE = "motor_torque"
"""Input of a telescope with `motors`: torque of each stepper motor on its rotor [Nm]."""
EXTERNAL_WRENCH = Port("external_wrench", 6, ports.WRENCH_UNIT)
LOS = Port("los", 2, "rad")
OPTICAL_POINTS = (*PAYLOAD_NODES, "I_f")
SADM_ANGLE, PMA_STROKE = "sadm_angle", "pma_stroke"
"""Outputs that are there only where there are drives or proof-mass actuators."""


def load_port(node: str) -> Port:
    """Wrench from outside on a node of the structure, an input of a telescope with `loads` there."""
    return Port(f"{ports.LOAD}{node}", 6, ports.WRENCH_UNIT)


@dataclass(frozen=True)
class AssembledTelescope:
    """The assembled telescope with its total inertia and its flexible bodies.

    Parameters
    ----------
    system : System
        Ports as in the module's tables.
    inertia : ndarray, shape (3, 3)
        Total inertia by the inverse low-frequency gain, nominal [kg m2].
    rigid_mass : ndarray, shape (6, 6)
        Mass matrix of the whole as a rigid body about G, by the same gain of forces and torques [kg, kg m, kg m2].
    bodies : tuple of ModalData
        Central body, payload, then each kind of solar array and of appendage.
    """

    system: System
    inertia: FloatArray = field(repr=False)
    bodies: tuple[ModalData, ...]
    rigid_mass: FloatArray = field(repr=False)


def build_telescope(
    telescope: Telescope | None = None,
    *,
    isolated: bool = True,
    attitude_controlled: bool = True,
    loads: tuple[str, ...] = (),
    motors: bool = False,
) -> AssembledTelescope:
    """Assemble the telescope.

    Parameters
    ----------
    telescope : Telescope, optional
        Default: the reference.
    isolated : bool
        False: the platform is fixed to the body without the isolator's springs.
    attitude_controlled : bool
        Close the attitude loop; without it the attitude is free.
    loads : tuple of str
        Nodes with an input ``load_<node>``, a wrench from outside in the axes of the node's body: ``I_w``, ``I_p``,
        ``A1``, ``A2`` and further points of the body, ``platform``, ``M1``, ``M2``, ``DET``. The states are the same
        without them.
    motors : bool
        With the input `MOTOR_TORQUE` where drives have stepper motors, and one for each actuator at a place; the states
        are the same without them.

    Returns
    -------
    AssembledTelescope
    """
    described = load_telescope() if telescope is None else telescope
    if described.plant is not None:
        return _from_file(described.plant, isolated)
    body, payload = build_body(described, described.mounted_points), build_payload(described)
    outside = (*map(load_port, loads), *(motor_ports(described) if motors else ()))
    driven = _driven_at_G(described, body, payload, isolated, loads, outside)
    free = invert(driven, {"accel_G": "wrench_G"})
    # External torque at G -> angular acceleration of G, attitude not integrated
    pick = np.vstack([np.zeros((3, 3)), np.eye(3)])
    torque, response = Port("torque", 3, "Nm"), Port("response", 3, "rad/s2")
    both = free["accel_G", "wrench_G"]
    inertia = total_inertia(
        transform(both, inputs={"wrench_G": (-pick, torque)}, outputs={"accel_G": (pick.T, response)})
    )
    system = _free_flying(free, described, inertia, attitude_controlled, outside)
    order = list(described.uncertain)
    kinds = {one.kind: one for one in (*described.solar_arrays, *described.appendages)}
    of_kinds = [component.body_modes(one) for one in kinds.values()]
    # Inverse low-frequency gain from external forces and torques at G to its acceleration, (6, 6)
    nominal = free["accel_G", "wrench_G"].at({})
    gain = nominal.D - nominal.C @ linalg.solve(nominal.A, nominal.B) if nominal.A.size else nominal.D
    mass = -linalg.inv(gain)  # the port is the wrench that the bodies exert
    return AssembledTelescope(
        system.sorted_channels(order), inertia, (body, payload, *of_kinds), np.asarray(0.5 * (mass + mass.T))
    )


def _from_file(system: System, isolated: bool) -> AssembledTelescope:
    """The plant of a file; its bodies, inertia and mass are not known."""
    if not isolated:
        raise InputError(f"a plant from a file must have its isolator, got a run without it ({system.name})")
    unknown = np.full((6, 6), np.nan)
    return AssembledTelescope(system, unknown[:3, :3], (), unknown)


def assembled_telescope(telescope: Telescope | None = None, isolated: bool = True) -> AssembledTelescope:
    """The assembled telescope, default: the reference (kept for the next call, so its bits are those of one thread)."""
    return _assembled(load_telescope() if telescope is None else telescope, isolated)


@lru_cache(maxsize=4)
def _assembled(telescope: Telescope, isolated: bool) -> AssembledTelescope:
    with one_thread():
        return build_telescope(telescope, isolated=isolated)


def line_of_sight(telescope: Telescope) -> System:
    """``los`` from the rotation of the payload's base and the elastic deflections of the optics."""
    optics = telescope.optics
    rotation = np.hstack([np.eye(2), np.zeros((2, 1))])
    mirror = telescope.fsm.los_sensitivity * np.hstack([np.zeros((2, 3)), rotation])
    gain = np.hstack([rotation, *(optics.sensitivity(e) for e in ("M1", "M2", "DET")), mirror])
    return static_gain(gain, [ports.angle("I_p"), *(ports.deflection(p) for p in OPTICAL_POINTS)], [LOS])


def _driven_at_G(
    telescope: Telescope,
    body: ModalData,
    payload: ModalData,
    isolated: bool,
    loads: tuple[str, ...],
    outside: tuple[Port, ...],
) -> System:
    """All bodies connected to G, from the imposed motion of G to the wrench they exert there."""
    arrays, others, fsm = telescope.solar_arrays, telescope.appendages, telescope.fsm
    driven = any(actuator.port in outside for actuator in telescope.placed_actuators)
    acting = [(load_port(node).name, node) for node in loads] + actuator_wrenches(telescope, driven=driven)
    used = {"I_w", "I_p", *telescope.mounted_points, *(node for _, node in acting)}
    systems = {
        "body": _flexible(telescope, "body", body, {child.name for child in body.children} - used, motion=True),
        "wheels": wheel_assembly(component.wheel_components(telescope), "I_w"),
        **{one.name: _array(telescope, one, outside) for one in arrays},
        **{one.name: component.appendage_block(telescope, one) for one in others},
        "platform": _platform(telescope, isolated),
        "payload": _flexible(telescope, "payload", payload, set(PAYLOAD_NODES) - used, deflections=OPTICAL_POINTS),
        "fsm": fast_steering_mirror(
            FastSteeringMirror(fsm.mass, np.diag(fsm.inertia), fsm.stiffness, fsm.damping),
            "I_f",
            telescope.factors.get(MIRROR),
        ),
        "optics": line_of_sight(telescope),
        "steering": static_gain(
            telescope.fsm.los_sensitivity * np.eye(2), [Port("fsm_angle", 2, "rad")], [Port("los", 2, "rad")]
        ),
        **_drives(telescope),
        **_motors(telescope, outside),
        **_gains(telescope),
        **actuator_blocks(telescope, driven=driven),
        **sensor_blocks(telescope),
    }
    there = {
        SADM_ANGLE: telescope.driven_arrays,
        PMA_STROKE: telescope.pma.azimuths_deg,
    }
    absent = [name for name, bodies in there.items() if not bodies]
    outputs: dict[str, str | tuple[str, ...]] = {
        "wrench_G": "body.wrench_G",
        "accel_Ip": "platform.accel_platform",
        "accel_M1": "payload.accel_M1",
        "accel_M2": "payload.accel_M2",
        "los": "optics.los",
        "los_controlled": ("optics.los", "steering.los"),
        "fsm_angle": "fsm.fsm_angle",
        PMA_STROKE: "platform.pma_stroke",
        SADM_ANGLE: "sadm_join.sadm_angle",
        "wheel_accel": "wheels.wheel_accel",
        **sensor_outputs(telescope),
    }
    wires = [*_wires(), *_mounted_wires((*arrays, *others)), *_motor_wires(telescope, outside)]
    wires += [*actuator_wires(telescope, driven=driven), *sensor_wires(telescope)]
    wires = _through(wires, _gains(telescope))
    return connect(
        systems,
        _with_wrenches(wires, acting),
        inputs=[
            *(port("G") for port in (ports.accel, ports.angle, ports.rate)),
            Port(WHEEL_TORQUE, len(telescope.turning_wheels), "Nm"),
            *telescope.disturbance_ports,
            FSM_COMMAND,
            PMA_FORCE,
            *outside,
        ],
        outputs={name: source for name, source in outputs.items() if name not in absent},
    )


def _platform(telescope: Telescope, isolated: bool) -> System:
    """Platform of the payload on its isolator or fixed, with the proof-mass actuators that there are."""
    mass = component.platform_mass(telescope)
    plate = (
        isolator(
            Isolator(mass, np.diag(telescope.isolator.stiffness), np.diag(telescope.isolator.damping)),
            "I_p",
            "platform",
            stiffness=telescope.factors.get(STIFFNESS),
            damping=telescope.factors.get(DAMPING),
        )
        if isolated
        else rigid_body("platform", "I_p", mass, {"platform": np.zeros(3)}, motion=True)
    )
    actuators = component.actuator_components(telescope)
    if actuators:
        return actuated_platform(plate, actuators, "platform")
    wrench = ports.wrench("platform")
    none = static_gain(np.zeros((wrench.size, PMA_FORCE.size)), [PMA_FORCE], [wrench])
    driven = (wrench.name, f"none.{wrench.name}")
    return connect(
        {"plate": plate, "none": none},
        [
            *((driven if p == wrench else p.name, f"plate.{p.name}") for p in plate.inputs),
            (PMA_FORCE.name, f"none.{PMA_FORCE.name}"),
        ],
        inputs=[*plate.inputs, PMA_FORCE],
        outputs={p.name: f"plate.{p.name}" for p in plate.outputs},
    )


def _gains(telescope: Telescope) -> dict[str, System]:
    """Gains of the commanded ports that are uncertain, each by the name of its port."""
    known = telescope.factors
    commanded = ((port, f"{port.name}.{GAIN}") for port in (FSM_COMMAND, PMA_FORCE))
    return {port.name: uncertain_gain(port, known[name]) for port, name in commanded if name in known}


def _through(wires: list[Connection], gains: Mapping[str, System]) -> list[Connection]:
    """Wires from these inputs, led through the gains of their names."""
    turned = [(f"{source}.{source}", target) if source in gains else (source, target) for source, target in wires]
    return [*turned, *((name, f"{name}.{name}") for name in gains)]


def _drives(telescope: Telescope) -> dict[str, System]:
    """Distribution of the drive torques to the arrays and coupling of their angles; none without a driven array."""
    names = [array.name for array in telescope.driven_arrays]
    if not names:
        return {}
    each, torques = np.eye(len(names)), [Port(name, 1, "Nm") for name in names]
    angles, joined = [Port(name, 1, "rad") for name in names], Port(SADM_ANGLE, len(names), "rad")
    return {
        "sadm_split": static_gain(each, [Port(SADM_TORQUE, len(names), "Nm")], torques),
        "sadm_join": static_gain(each, angles, [joined]),
    }


def motor_ports(telescope: Telescope) -> tuple[Port, ...]:
    """Torques of the stepper motors and commands of the actuators at places; none where nothing has them."""
    count = len(telescope.motors)
    torques = (Port(MOTOR_TORQUE, count, "Nm"),) if count else ()
    return (*torques, *(actuator.port for actuator in telescope.placed_actuators))


def _array(telescope: Telescope, array: MountedBody, outside: tuple[Port, ...]) -> System:
    """Block of an array, with the torque of its motor where that is an input."""
    block = component.array_block(telescope, array)
    if any(port.name == MOTOR_TORQUE for port in outside):
        return block
    return block.select(inputs=[p.name for p in block.inputs if p.name != MOTOR])


def _motors(telescope: Telescope, outside: tuple[Port, ...]) -> dict[str, System]:
    """Distribution of the motor torques."""
    torques = [Port(array.name, 1, "Nm") for array in telescope.motors]
    whole = [port for port in outside if port.name == MOTOR_TORQUE]
    return {"motor_split": static_gain(np.eye(len(torques)), whole, torques)} if whole else {}


def _motor_wires(telescope: Telescope, outside: tuple[Port, ...]) -> list[Connection]:
    if not _motors(telescope, outside):
        return []
    parts = [(f"motor_split.{one.name}", f"{one.name}.{MOTOR}") for one in telescope.motors]
    return [(MOTOR_TORQUE, f"motor_split.{MOTOR_TORQUE}"), *parts]


def _wires() -> list[Connection]:
    return [
        *((f"{kind}_G", f"body.{kind}_G") for kind in ("accel", "angle", "rate")),
        ("body.accel_I_w", "wheels.accel_I_w"),
        ("body.rate_I_w", "wheels.rate_I_w"),
        *((f"body.{kind}_I_p", f"platform.{kind}_I_p") for kind in ("accel", "angle", "rate")),
        ("payload.wrench_I_p", "platform.wrench_platform"),
        ("platform.accel_platform", "payload.accel_I_p"),
        ("payload.accel_I_f", "fsm.accel_I_f"),
        ("fsm.wrench_I_f", "payload.wrench_I_f"),
        ("platform.angle_platform", "optics.angle_I_p"),
        *((f"payload.deflection_{p}", f"optics.deflection_{p}") for p in OPTICAL_POINTS),
        ("fsm.fsm_angle", "steering.fsm_angle"),
        ("wheel_torque", "wheels.wheel_torque"),
        ("wheel_imbalance", "wheels.imbalance"),
        ("fsm_command", "fsm.fsm_command"),
        ("pma_force", "platform.pma_force"),
    ]


def _mounted_wires(bodies: Sequence[MountedBody]) -> list[Connection]:
    """Motion of each point to what is mounted there, the sum of its wrenches back to the central body."""
    wires: list[Connection] = []
    wrenches: dict[str, list[str]] = {"I_w": ["wheels.wrench_I_w"], "I_p": ["platform.wrench_I_p"]}
    for one in bodies:
        wires.append((f"body.accel_{one.point}", f"{one.name}.accel_{one.point}"))
        wrenches.setdefault(one.point, []).append(f"{one.name}.wrench_{one.point}")
    driven = [one for one in bodies if one.drive is not None]
    for one in driven:
        wires += [
            (f"sadm_split.{one.name}", f"{one.name}.sadm_torque"),
            (f"{one.name}.sadm_angle", f"sadm_join.{one.name}"),
        ]
    if driven:
        wires.append((SADM_TORQUE, f"sadm_split.{SADM_TORQUE}"))
    return wires + [(tuple(parts), f"body.wrench_{point}") for point, parts in wrenches.items()]


def _with_wrenches(wires: list[Connection], acting: Sequence[tuple[str, str]]) -> list[Connection]:
    """Add wrenches, each of a source and on a node, to what acts on their nodes."""
    result = list(wires)
    for source, node in acting:
        target = f"{body_of(node)}.wrench_{node}"
        at = next((i for i, wire in enumerate(result) if wire[1] == target), None)
        if at is None:
            result.append((source, target))
        else:
            before = result[at][0]
            result[at] = ((*((before,) if isinstance(before, str) else before), source), target)
    return result


def _flexible(telescope: Telescope, kind: str, data: ModalData, idle: set[str], **options: Any) -> System:
    """Central body or payload with its uncertain modes, without the wrench inputs of the idle points."""
    # Remove the wrench inputs of points without an attached body
    body = flexible_body(data, **factors_of_modes(telescope.factors, kind, data.n_modes), **options)
    loads = {f"wrench_{point}" for point in idle}
    if not loads:
        return body
    return body.select(inputs=[p.name for p in body.inputs if p.name not in loads])


def _free_flying(
    free: System, telescope: Telescope, inertia: FloatArray, controlled: bool, outside: tuple[Port, ...]
) -> System:
    """Free motion of G: the wrench of all bodies there balances the external one; close the attitude loop."""
    table = telescope.attitude_control
    law = attitude_control(
        np.diag(inertia),
        telescope.wheel_axes[:, telescope.turning_wheels],
        bandwidth=table.bandwidth,
        damping=table.damping,
    )
    torques: tuple[str, ...] = ("wheel_torque", "law.wheel_torque") if controlled else ("wheel_torque",)
    systems = {"free": free, "attitude": attitude("G")}
    wires: list[Connection] = [
        ("-external_wrench", "free.wrench_G"),
        ("free.accel_G", "attitude.accel_G"),
        (torques, "free.wheel_torque"),
    ]
    if controlled:
        systems["law"] = law
    for kind in ("angle", "rate"):
        wires.append((f"attitude.{kind}_G", f"free.{kind}_G"))
        if controlled:
            wires.append((f"attitude.{kind}_G", f"law.{kind}_G"))
    plain = [p for p in free.inputs if p.name not in ("wrench_G", "angle_G", "rate_G", "wheel_torque")]
    wires += [(p.name, f"free.{p.name}") for p in plain]
    return connect(
        systems,
        wires,
        inputs=[
            *telescope.disturbance_ports,
            EXTERNAL_WRENCH,
            Port(WHEEL_TORQUE, len(telescope.turning_wheels), "Nm"),
            FSM_COMMAND,
            PMA_FORCE,
            *outside,
        ],
        outputs={
            **{p.name: f"free.{p.name}" for p in free.outputs if p.name != "accel_G"},
            "attitude": "attitude.angle_G",
            "attitude_rate": "attitude.rate_G",
            "accel_G": "free.accel_G",
        },
    )
