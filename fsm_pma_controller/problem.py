"""The design problem of K_PMA on top of a given observer K_FSM.

Plant: telescope with the mirror loop closed. The controller is of order 4, from the platform's six accelerometer
signals behind their washout to the six actuator forces.

=============  ======  =============================================================================
requirement    kind    value 1 means
=============  ======  =============================================================================
APE            soft    normalised disturbances make 10 arcsec of line of sight (H-infinity)
RPE            soft    they make 40 mas through the weight of 20 ms (H-infinity)
noise -> APE   soft    accelerometer noise at the platform makes 10 arcsec rms (H2)
force          hard    they ask for 15.8 N, half of the authority (H-infinity)
noise -> RPE   soft    all sensor noise makes 100 mas rms (H2), as implemented only
=============  ======  =============================================================================

Source: the paper, equation of the PMA synthesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lti import Connection, Port, StateSpace, UncertainSystem, connect, static_gain
from lti.delay import delayed_port
from robust_design import H2Gain, HinfGain, Requirement, state_space
from robust_design.structures import AffineStructure
from titop_plant.interface import COMMAND_PORTS, K_PMA_INPUTS, PLATFORM
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.control_plant import ACCELEROMETER_NOISE, DISTURBANCES, OPTICAL_NOISE, control_plant
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import disturbance_weight, relative_error_weight

MEASUREMENTS = tuple(port.name for port in K_PMA_INPUTS)
ORDER = 4
MIRROR_COMMAND, FORCE = COMMAND_PORTS
PADE_ORDER = 3
FORCE_SHARE = 0.5
"""Part of the actuators' authority that the design may ask for."""


@dataclass(frozen=True)
class ActuatorPlant:
    """Generalised plant of K_PMA as a function of the parameter values (see :class:`robust_design.StateSpace`)."""

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
    systems = {"plant": plant, "observer": observer, "law": law, "late": late, "noise": noise}
    wires: list[Connection] = [
        *((name, f"plant.{name}") for name in (*DISTURBANCES, OPTICAL_NOISE.name, "pma_force")),
        (n_base.name, "noise.platform"),
        (n_mirrors.name, "noise.mirrors"),
        ("noise.accelerometer_noise", "plant.accelerometer_noise"),
        *((f"plant.{p.name}", f"observer.{p.name}") for p in observer.inputs),
        ("observer.los_estimate", "law.los_estimate"),
        ("law.fsm_command", "late.fsm_command"),
        ("late.fsm_command", "plant.fsm_command"),
    ]
    inputs = [plant.input_port(n) for n in (*DISTURBANCES, OPTICAL_NOISE.name)] + [n_base, n_mirrors, FORCE]
    closed = connect(
        systems,
        wires,
        inputs=inputs,
        outputs={"los_controlled": "plant.los_controlled", "accel_Ip": "plant.accel_Ip",
                 "fsm_command": "law.fsm_command"},
    )  # fmt: skip
    return ActuatorPlant(_with_echo(closed))


def _with_echo(plant: UncertainSystem) -> UncertainSystem:
    """Show the force command as an output, too."""
    return connect(
        {"plant": plant, "echo": static_gain(np.eye(FORCE.size), [FORCE], [FORCE])},
        [*((p.name, f"plant.{p.name}") for p in plant.inputs), (FORCE.name, f"echo.{FORCE.name}")],
        inputs=plant.inputs,
        outputs={**{p.name: f"plant.{p.name}" for p in plant.outputs}, FORCE.name: f"echo.{FORCE.name}"},
    )


def actuator_requirements(parameters: Parameters, *, implemented: bool) -> tuple[Requirement, ...]:
    """Requirements of K_PMA (see the module's table), in the order of the paper's gammas."""
    weights = parameters["weights"]
    expected = disturbance_weight(parameters).data_at({}).renamed("W_rws, W_sa")
    relative = relative_error_weight(weights["rpe_window"]).data_at({}).renamed("W_RPE")
    ape, fine, los = weights["ape_limit"], weights["rpe_limit_fine"], "los_controlled"
    paper: tuple[Requirement, ...] = (
        HinfGain(DISTURBANCES, (los,), ape, weight_in=expected, name="APE"),
        HinfGain(DISTURBANCES, (los,), fine, weight_in=expected, weight_out=relative, name="RPE"),
        H2Gain(("platform_noise",), (los,), ape, name="noise -> APE"),
        HinfGain(DISTURBANCES, ("pma_force",), FORCE_SHARE * parameters["pma"]["authority"], weight_in=expected,
                 hard=True, name="force"),
    )  # fmt: skip
    if not implemented:
        return paper
    everything = ("platform_noise", "mirror_noise", OPTICAL_NOISE.name)
    return (*paper, H2Gain(everything, (los,), weights["rpe_limit"], weight_out=relative, name="noise -> RPE"))


def actuator_structure(plant: ActuatorPlant, *, order: int = ORDER) -> AffineStructure:
    """State space of fixed order from the platform's accelerations to the forces, all entries free."""
    ports = [plant.system.output_port(name) for name in MEASUREMENTS]
    return state_space(ports, [FORCE], order)
