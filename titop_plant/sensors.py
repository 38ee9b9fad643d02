"""The sensors of the loop: the one table of those of the reference, and the values of a telescope.

Vectors of the loop, simulation, topics, recorder, observer, design, prediction and budget are made from the table.
The numbers themselves, such as noise and filter, are keys of the table ``sensors`` of the parameter file, and a
:class:`Sensor` has them. Sensors at places are the tables ``[[sensor]]`` (:mod:`titop_plant.telescope.devices`). This
module needs numpy and the names of ports only, so that the controllers at run time may import it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
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
        Its quantisation: a key of ``[device_limits]``; "": none.
    rate : str
        Key of its samples per second, between which the last one is held; "": one a tick.
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
        Another number of values than a message holds.

    Examples
    --------
    >>> SensorEntry(Port("tracker", 3, "rad"), "tracker", "bus", "trackers", "tracker_noise", "camera_step").framed
    False
    """

    port: Port
    topic: str
    frame_id: str
    group: str
    noise: str
    step: str = ""
    rate: str = ""
    bias: str = ""
    washout: str = ""
    low_pass: str = ""
    measures: str = ""

    def __post_init__(self) -> None:
        if self.port.size > 3 and self.port.unit != TWIST_UNIT:
            raise InputError(f"size of {self.port.name} must be 1 to 3, or 6 of a twist, got {self.port.size}")

    @property
    def framed(self) -> bool:
        """Whether it may have samples at some ticks only, which are held between them."""
        return bool(self.rate)


def whole_ticks(rate: float) -> int | None:
    """Ticks from one sample to the next of a rate [Hz]; None where it does not divide the tick rate.

    Examples
    --------
    >>> whole_ticks(25.0), whole_ticks(30.0)
    (40, None)
    """
    ticks = TICKS_PER_SECOND / rate if rate > 0.0 else 0.0
    if math.isfinite(ticks) and round(ticks) >= 1 and abs(ticks - round(ticks)) < 1e-9 * ticks:
        return round(ticks)
    return None


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
    ticks = whole_ticks(rate)
    if ticks is None:
        raise InputError(f"{name} must divide {TICKS_PER_SECOND} Hz (50, 40, 25, ...), got {rate:g} Hz")
    return ticks


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
        rate="camera_rate",
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


@dataclass(frozen=True)
class SensorMount:
    """Where a sensor is, and the axes along which it measures.

    Parameters
    ----------
    place : str
        Point of the structure.
    axes : ndarray, shape (k, 3) or (2, 2)
        Unit vectors along which it measures, one to three, in the axes of the body; of the line of sight the identity.
    position : ndarray, shape (3,)
        From the point [m].
    angular : bool
        Whether it measures the angular acceleration.
    accelerates : bool
        Whether it measures the acceleration of its point; otherwise an output of the assembled telescope.
    scale : float
        Relative error of its scale.
    """

    place: str
    axes: FloatArray = field(repr=False)
    position: FloatArray = field(repr=False)
    angular: bool = False
    accelerates: bool = True
    scale: float = 0.0

    @property
    def key(self) -> tuple[str, list[list[float]]]:
        """What tells it from other mounts."""
        return self.place, self.rows.tolist()

    @property
    def rows(self) -> FloatArray:
        """Its values from what it measures, of an acceleration the twist (6) of its point: shape (k, size)."""
        axes = self.axes * (1.0 + self.scale)
        if not self.accelerates:
            return axes
        if self.angular:
            return np.hstack([np.zeros_like(axes), axes])
        return np.hstack([axes, np.cross(self.position, axes)])


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor: a row of the loop.

    Parameters
    ----------
    port : Port
        Its part of the measurement.
    noise, bias : ndarray, shape (size,)
        Standard deviation of a sample (of a frame), and what is added to every sample, in the unit of the port.
    framed : bool
        Whether it may lack a sample at a tick; the last one is held then.
    ticks : int
        Ticks from one sample to the next.
    washout : float
        Corner of the high-pass before the controllers [rad/s]; 0: none.
    low_pass : tuple of float
        ``c0, c1, c2`` of its low-pass ``c0 / (s^2 + c1 s + c2)``; empty: none.
    step, range : float
        Quantisation (0: none) and largest value (inf: none) of a sensor with a mount, in the unit of the port. Those of
        others are limits of the devices (:mod:`titop_plant.simulation.device_limits`).
    random_walk : float
        Of the bias, in the unit of the port and the root of a second.
    mount : SensorMount, optional
        Where it is; a sensor without one measures an output of the assembled telescope as it is.
    measures : str
        Output of the assembled telescope that it measures; empty: that of its own name.
    """

    port: Port
    noise: FloatArray
    bias: FloatArray
    framed: bool = False
    ticks: int = 1
    washout: float = 0.0
    low_pass: tuple[float, ...] = ()
    step: float = 0.0
    range: float = math.inf
    random_walk: float = 0.0
    mount: SensorMount | None = None
    measures: str = ""

    @property
    def name(self) -> str:
        """Name of its port."""
        return self.port.name

    @property
    def source(self) -> str:
        """Output of the assembled telescope that it measures."""
        return self.measures or self.name


def port_alone(entry: SensorEntry) -> Sensor:
    """A sensor of no telescope: its noise and bias are unknown (NaN), and a rate that has a key (0 ticks)."""
    unknown = np.full(entry.port.size, math.nan)
    return Sensor(entry.port, unknown, unknown, entry.framed, 0 if entry.framed else 1, measures=entry.measures)


def read_loop_sensors(table: Mapping[str, Any]) -> tuple[Sensor, ...]:
    """Sensors of the table ``sensors`` of a parameter file, in the order of the measurement.

    Raises
    ------
    ValueError
        A key of the table of sensors that the parameter file does not have, a rate that does not divide the tick rate.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> [(s.port.name, s.framed, s.washout > 0.0) for s in load_telescope().sensors][2:]
    [('accel_M2', False, True), ('camera_los', True, False), ('fsm_angle', False, False)]
    """

    def value(entry: SensorEntry, key: str) -> Any:
        if key and key not in table:
            raise InputError(
                f"sensors.{key} of {entry.port.name} must be in the parameter file, got {', '.join(table)}"
            )
        return table[key] if key else 0.0

    def sensor(entry: SensorEntry) -> Sensor:
        size, washout = np.ones(entry.port.size), float(value(entry, entry.washout))
        noise, bias = (value(entry, key) * size for key in (entry.noise, entry.bias))
        low_pass = tuple(map(float, value(entry, entry.low_pass))) if entry.low_pass else ()
        ticks = divided_ticks(value(entry, entry.rate), entry.rate) if entry.framed else 1
        return Sensor(entry.port, noise, bias, entry.framed, ticks, washout, low_pass, measures=entry.measures)

    return tuple(sensor(entry) for entry in MEASURED_SENSORS)
