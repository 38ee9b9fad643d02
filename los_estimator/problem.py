"""The design problem of K_FSM: requirements of the paper, and those of the implemented loop.

Plant: telescope, sensors with their filters, mirror driven by ``-estimate / los_sensitivity``. The observer is a
controller of order 4 from the 22 measurements to the estimated line of sight.

=============  ======  =============================================================================
requirement    kind    value 1 means
=============  ======  =============================================================================
APE            soft    normalised disturbances make 10 arcsec of line of sight (H-infinity)
RPE            soft    they make 100 mas through the weight of 20 ms (H-infinity)
mirror         hard    they ask for 5.3 mrad of mirror (H-infinity)
noise -> APE   soft    sensor noise makes 10 arcsec rms (H2), as implemented only
noise -> RPE   soft    sensor noise makes 100 mas rms (H2), as implemented only
=============  ======  =============================================================================

Source: the paper, equation of the FSM synthesis. As implemented: 1.5 ms of loop delay (one tick and the hold), a camera
whose frames are held, and the noise requirements, without which the tuned observer amplifies the accelerometers' noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from los_estimator.kalman import kalman_observer
from lti import StateSpace, UncertainSystem, connect, static_gain, transform
from robust_design import H2Gain, HinfGain, Requirement, state_space
from robust_design.structures import AffineStructure
from titop_plant.interface import CAMERA, COMMAND_PORTS, ESTIMATE_PORTS, MEASURED
from titop_plant.structures.kinematics import FloatArray
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.control_plant import ACCELEROMETER_NOISE, DISTURBANCES, OPTICAL_NOISE, control_plant
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import disturbance_weight, relative_error_weight

NOISE = (ACCELEROMETER_NOISE.name, OPTICAL_NOISE.name)
ORDER = 4
(ESTIMATE,) = ESTIMATE_PORTS


@dataclass(frozen=True)
class ObserverPlant:
    """Generalised plant of K_FSM as a function of the parameter values.

    Calling it with values gives a :class:`robust_design.StateSpace` with the disturbance, noise and estimate
    ports in, line of sight, mirror command and measurements out.
    """

    system: UncertainSystem

    def __call__(self, values: Mapping[str, float]) -> StateSpace:
        """Plant at the given values (others nominal)."""
        return self.system.data_at(values).renamed(describe(values))


def describe(values: Mapping[str, float]) -> str:
    """Short name of a parameter point."""
    return ", ".join(f"{name}={value:.4g}" for name, value in values.items()) or "nominal"


def observer_plant(
    telescope: Telescope, parameters: Parameters, *, camera_period: float = 0.0, command_hold: float = 0.0
) -> ObserverPlant:
    """Plant that K_FSM is designed on.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameter file.
    camera_period : float
        Time that a camera frame is held [s]; 0: the paper's continuous camera.
    command_hold : float
        Mean delay of a held command [s] (:data:`titop_plant.interface.HOLD_DELAY`): this part of
        the loop delay is in the plant, not the tuner's.
    """
    plant = control_plant(telescope.system, parameters, camera_period=camera_period, command_hold=command_hold)
    mirror = -np.eye(2) / parameters["fsm"]["los_sensitivity"]
    inputs = (*DISTURBANCES, *NOISE, "fsm_command")
    driven = transform(plant.select(inputs=inputs), inputs={"fsm_command": (mirror, ESTIMATE)})
    command = COMMAND_PORTS[0]
    system = connect(
        {"plant": driven, "law": static_gain(mirror, [ESTIMATE], [command])},
        [*((p.name, f"plant.{p.name}") for p in driven.inputs), (ESTIMATE.name, "law.los_estimate")],
        inputs=driven.inputs,
        outputs={**{p.name: f"plant.{p.name}" for p in driven.outputs}, command.name: "law.fsm_command"},
    )
    return ObserverPlant(system)


def observer_requirements(parameters: Parameters, *, implemented: bool) -> tuple[Requirement, ...]:
    """Requirements of K_FSM (see the module's table); `implemented` adds the two on sensor noise."""
    weights = parameters["weights"]
    expected = disturbance_weight(parameters).data_at({}).renamed("W_rws, W_sa")
    relative = relative_error_weight(weights["rpe_window"]).data_at({}).renamed("W_RPE")
    ape, rpe, los = weights["ape_limit"], weights["rpe_limit"], "los_controlled"
    paper: tuple[Requirement, ...] = (
        HinfGain(DISTURBANCES, (los,), ape, weight_in=expected, name="APE"),
        HinfGain(DISTURBANCES, (los,), rpe, weight_in=expected, weight_out=relative, name="RPE"),
        HinfGain(DISTURBANCES, ("fsm_command",), parameters["fsm"]["authority"], weight_in=expected, hard=True,
                 name="mirror"),
    )  # fmt: skip
    noise: tuple[Requirement, ...] = (
        H2Gain(NOISE, (los,), ape, name="noise -> APE"),
        H2Gain(NOISE, (los,), rpe, weight_out=relative, name="noise -> RPE"),
    )
    return paper + noise if implemented else paper


def observer_structure(plant: ObserverPlant, *, order: int = ORDER, camera_hold: bool = False) -> AffineStructure:
    """State space of fixed order from the 22 measurements to the estimate.

    Parameters
    ----------
    plant : ObserverPlant
    order : int
    camera_hold : bool
        No direct path from the camera to the estimate: the steps of a value that is held between frames would
        excite the mirror at the frame rate. Otherwise all entries are free.
    """
    free = state_space([plant.system.output_port(name) for name in MEASURED], [ESTIMATE], order)
    if not camera_hold:
        return free
    return free.with_fixed({(order + i, order + j): 0.0 for i in range(2) for j in range(CAMERA.start, CAMERA.stop)})


def kalman_start(
    structure: AffineStructure, telescope: Telescope, parameters: Parameters, *, lead: float = 0.0
) -> FloatArray:
    """The Kalman observer as a start of the tuner."""
    guess = kalman_observer(parameters, telescope.bodies[1], lead=lead).data_at({}).renamed("K_est")
    return np.asarray(structure.parameters_of(guess))
