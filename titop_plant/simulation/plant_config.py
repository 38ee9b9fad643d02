"""Physical settings of a run, and the values of the uncertain parameters over its time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from titop_plant.interface import CAMERA_RATE, SCENARIOS, frame_ticks
from titop_plant.simulation.profiles import PROFILES, Profile, linear_profile, read_profile, trapezoidal_profile
from titop_plant.telescope.parameters import Parameters


@dataclass(frozen=True)
class PlantConfig:
    """Physical settings of a run.

    Parameters
    ----------
    isolated : bool
        Payload on its isolator, or hard-mounted.
    theta : float
        Angle of both solar arrays [rad].
    wheel_speed : tuple of 4 floats, optional
        rad/s; default: the parameter file's.
    omega_1, omega_2 : float, optional
        Clamped frequencies of the arrays' first modes [rad/s]; default: nominal.
    theta_rate : float
        Rate of the arrays [rad/s] during `ramp_duration`.
    wheel_acceleration : tuple of 4 floats
        rad/s2 during `ramp_duration`.
    ramp_duration : float
        s; 0: everything is constant.
    profile : str
        How the ramp goes: ``linear``, ``trapezoidal``, or the path of a CSV file that replaces angle, speeds and rates
        (:mod:`titop_plant.simulation.profiles`).
    camera_rate : float
        Frames per second; must divide the tick rate.
    camera_dropout : float
        Probability that a frame is lost.
    scenario : {"design", "imbalance", "ramp", "worst_case"}
        Disturbance, see :mod:`titop_plant.simulation.disturbances`.
    tones : tuple of tuples of floats
        The tones of the scenario worst_case, which depend on the loop:
        :func:`titop_plant.simulation.disturbances.given_tones`.
    noise, disturbance : bool
        Switches for the two parts of the error.
    seed : int
        Phases of the tones and all noise.
    parameters : str, optional
        Parameter file; default: the reference telescope.

    Raises
    ------
    ValueError
        A value out of its range.
    """

    isolated: bool = True
    theta: float = 0.0
    wheel_speed: tuple[float, ...] | None = None
    omega_1: float | None = None
    omega_2: float | None = None
    theta_rate: float = 0.0
    wheel_acceleration: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    ramp_duration: float = 0.0
    profile: str = "linear"
    camera_rate: float = CAMERA_RATE
    camera_dropout: float = 0.0
    scenario: str = "design"
    noise: bool = True
    disturbance: bool = True
    seed: int = 0
    parameters: str | None = None
    tones: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.scenario not in SCENARIOS:
            raise ValueError(f"scenario must be one of {', '.join(SCENARIOS)}, got {self.scenario!r}")
        if self.disturbance and (self.scenario == "worst_case") != bool(self.tones):
            needed = "given" if self.scenario == "worst_case" else "empty"
            raise ValueError(f"tones must be {needed} in the scenario {self.scenario}, got {len(self.tones)}")
        if not 0.0 <= self.camera_dropout <= 1.0:
            raise ValueError(f"camera_dropout must be a probability in [0, 1], got {self.camera_dropout}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        if not (math.isfinite(self.ramp_duration) and self.ramp_duration >= 0.0):
            raise ValueError(f"ramp_duration must not be negative, got {self.ramp_duration} s")
        if self.scenario == "ramp" and not self.ramps:
            raise ValueError("ramp_duration and a rate, or profile, must be given in the scenario ramp, got no ramp")
        for name in ("wheel_speed", "wheel_acceleration"):
            values = getattr(self, name)
            if values is not None and (len(values) != 4 or not all(map(math.isfinite, values))):
                raise ValueError(f"{name} must be four finite numbers, got {values}")
        frame_ticks(self.camera_rate)

    @property
    def ramps(self) -> bool:
        """Whether anything varies within the run."""
        moves = self.ramp_duration > 0.0 and (self.theta_rate != 0.0 or any(self.wheel_acceleration))
        return moves or self.profile not in PROFILES


def parameter_values(config: PlantConfig, parameters: Parameters, time: float = 0.0) -> dict[str, float]:
    """Values of the telescope's uncertain parameters at a time [s] of the run."""
    return values_along(config, motion(config, parameters), time)


def values_along(config: PlantConfig, profile: Profile, time: float) -> dict[str, float]:
    """:func:`parameter_values` with the profile at hand."""
    values = {f"wheel_{i}.speed": float(s) for i, s in enumerate(profile.speeds(time), start=1)}
    for i, omega in ((1, config.omega_1), (2, config.omega_2)):
        if omega is not None:
            values[f"solar_array.omega_{i}"] = omega
    values["solar_array.tau"] = math.tan(float(profile.angle(time)) / 4.0)
    return values


def motion(config: PlantConfig, parameters: Parameters) -> Profile:
    """Array angle and wheel speeds over the run.

    Raises
    ------
    ValueError
        As :func:`titop_plant.simulation.profiles.read_profile`.
    """
    speed = config.wheel_speed or tuple(parameters["reaction_wheel"]["default_speed"])
    if config.profile not in PROFILES:
        return read_profile(Path(config.profile))
    if not config.ramps:
        return Profile(np.zeros(1), np.array([config.theta]), np.array([speed], dtype=float))
    make = linear_profile if config.profile == "linear" else trapezoidal_profile
    return make(config.theta, config.theta_rate, speed, config.wheel_acceleration, config.ramp_duration)
