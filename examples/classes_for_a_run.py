r"""Classes of one's own for a run: a disturbance, an observer and two proof-mass laws.

In the folder of this file:

    los-testbed run --mode inprocess --loop fsm --disturbance classes_for_a_run:ThrusterPulses
    los-testbed run --mode inprocess --loop fsm --k-fsm classes_for_a_run:CameraObserver
    los-testbed run --mode inprocess --k-pma classes_for_a_run:SoftLimit
    los-testbed run --mode inprocess --k-pma classes_for_a_run:DampedRoot \
        --parameters spacecraft/damper_at_an_array.toml

Each has `reset` and `step`; `step` writes all of `out`. A parameter ``config`` of the constructor gets the
configuration of the run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from los_testbed.config.run_config import RunConfig

import fsm_pma_controller
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import CAMERA, DT, FSM_ANGLE
from titop_plant.simulation.driven_plant import disturbance_columns
from titop_plant.telescope.load import load_telescope


class ThrusterPulses:
    """Pulses of 20 ms of a cold-gas thruster: 0.5 mN along y on the bus, half a metre off its centre of mass.

    They begin at random, twice a second on average; the seed is that of the run.
    """

    def __init__(self, config: RunConfig) -> None:
        self.seed = config.seed
        self.wrench = disturbance_columns(load_telescope(config.parameters or None))["external_wrench"]
        self.pulse = np.array([0.0, 5e-4, 0.0, 0.0, 0.0, 2.5e-4])  # force [N], torque [Nm]

    def reset(self) -> None:
        self.rng, self.left = np.random.default_rng(self.seed), 0

    def step(self, out: np.ndarray) -> None:
        if self.rng.random() < 2.0 * DT:
            self.left = 20
        out[:] = 0.0
        if self.left:
            out[self.wrench] = self.pulse
            self.left -= 1


class CameraObserver:
    """Line of sight without the mirror's share, from the camera alone, through a low-pass of 2 rad/s.

    Between frames the camera's entries are NaN: the last frame is held.
    """

    def reset(self) -> None:
        self.frame, self.los = np.zeros(2), np.zeros(2)

    def step(self, measurement: np.ndarray, out: np.ndarray) -> None:
        if np.isfinite(measurement[CAMERA]).all():
            self.frame = measurement[CAMERA].copy()
        self.los += 2.0 * DT * (self.frame - 0.1 * measurement[FSM_ANGLE] - self.los)
        out[:] = self.los


class SoftLimit:
    """The stored K_PMA behind a smooth limit of the forces [N]: it never reaches the hard one of the actuators."""

    limit = 10.0

    def __init__(self) -> None:
        self.law = SampledSystem.from_file(Path(fsm_pma_controller.__file__).parent / "designs" / "k_pma.json")

    def reset(self) -> None:
        self.law.reset()

    def step(self, accel_Ip: np.ndarray, out: np.ndarray) -> None:
        self.law.step(accel_Ip, out)
        out[:] = self.limit * np.tanh(out / self.limit)


class DampedRoot(SoftLimit):
    """The same law, and a damper: an actuator against the speed of the array's root, both of the telescope's file.

    The speed is the integral of the sensor's acceleration, through a high-pass of 1 rad/s. With the values of the
    sensor behind the six accelerations, and the force of the actuator behind the six forces.
    """

    sensors = ("root",)
    actuators = ("damper",)
    gain = 20.0  # N s/m

    def reset(self) -> None:
        super().reset()
        self.speed = 0.0

    def step(self, accel_Ip: np.ndarray, out: np.ndarray) -> None:
        super().step(accel_Ip[:6], out[:6])
        self.speed += DT * (accel_Ip[6] - self.speed)
        out[6] = -self.gain * self.speed
