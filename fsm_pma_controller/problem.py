"""The design problem of K_PMA on top of a given observer K_FSM.

Plant: telescope with the mirror loop closed. The controller is of order 4, from the platform's six accelerometer
signals behind their washout to the six actuator forces.

===================  ====  ====================================================================================
requirement          kind  value 1 means
===================  ====  ====================================================================================
APE                  soft  normalised disturbances make the APE limit of line of sight (H-infinity)
RPE                  soft  they make the RPE limit of both through its weight (H-infinity); the paper's problem only
fast                 soft  the same for tones above 85 rad/s, with the amplitude of the budget; as implemented
slow                 hard  the same below 85 rad/s, with the amplitude that the budget leaves; as implemented
noise -> APE         soft  accelerometer noise at the platform makes the APE limit, rms (H2); the paper's problem only
noise -> RPE         hard  all sensor noise makes the share of the budget (H2); as implemented
force                hard  disturbances ask for 15.8 N, half of the authority (H-infinity)
mirror               hard  they ask for 5.3 mrad of mirror (H-infinity); as implemented
sensitivity, mirror  hard  the sensitivity at the mirror's command has a peak of 2; as implemented
sensitivity, forces  hard  the same at the forces together; as implemented
===================  ====  ====================================================================================

As implemented APE is hard: the mirror alone keeps it, and the actuators cannot change it.

Source: the paper, equation of the PMA synthesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lftkit import Connection, Port, StateSpace, UncertainSystem, connect, static_gain
from lftkit.systems.delay import delayed_port
from lftkit.tuning import H2Gain, HinfGain, Requirement, state_space
from lftkit.tuning.structures import AffineStructure
from titop_plant.interface import COMMAND_PORTS, K_PMA_INPUTS, PLATFORM
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.budget import MAX_SENSITIVITY, TUNED_FORCE_SENSITIVITY, band_error_weight, error_budget
from titop_plant.telescope.control_plant import ACCELEROMETER_NOISE, DISTURBANCES, OPTICAL_NOISE, control_plant
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import disturbance_weight, relative_error_weight

MEASUREMENTS = tuple(port.name for port in K_PMA_INPUTS)
ORDER = 4
MIRROR_COMMAND, FORCE = COMMAND_PORTS
ADDED_COMMAND, ADDED_FORCE = (Port(f"added_{p.name}", p.size, p.unit) for p in COMMAND_PORTS)
APPLIED_COMMAND, APPLIED_FORCE = (f"applied_{p.name}" for p in COMMAND_PORTS)
"""Where the sensitivities are taken: inputs that are added to the commands, and the sums, which drive the plant."""
PADE_ORDER = 3
FORCE_SHARE = 0.5
"""Part of the actuators' authority that the design may ask for."""


@dataclass(frozen=True)
class ActuatorPlant:
    """Generalised plant of K_PMA as a function of the parameter values (see :class:`lftkit.tuning.StateSpace`)."""

    system: UncertainSystem

    def __call__(self, values: Mapping[str, float]) -> StateSpace:
        """Plant at the given values (others nominal)."""
        name = ", ".join(f"{n}={v:.4g}" for n, v in values.items()) or "nominal"
        return self.system.data_at(values).renamed(name)


def actuator_plant(
    telescope: Telescope,
    parameters: Parameters,
    observer: UncertainSystem,
    *,
    loop_delay: float = 0.0,
    camera_period: float = 0.0,
    command_hold: float = 0.0,
) -> ActuatorPlant:
    """Plant that K_PMA is designed on: the mirror loop is closed.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameter file.
    observer : UncertainSystem
        Continuous K_FSM, 22 measurements to ``los_estimate``.
    loop_delay : float
        Delay of the mirror's command beyond its hold [s].
    camera_period : float
        Time that a camera frame is held [s].
    command_hold : float
        Mean delay of held commands [s]: this part of the loop delay is in the plant, not the tuner's.
    """
    plant = control_plant(telescope.system, parameters, camera_period=camera_period, command_hold=command_hold)
    platform = PLATFORM.stop - PLATFORM.start
    n_base, n_mirrors = Port("platform_noise", platform), Port("mirror_noise", ACCELEROMETER_NOISE.size - platform)
    mirror = MIRROR_COMMAND
    late = delayed_port(mirror, loop_delay, PADE_ORDER)
    estimate = observer.output_port("los_estimate")
    law = static_gain(-np.eye(2) / parameters["fsm"]["los_sensitivity"], [estimate], [mirror])
    parts = [Port("platform", n_base.size), Port("mirrors", n_mirrors.size)]
    noise = static_gain(np.eye(ACCELEROMETER_NOISE.size), parts, [ACCELEROMETER_NOISE])
    total = static_gain(np.eye(mirror.size), [mirror], [mirror])
    systems = {"plant": plant, "observer": observer, "law": law, "late": late, "noise": noise, "total": total}
    wires: list[Connection] = [
        *((name, f"plant.{name}") for name in (*DISTURBANCES, OPTICAL_NOISE.name, "pma_force")),
        (n_base.name, "noise.platform"),
        (n_mirrors.name, "noise.mirrors"),
        ("noise.accelerometer_noise", "plant.accelerometer_noise"),
        *((f"plant.{p.name}", f"observer.{p.name}") for p in observer.inputs),
        ("observer.los_estimate", "law.los_estimate"),
        ("law.fsm_command", "late.fsm_command"),
        (("late.fsm_command", ADDED_COMMAND.name), "total.fsm_command"),
        ("total.fsm_command", "plant.fsm_command"),
    ]
    inputs = [plant.input_port(n) for n in (*DISTURBANCES, OPTICAL_NOISE.name)]
    inputs += [n_base, n_mirrors, ADDED_COMMAND, FORCE]
    closed = connect(
        systems,
        wires,
        inputs=inputs,
        outputs={
            "los_controlled": "plant.los_controlled",
            "accel_Ip": "plant.accel_Ip",
            "fsm_command": "law.fsm_command",
            APPLIED_COMMAND: "total.fsm_command",
        },
    )
    return ActuatorPlant(_with_added_force(closed))


def _with_added_force(plant: UncertainSystem) -> UncertainSystem:
    """Add a force to that of the controller; show the controller's and the sum as outputs."""
    unit, applied = static_gain(np.eye(FORCE.size), [FORCE], [FORCE]), f"total.{FORCE.name}"
    others = [p for p in plant.inputs if p.name != FORCE.name]
    return connect(
        {"plant": plant, "own": unit, "total": unit},
        [
            *((p.name, f"plant.{p.name}") for p in others),
            (FORCE.name, f"own.{FORCE.name}"),
            ((FORCE.name, ADDED_FORCE.name), applied),
            (applied, f"plant.{FORCE.name}"),
        ],
        inputs=(*others, ADDED_FORCE, FORCE),
        outputs={
            **{p.name: f"plant.{p.name}" for p in plant.outputs},
            FORCE.name: f"own.{FORCE.name}",
            APPLIED_FORCE: applied,
        },
    )


def actuator_requirements(parameters: Parameters, *, implemented: bool) -> tuple[Requirement, ...]:
    """Requirements of K_PMA (see the module's table); of the paper's problem in the order of its gammas."""
    weights = parameters["weights"]
    expected = disturbance_weight(parameters).data_at({}).renamed("W_rws, W_sa")
    relative = relative_error_weight(weights["rpe_window"]).data_at({}).renamed("W_RPE")
    ape, los = weights["ape_limit"], ("los_controlled",)
    pointing = HinfGain(DISTURBANCES, los, ape, weight_in=expected, hard=implemented, name="APE")
    force = HinfGain(
        DISTURBANCES,
        (FORCE.name,),
        FORCE_SHARE * parameters["pma"]["authority"],
        weight_in=expected,
        hard=True,
        name="force",
    )
    if not implemented:
        fine = weights["rpe_limit_fine"]
        return (
            pointing,
            HinfGain(DISTURBANCES, los, fine, weight_in=expected, weight_out=relative, name="RPE"),
            H2Gain(("platform_noise",), los, ape, name="noise -> APE"),
            force,
        )
    budget = error_budget(parameters)
    slow, fast = (band_error_weight(parameters, band) for band in ("slow", "fast"))
    everything = ("platform_noise", "mirror_noise", OPTICAL_NOISE.name)
    authority = parameters["fsm"]["authority"]
    return (
        pointing,
        HinfGain(DISTURBANCES, los, budget.fast, weight_in=expected, weight_out=fast, name="fast"),
        HinfGain(DISTURBANCES, los, budget.tone, weight_in=expected, weight_out=slow, hard=True, name="slow"),
        H2Gain(everything, los, budget.total_noise, weight_out=relative, hard=True, name="noise -> RPE"),
        force,
        HinfGain(DISTURBANCES, (MIRROR_COMMAND.name,), authority, weight_in=expected, hard=True, name="mirror"),
        *(
            HinfGain((added.name,), (applied,), bound, hard=True, name=f"sensitivity, {name}")
            for name, added, applied, bound in (
                ("mirror", ADDED_COMMAND, APPLIED_COMMAND, MAX_SENSITIVITY),
                ("forces", ADDED_FORCE, APPLIED_FORCE, TUNED_FORCE_SENSITIVITY),
            )
        ),
    )


def actuator_structure(plant: ActuatorPlant, *, order: int = ORDER) -> AffineStructure:
    """State space of fixed order from the platform's accelerations to the forces, all entries free."""
    ports = [plant.system.output_port(name) for name in MEASUREMENTS]
    return state_space(ports, [FORCE], order)
