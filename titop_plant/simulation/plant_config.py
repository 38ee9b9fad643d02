"""What one plant is built from, and the values of the uncertain parameters over its time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from titop_plant.physical_settings import PhysicalSettings
from titop_plant.settings import STRICT, setting, settings_class
from titop_plant.simulation.profiles import PROFILES, Profile, linear_profile, read_profile, trapezoidal_profile
from titop_plant.telescope.parameters import Parameters

STEADY = (0.0, 0.0, 0.0, 0.0)
"""Accelerations of wheels that keep their speeds [rad/s2]."""


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlantConfig(PhysicalSettings):
    """What one plant is built from: the physical settings of a run, and what follows from its loop.

    Raises
    ------
    ValueError
        A value out of its range, tones in another scenario than worst_case or none in it, no ramp in the scenario ramp.
    """

    isolated: bool = setting(True, "payload on its isolator, or hard-mounted")
    tones: tuple[tuple[float, ...], ...] = setting(
        (), "tones of the scenario worst_case, see titop_plant.simulation.disturbances.given_tones"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.disturbance and (self.scenario == "worst_case") != bool(self.tones):
            needed = "given" if self.scenario == "worst_case" else "empty"
            raise ValueError(f"tones must be {needed} in the scenario {self.scenario}, got {len(self.tones)}")
        if self.scenario == "ramp" and not self.ramps:
            raise ValueError("ramp_duration and a rate, or profile, must be given in the scenario ramp, got no ramp")

    @classmethod
    def of(cls, settings: PhysicalSettings, **changes: Any) -> PlantConfig:
        """From the settings of a run, of which it takes the physical ones, and values that replace some of them."""
        return cls(**{name: getattr(settings, name) for name in PhysicalSettings.SETTINGS} | changes)

    @property
    def ramps(self) -> bool:
        """Whether anything varies within the run."""
        moves = self.ramp_duration > 0.0 and (self.theta_rate != 0.0 or any(self.wheel_acceleration or ()))
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
        return Profile(np.zeros(1), np.array([config.array_angle]), np.array([speed], dtype=float))
    make = linear_profile if config.profile == "linear" else trapezoidal_profile
    gains = config.wheel_acceleration or STEADY
    return make(config.array_angle, config.theta_rate, speed, gains, config.ramp_duration)
