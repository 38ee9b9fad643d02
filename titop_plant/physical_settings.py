"""Physical settings of a run: what the plant is built from, each with its description, bounds and default."""

from __future__ import annotations

import math

from pydantic.dataclasses import dataclass

from lftkit.errors import InputError
from titop_plant.interface import NO_SCENARIO, RATE, SCENARIOS, frame_ticks
from titop_plant.settings import ANY, STRICT, Settings, grouped, setting, settings_class

TELESCOPE, DISTURBANCES = "Telescope", "Disturbances and sensors"
"""Groups of settings."""
ANGLE = "solar_array.tau"
"""Parameter tan(theta / 4) of all arrays that turn: they follow the Sun together."""
PROFILES = ("linear", "trapezoidal")
"""Shapes of a ramp; any other profile is a file."""


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class PhysicalSettings(Settings):
    """Telescope, disturbance, sensors and motion of a run.

    Raises
    ------
    ValueError
        A value of another type, out of range or not finite; an angle that is given twice; a camera rate that does not
        divide the tick rate.

    Examples
    --------
    >>> PhysicalSettings(theta=0.5).array_angle
    0.5
    >>> PhysicalSettings(omega_1=-1.0)
    Traceback (most recent call last):
        ...
    pointing_analysis.files.settings.Refused: omega_1 must be between 0 and 1000 rad/s, got -1
    """

    scenario: str | None = setting(
        None,
        "disturbance scenario",
        absent="worst_case, or none with your own sources",
        choices=(*SCENARIOS, NO_SCENARIO),
    )
    seed: int = setting(1, "seed of noise and disturbance phases", "", 0, 2**31 - 1)
    noise: bool = grouped(DISTURBANCES, setting(True, "sensor noise on"))
    disturbance: bool = grouped(DISTURBANCES, setting(True, "wheel and drive disturbances on"))
    camera_rate: float | None = grouped(
        DISTURBANCES,
        setting(None, f"frame rate, a divisor of {RATE}", "Hz", 1.0, float(RATE), absent="that of the parameter file"),
    )
    camera_dropout: float = grouped(DISTURBANCES, setting(0.0, "probability that a frame is dropped", "", 0.0, 1.0))
    theta: float | None = grouped(
        TELESCOPE, setting(None, "angle of the solar arrays", "rad", -6.28, 6.28, absent="that of tau, or 0")
    )
    tau: float | None = grouped(
        TELESCOPE, setting(None, "angle of the arrays as tan(theta/4)", "", -1e3, 1e3, absent="that of theta")
    )
    wheel_speed: tuple[float, ...] | None = grouped(
        TELESCOPE,
        setting(None, "speeds of the wheels", "rad/s", -1e5, 1e5, absent="those of the parameter file", length=ANY),
    )
    omega_1: float | None = grouped(
        TELESCOPE,
        setting(
            None,
            "first frequency of the first solar array and of those like it",
            "rad/s",
            0.0,
            1000.0,
            absent="the nominal one",
        ),
    )
    omega_2: float | None = grouped(
        TELESCOPE,
        setting(
            None,
            "second frequency of the first solar array and of those like it",
            "rad/s",
            0.0,
            1000.0,
            absent="the nominal one",
        ),
    )
    frequencies: tuple[float, ...] | None = grouped(
        TELESCOPE,
        setting(
            None,
            "frequencies of all arrays and appendages, or other parameters of a plant's file, in the order of "
            "los-testbed plant",
            "rad/s",
            -1e9,
            1e9,
            absent="those of omega_1 and omega_2, or nominal",
            length=ANY,
        ),
    )
    parameter_values: dict[str, float] | None = grouped(
        TELESCOPE,
        setting(
            None,
            "values of uncertain parameters by the names of los-testbed plant, on the command line --set NAME=VALUE",
            absent="those of the settings above, or nominal",
        ),
    )
    theta_rate: float = grouped(TELESCOPE, setting(0.0, "rate of the arrays during the ramp", "rad/s", -1.0, 1.0))
    wheel_acceleration: tuple[float, ...] | None = grouped(
        TELESCOPE,
        setting(
            None, "accelerations of the wheels during the ramp", "rad/s2", -100.0, 100.0, absent="none", length=ANY
        ),
    )
    ramp_duration: float = grouped(TELESCOPE, setting(0.0, "duration of the ramp; 0 for none", "s", 0.0, 86400.0))
    profile: str = grouped(
        TELESCOPE, setting("linear", "shape of the ramp: linear, trapezoidal, or a CSV file of angle and speeds")
    )
    parameters: str | None = setting(None, "parameter file of the telescope", absent="the reference")

    def __post_init__(self) -> None:
        if self.camera_rate is not None:
            frame_ticks(self.camera_rate)
        if self.theta is not None and self.tau is not None:
            both = f"{self.theta:g} rad and {self.tau:g}"
            raise InputError(f"one of theta or tau = tan(theta/4) must be absent, got both: {both}")
        if self.frequencies is not None and (self.omega_1 is not None or self.omega_2 is not None):
            raise InputError("omega_1 and omega_2 must be absent where frequencies are given, got both")

    @property
    def array_angle(self) -> float:
        """Angle theta of the solar arrays at the start [rad], given as itself or as tau = tan(theta/4)."""
        tau = (self.parameter_values or {}).get(ANGLE, self.tau)
        return 4.0 * math.atan(tau) if tau is not None else self.theta or 0.0

    @property
    def motion_from_file(self) -> bool:
        """Whether arrays and wheels move as a file says."""
        return self.profile not in PROFILES

    @property
    def frame_ticks(self) -> int:
        """Ticks from one camera frame to the next; InputError: the rate is that of the parameter file."""
        if self.camera_rate is None:
            raise InputError("camera_rate must be known for the ticks of a frame, got that of the parameter file")
        return frame_ticks(self.camera_rate)
