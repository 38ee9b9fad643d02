"""Configuration of one plant, and the values of the uncertain parameters over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from lftkit.errors import InputError
from pointing_analysis.files.settings import proposal
from titop_plant.physical_settings import ANGLE, PhysicalSettings
from titop_plant.settings import STRICT, setting, settings_class
from titop_plant.telescope.layout import speed_names
from titop_plant.telescope.motion_profiles import (
    MotionProfile,
    linear_profile,
    read_profile,
    trapezoidal_profile,
)
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.uncertain_parameters import further_parameters


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlantConfig(PhysicalSettings):
    """Configuration of one plant: the physical settings of a run, and those that follow from its loop.

    Raises
    ------
    ValueError
        A value out of its range, tones in another scenario than worst_case or none in it, no ramp in the scenario ramp.
    """

    isolated: bool = setting(True, "payload on its isolator, or hard-mounted")
    tones: tuple[tuple[float, ...], ...] = setting(
        (), "tones of the scenario worst_case, see titop_plant.disturbances.wheel_and_drive_tones.given_tones"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.disturbance and self.scenario is None:
            raise InputError("scenario must be given with a disturbance, got none")
        if self.disturbance and (self.scenario == "worst_case") != bool(self.tones):
            needed = "given" if self.scenario == "worst_case" else "empty"
            raise InputError(f"tones must be {needed} in the scenario {self.scenario}, got {len(self.tones)}")
        if self.scenario == "ramp" and not self.ramps:
            raise InputError("ramp_duration and a rate, or profile, must be given in the scenario ramp, got no ramp")

    @classmethod
    def of(cls, settings: PhysicalSettings, **changes: Any) -> PlantConfig:
        """From the settings of a run, of which it takes the physical ones, and values that replace some of them."""
        return cls(**{name: getattr(settings, name) for name in PhysicalSettings.SETTINGS} | changes)

    @property
    def ramps(self) -> bool:
        """Whether anything varies within the run."""
        moves = self.ramp_duration > 0.0 and (self.theta_rate != 0.0 or any(self.wheel_acceleration or ()))
        return moves or self.motion_from_file


def parameter_values(config: PlantConfig, telescope: Telescope, time: float = 0.0) -> dict[str, float]:
    """Values of the telescope's uncertain parameters at a time [s] of the run."""
    return values_along(config, motion(config, telescope), time, telescope)


def values_along(config: PlantConfig, profile: MotionProfile, time: float, telescope: Telescope) -> dict[str, float]:
    """:func:`parameter_values` with the profile at hand."""
    values = dict(zip(speed_names(len(telescope.wheels)), map(float, profile.speeds(time))))
    values = {**stated_values(config, telescope), **values}
    if telescope.arrays_turn:
        values[ANGLE] = math.tan(float(profile.angle(time)) / 4.0)
    return {name: value for name, value in values.items() if name in telescope.uncertain}


def stated_values(config: PhysicalSettings, telescope: Telescope) -> dict[str, float]:
    """Values of the telescope's parameters that the settings give, at the start of a run.

    ``wheel_speed`` has those of the wheels, ``omega_1`` and ``omega_2`` of the first array, ``frequencies`` of all
    bodies in order, ``theta`` or ``tau`` the angle, and ``parameter_values`` any of them.

    Raises
    ------
    ValueError
        A parameter that the telescope does not have, one that is given twice, a list of another length.
    """
    check_wheels(config, telescope)
    angle = [] if config.theta is None and config.tau is None else [math.tan(config.array_angle / 4.0)]
    ways: dict[str, Mapping[str, float]] = {
        "theta" if config.tau is None else "tau": dict(zip((ANGLE,), angle)),
        "wheel_speed": dict(zip(speed_names(len(telescope.wheels)), config.wheel_speed or ())),
        "omega_1": _of_first_array(1, config.omega_1, telescope),
        "omega_2": _of_first_array(2, config.omega_2, telescope),
        "frequencies": _in_order(config.frequencies, telescope),
        "parameter_values": config.parameter_values or {},
    }
    values: dict[str, float] = {}
    for way, stated in ways.items():
        for name, value in stated.items():
            if name in values:
                both = f"{values[name]:g} and {value:g}"
                raise InputError(f"{name} must be given once, got {both}, of which {way} has the second")
            values[name] = value
    known = telescope.uncertain
    for name in config.parameter_values or ():
        if name not in known:
            raise InputError(f"unknown parameter {name!r}{proposal(name, known)}")
    return values


def _of_first_array(number: int, omega: float | None, telescope: Telescope) -> dict[str, float]:
    """The value of an uncertain frequency of the first array."""
    if omega is None:
        return {}
    arrays = telescope.solar_arrays
    if not arrays or (name := f"{arrays[0].parameters}.omega_{number}") not in telescope.uncertain:
        raise InputError(f"omega_{number} must be absent where no array has such a parameter, got {omega:g} rad/s")
    return {name: omega}


def _in_order(frequencies: tuple[float, ...] | None, telescope: Telescope) -> dict[str, float]:
    """The values of the uncertain frequencies of all bodies."""
    if frequencies is None:
        return {}
    names, count = further_parameters(telescope.uncertain, telescope.factors), len(frequencies)
    if len(names) != count:
        raise InputError(f"frequencies must hold {len(names)} numbers, for {', '.join(names) or 'none'}, got {count}")
    return dict(zip(names, frequencies))


def start_speeds(config: PhysicalSettings, telescope: Telescope) -> tuple[float, ...]:
    """Speeds of the wheels at the start [rad/s]: those of the settings, else of the parameter file."""
    stated = stated_values(config, telescope)
    names = speed_names(len(telescope.wheels))
    return tuple(stated.get(name, speed) for name, speed in zip(names, telescope.default_speeds))


def check_wheels(config: PhysicalSettings, telescope: Telescope) -> None:
    """Refuse settings for another number of wheels than there are."""
    wheels = len(telescope.wheels)
    for name in ("wheel_speed", "wheel_acceleration"):
        values = getattr(config, name)
        if values is not None and len(values) != wheels:
            raise InputError(f"{name} must hold {wheels} numbers, got {len(values)}")


def steady(telescope: Telescope) -> tuple[float, ...]:
    """Accelerations of wheels that keep their speeds [rad/s2]."""
    return (0.0,) * len(telescope.wheels)


def motion(config: PlantConfig, telescope: Telescope) -> MotionProfile:
    """Array angle and wheel speeds over the run.

    Raises
    ------
    ValueError
        As :func:`titop_plant.telescope.motion_profiles.read_profile`; another number of wheels than there are.
    """
    speed = start_speeds(config, telescope)
    if config.motion_from_file:
        return read_profile(Path(config.profile), len(telescope.wheels))
    if not config.ramps:
        return MotionProfile(np.zeros(1), np.array([config.array_angle]), np.array([speed], dtype=float))
    make = linear_profile if config.profile == "linear" else trapezoidal_profile
    gains = config.wheel_acceleration or steady(telescope)
    return make(config.array_angle, config.theta_rate, speed, gains, config.ramp_duration)
