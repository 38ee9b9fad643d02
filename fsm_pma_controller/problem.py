"""The design problem of K_PMA on top of a given observer K_FSM.

Plant: telescope with the mirror loop closed. The controller is of order 4, from the platform's six accelerometer
signals behind their washout to the six actuator forces.

requirement          kind  value 1 means
===================  ====  ====================================================================================
APE                  soft  normalised disturbances make the APE limit of line of sight (H-infinity)
RPE                  soft  they make the RPE limit of both through its weight (H-infinity); the paper's problem only
fast                 soft  the same for tones above 85 rad/s, with the amplitude of the budget; as implemented
slow                 hard  the same below 85 rad/s, with the amplitude that the budget leaves; as implemented
noise -> APE         soft  accelerometer noise at the platform makes the APE limit, rms (H2); the paper's problem only
all noise -> APE     hard  all sensor noise makes the share of its budget, rms (H2); as implemented
noise -> RPE         hard  all sensor noise makes the share of the budget (H2); as implemented
force                hard  disturbances ask for 31.6 N (H-infinity), half of it as implemented
mirror               hard  they ask for 5.3 mrad of mirror (H-infinity); as implemented
sensitivity, mirror  hard  the sensitivity at the mirror's command has a peak of 2; as implemented
sensitivity, forces  hard  the same at the forces together; as implemented
===================  ====  ====================================================================================

As implemented APE is hard: the mirror alone keeps it, and the actuators cannot change it.

What is asked of it is :func:`los_loop.figures_of_merit.paper_figures` of the stage ``fsm+pma``, or the figures of the
implemented loop; :mod:`los_design.synthesis.state_space_requirements` brings them to the ports of this plant.

Source: the paper, equation of the PMA synthesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lftkit import Connection, Port, SampledSystem, System, connect, static_gain
from lftkit.systems.connection.filters import high_pass, with_input_filter
from lftkit.systems.delay import delayed_port
from lftkit.systems.sampling import sampled
from titop_plant.interface import COMMAND_PORTS, DT, K_PMA_INPUTS, DesignBasis
from titop_plant.telescope.control_plant import NOISE_PORTS as PLANT_NOISE_PORTS
from titop_plant.telescope.control_plant import OPTICAL_NOISE, control_plant, disturbances_of
from titop_plant.telescope.telescope import Telescope

MEASURED_NAMES = tuple(port.name for port in K_PMA_INPUTS)
ORDER = 4
MIRROR_COMMAND, FORCE = COMMAND_PORTS
ADDED_COMMAND, ADDED_FORCE = (Port(f"added_{p.name}", p.size, p.unit) for p in COMMAND_PORTS)
APPLIED_COMMAND, APPLIED_FORCE = (f"applied_{p.name}" for p in COMMAND_PORTS)
"""Where the sensitivities are taken: inputs that are added to the commands, and the sums, which drive the plant."""
PADE_ORDER = 3
PLATFORM_NOISE, MIRRORS_NOISE = "platform_noise", "mirror_noise"
NOISE_PORTS = {
    **{name: port if port == OPTICAL_NOISE.name else MIRRORS_NOISE for name, port in PLANT_NOISE_PORTS.items()},
    **dict.fromkeys(MEASURED_NAMES, PLATFORM_NOISE),
}
"""Input of the noise of each measured port."""
SENSITIVITY_PORTS = {
    MIRROR_COMMAND.name: (ADDED_COMMAND.name, APPLIED_COMMAND),
    FORCE.name: (ADDED_FORCE.name, APPLIED_FORCE),
}
"""Input and output of the sensitivity at a command."""


@dataclass(frozen=True)
class ActuatorPlant:
    """Generalised plant of K_PMA as a function of the parameter values (see :class:`lftkit.System`)."""

    system: System

    def __call__(self, values: Mapping[str, float]) -> System:
        """Plant at the given values (others nominal)."""
        name = ", ".join(f"{n}={v:.4g}" for n, v in values.items()) or "nominal"
        return self.system.at(values).named(name)


def actuator_plant(
    telescope: Telescope,
    observer: System,
    *,
    loop_delay: float = 0.0,
    sampled: bool = False,
    command_hold: float = 0.0,
) -> ActuatorPlant:
    """Plant that K_PMA is designed on: the mirror loop is closed.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameter file.
    observer : System
        Continuous K_FSM, measurements to ``los_estimate``.
    loop_delay : float
        Delay of the mirror's command beyond its hold [s].
    sampled : bool
        Whether values of slower sensors are held; otherwise all are continuous, as in the paper.
    command_hold : float
        Mean delay of held commands [s]: this part of the loop delay is in the plant, not the tuner's.
    """
    plant = control_plant(telescope, sampled=sampled, command_hold=command_hold)
    (measured,), together = K_PMA_INPUTS, plant.input_port(PLANT_NOISE_PORTS[K_PMA_INPUTS[0].name])
    n_base, n_mirrors = Port(PLATFORM_NOISE, measured.size), Port(MIRRORS_NOISE, together.size - measured.size)
    mirror = MIRROR_COMMAND
    late = delayed_port(mirror, loop_delay, PADE_ORDER)
    estimate = observer.output_port("los_estimate")
    law = static_gain(-np.eye(2) / telescope.fsm.los_sensitivity, [estimate], [mirror])
    parts = [Port("platform", n_base.size), Port("mirrors", n_mirrors.size)]
    noise = static_gain(np.eye(together.size), parts, [together])
    total = static_gain(np.eye(mirror.size), [mirror], [mirror])
    systems = {"plant": plant, "observer": observer, "law": law, "late": late, "noise": noise, "total": total}
    wires: list[Connection] = [
        *((name, f"plant.{name}") for name in (*disturbances_of(plant), OPTICAL_NOISE.name, "pma_force")),
        (n_base.name, "noise.platform"),
        (n_mirrors.name, "noise.mirrors"),
        (f"noise.{together.name}", f"plant.{together.name}"),
        *((f"plant.{p.name}", f"observer.{p.name}") for p in observer.inputs),
        ("observer.los_estimate", "law.los_estimate"),
        ("law.fsm_command", "late.fsm_command"),
        (("late.fsm_command", ADDED_COMMAND.name), "total.fsm_command"),
        ("total.fsm_command", "plant.fsm_command"),
    ]
    inputs = [plant.input_port(n) for n in (*disturbances_of(plant), OPTICAL_NOISE.name)]
    inputs += [n_base, n_mirrors, ADDED_COMMAND, FORCE]
    closed = connect(
        systems,
        wires,
        inputs=inputs,
        outputs={
            "los_controlled": "plant.los_controlled",
            measured.name: f"plant.{measured.name}",
            "fsm_command": "law.fsm_command",
            APPLIED_COMMAND: "total.fsm_command",
        },
    )
    return ActuatorPlant(_with_added_force(closed))


def _with_added_force(plant: System) -> System:
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


def sampled_controller(
    controller: System,
    washout: float,
    *,
    name: str,
    basis: DesignBasis | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sampled proof-mass law with the washout F_w on its accelerometers (6 more states)."""
    filtered = with_input_filter(controller, {port.name: high_pass(port, washout) for port in controller.inputs})
    found = sampled(filtered, DT, name=name, provenance=provenance)
    return replace(found, design_basis=(basis or DesignBasis()).to_mapping())
