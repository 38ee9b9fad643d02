"""The one table of sensors: what each measures, how often, its topic, and where its noise stands in the parameter file.

Vectors of the loop, simulation, topics, recorder, observer, design, prediction and budget are made from these rows; a
row that is added to :data:`SENSORS` takes effect in all of them. The numbers themselves, such as noise and filter, are
keys of the table ``sensors`` of the parameter file. This module needs the names of ports only, so that the controllers
at run time may import it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lftkit.systems.ports import Port
from titop_plant.ports import TWIST_UNIT, accel

TICKS_PER_SECOND = 1000
"""Ticks per second: the rate of a sensor divides it."""

ACCELEROMETER_GROUP = "accelerometers"
"""Group of the sensors of accelerations: they stand first in the measurement and have the anti-alias filter."""

PLATFORM_PORT, CAMERA_PORT, GAUGE_PORT = "accel_Ip", "camera_los", "fsm_angle"
"""Ports with a part of their own in the loop: what K_PMA measures, the camera whose rate is a setting of the run, and
the mirror's angles, which are subtracted from the line of sight."""


@dataclass(frozen=True)
class SensorEntry:
    """A sensor of the loop.

    Parameters
    ----------
    port : Port
        Its part of the measurement.
    topic, frame_id : str
        Topic below the namespace, and frame of its messages.
    group : str
        Sensors whose noise is one source of a budget.
    noise : str
        Key of the standard deviation of a sample, in the unit of the port.
    step : str
        Its quantisation: a field of :class:`titop_plant.simulation.device_limits.DeviceLimits`; "": none.
    rate : float
        Samples per second; it divides the tick rate. Between its samples the last one is held.
    bias : str
        Key of what is added to every sample; "": nothing.
    washout : str
        Key of the corner of the high-pass before the controllers; "": none.
    low_pass : str
        Key of ``c0, c1, c2`` of its low-pass ``c0 / (s^2 + c1 s + c2)`` for each value; "": none.
    measures : str
        Output of the assembled telescope that it measures; "": that of its own name.

    Raises
    ------
    ValueError
        A rate that does not divide the tick rate, or another number of values than a message holds.

    Examples
    --------
    >>> SensorEntry(Port("tracker", 3, "rad"), "tracker", "bus", "trackers", "tracker_noise", "camera_step", 4.0).ticks
    250
    """

    port: Port
    topic: str
    frame_id: str
    group: str
    noise: str
    step: str = ""
    rate: float = TICKS_PER_SECOND
    bias: str = ""
    washout: str = ""
    low_pass: str = ""
    measures: str = ""

    def __post_init__(self) -> None:
        divided_ticks(self.rate, f"rate of {self.port.name}")
        if self.port.size > 3 and self.port.unit != TWIST_UNIT:
            raise ValueError(f"size of {self.port.name} must be 1 to 3, or 6 of a twist, got {self.port.size}")

    @property
    def ticks(self) -> int:
        """Ticks from one sample to the next."""
        return divided_ticks(self.rate, f"rate of {self.port.name}")

    @property
    def framed(self) -> bool:
        """Whether it has samples at some ticks only, which are held between them."""
        return self.ticks > 1

    @property
    def source(self) -> str:
        """Output of the assembled telescope that it measures."""
        return self.measures or self.port.name


def divided_ticks(rate: float, name: str) -> int:
    """Ticks from one sample to the next.

    Parameters
    ----------
    rate : float
        Samples per second.
    name : str
        For the message.

    Raises
    ------
    ValueError
        The rate does not divide the tick rate.

    Examples
    --------
    >>> divided_ticks(50.0, "camera_rate")
    20
    """
    ticks = TICKS_PER_SECOND / rate if rate > 0.0 else 0.0
    if not (math.isfinite(ticks) and round(ticks) >= 1 and abs(ticks - round(ticks)) < 1e-9 * ticks):
        raise ValueError(f"{name} must divide {TICKS_PER_SECOND} Hz (50, 40, 25, ...), got {rate:g} Hz")
    return round(ticks)


def _accelerometer(point: str, topic: str, frame_id: str) -> SensorEntry:
    return SensorEntry(
        accel(point),
        topic,
        frame_id,
        ACCELEROMETER_GROUP,
        noise="accelerometer_noise",
        step="acceleration_step",
        bias="accelerometer_bias",
        washout="washout",
    )


SENSORS: tuple[SensorEntry, ...] = (
    _accelerometer("Ip", "isolator/accel", "isolator_payload"),
    _accelerometer("M1", "m1/accel", "m1"),
    _accelerometer("M2", "m2/accel", "m2"),
    SensorEntry(
        Port(CAMERA_PORT, 2, "rad"),
        "camera/los",
        "line_of_sight",
        "camera",
        noise="camera_noise",
        step="camera_step",
        rate=50.0,
        low_pass="camera_filter",
        measures="los_controlled",
    ),
    SensorEntry(
        Port(GAUGE_PORT, 2, "rad"),
        "fsm/strain_gauge",
        "fsm",
        "strain gauges",
        noise="strain_gauge_noise",
        step="gauge_step",
    ),
)
"""The table. Read it as :data:`MEASURED_SENSORS`."""

MEASURED_SENSORS = tuple(sorted(SENSORS, key=lambda entry: entry.group != ACCELEROMETER_GROUP))
"""Sensors in the order of the measurement: accelerometers first, otherwise that of the table."""

__all__ = [
    "ACCELEROMETER_GROUP",
    "CAMERA_PORT",
    "GAUGE_PORT",
    "MEASURED_SENSORS",
    "PLATFORM_PORT",
    "SENSORS",
    "TICKS_PER_SECOND",
    "SensorEntry",
    "divided_ticks",
]
