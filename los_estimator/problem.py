"""The design problem of K_FSM: its generalised plant, controller structure and start.

Plant: telescope, sensors with their filters, mirror driven by ``-estimate / los_sensitivity``. The observer is a
controller of order 4 from the 22 measurements to the estimated line of sight.

requirement       kind  value 1 means
================  ====  ==============================================================================================
APE               soft  disturbances make the APE limit (H-infinity); as implemented the share of a tone
all noise -> APE  soft  sensor noise makes the noise's share of that limit, rms (H2); as implemented
RPE               soft  they make its limit of the mirror alone through its weight (H-infinity); the paper's problem
slow, fast        soft  the same for tones below and above 85 rad/s, with the amplitudes of the budget; as implemented
noise -> APE      hard  noise of the platform's accelerometers makes half of its power, rms (H2); the paper's problem
noise -> RPE      soft  sensor noise makes the share of the budget, through the weight of 20 ms (H2); as implemented
mirror            hard  disturbances ask for 5.3 mrad of mirror (H-infinity)
sensitivity       hard  the sensitivity at the mirror's command has a peak of 2; as implemented
================  ====  ==============================================================================================

What is asked of it is :func:`los_loop.figures_of_merit.paper_figures` of the stage ``fsm`` with that noise, or the
figures of the implemented loop; :mod:`los_design.synthesis.state_space_requirements` brings them to the ports of this
plant.

Source: the paper, equation of the FSM synthesis. As implemented: 1.5 ms of loop delay (one tick and the hold), a camera
whose frames are held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lftkit import Port, System, connect, static_gain, transform
from lftkit.arrays import FloatArray
from lftkit.reduction.balancing import balanced_truncation
from lftkit.tuning import state_space
from lftkit.tuning.nested_orders import with_decaying_states
from lftkit.tuning.structures.structures import AffineStructure
from los_estimator.kalman import kalman_observer
from titop_plant.interface import COMMAND_PORTS, ESTIMATE_PORTS, HELD, MEASURED_PORTS
from titop_plant.telescope.control_plant import NOISE_PORTS, control_plant, disturbances_of
from titop_plant.telescope.telescope import Telescope

NOISE = tuple(dict.fromkeys(NOISE_PORTS.values()))
ORDER = 4
FURTHER_POLES = (20.0, 400.0)
"""Between these [rad/s] are the poles of the states that a start of higher order has more: the isolator's band."""
(ESTIMATE,) = ESTIMATE_PORTS
ADDED = Port("added_estimate", ESTIMATE.size, ESTIMATE.unit)
APPLIED = "applied_estimate"
"""Where the sensitivity is taken: an input that is added to the estimate, and their sum, which drives the mirror."""
SENSITIVITY_PORTS = {COMMAND_PORTS[0].name: (ADDED.name, APPLIED)}
"""Input and output of the sensitivity at a command."""


@dataclass(frozen=True)
class ObserverPlant:
    """Generalised plant of K_FSM as a function of the parameter values.

    Calling it with values gives a :class:`lftkit.System` with the disturbance, noise and estimate
    ports in, line of sight, mirror command and measurements out.
    """

    system: System

    def __call__(self, values: Mapping[str, float]) -> System:
        """Plant at the given values (others nominal)."""
        return self.system.at(values).named(describe(values))


def describe(values: Mapping[str, float]) -> str:
    """Short name of a parameter point."""
    return ", ".join(f"{name}={value:.4g}" for name, value in values.items()) or "nominal"


def observer_plant(telescope: Telescope, *, sampled: bool = False, command_hold: float = 0.0) -> ObserverPlant:
    """Plant that K_FSM is designed on.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameter file.
    sampled : bool
        Whether values of slower sensors are held; otherwise all are continuous, as in the paper.
    command_hold : float
        Mean delay of a held command [s] (:data:`titop_plant.interface.HOLD_DELAY`): this part of
        the loop delay is in the plant, not the tuner's.
    """
    plant = control_plant(telescope, sampled=sampled, command_hold=command_hold)
    mirror = -np.eye(2) / telescope.fsm.los_sensitivity
    inputs = (*disturbances_of(plant), *NOISE, "fsm_command")
    driven = transform(plant.select(inputs=inputs), inputs={"fsm_command": (mirror, ESTIMATE)})
    command, applied = COMMAND_PORTS[0], f"sum.{ESTIMATE.name}"
    law, total = static_gain(mirror, [ESTIMATE], [command]), static_gain(np.eye(2), [ESTIMATE], [ESTIMATE])
    others = [p for p in driven.inputs if p != ESTIMATE]
    system = connect(
        {"plant": driven, "law": law, "sum": total},
        [
            *((p.name, f"plant.{p.name}") for p in others),
            ((ESTIMATE.name, ADDED.name), applied),
            (applied, f"plant.{ESTIMATE.name}"),
            (ESTIMATE.name, f"law.{ESTIMATE.name}"),
        ],
        inputs=(*others, ADDED, ESTIMATE),
        outputs={
            **{p.name: f"plant.{p.name}" for p in driven.outputs},
            command.name: "law.fsm_command",
            APPLIED: applied,
        },
    )
    return ObserverPlant(system)


def observer_structure(plant: ObserverPlant, *, order: int = ORDER, camera_hold: bool = False) -> AffineStructure:
    """State space of fixed order from the measurements to the estimate.

    Parameters
    ----------
    plant : ObserverPlant
    order : int
    camera_hold : bool
        No direct path from values that are held to the estimate: their steps would excite the mirror at the frame
        rate. Otherwise all entries are free.
    """
    free = state_space([plant.system.output_port(port.name) for port in MEASURED_PORTS], [ESTIMATE], order)
    if not camera_hold:
        return free
    return free.with_fixed({(order + i, order + j): 0.0 for i in range(ESTIMATE.size) for j in HELD.tolist()})


def kalman_start(structure: AffineStructure, telescope: Telescope, *, lead: float = 0.0) -> FloatArray:
    """The Kalman observer of the structure's order as a start of the tuner."""
    return np.asarray(structure.parameters_of(kalman_of_order(structure.order, telescope, lead=lead)))


def kalman_of_order(order: int, telescope: Telescope, *, lead: float = 0.0) -> System:
    """The Kalman observer with more or fewer states.

    For lower orders it is truncated (balanced); for higher ones it has more states, which decay and act on nothing.
    """
    guess = kalman_observer(telescope, lead=lead).at({}).named("K_est")
    if order < guess.order:
        return balanced_truncation(guess, order)
    return with_decaying_states(guess, np.geomspace(*FURTHER_POLES, order - guess.order), seed=0)
