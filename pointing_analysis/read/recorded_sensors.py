"""The sensors of a run as its recording describes them: topic, unit, rate, noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.read.recording import Recording

METADATA = "sensors"
"""Key of the sensors in the metadata of a bag: a list of entries with topic, unit, rate_hz, held and noise."""


@dataclass(frozen=True)
class RecordedSensor:
    """A sensor of a run.

    Attributes
    ----------
    topic, unit : name without namespace, unit of its values
    rate : samples per second
    held : whether its values are held between samples, which may be lost (NaN)
    noise : standard deviation of a sample, for each value
    """

    topic: str
    unit: str
    rate: float
    held: bool
    noise: tuple[float, ...]

    @classmethod
    def from_mapping(cls, values: Any) -> RecordedSensor:
        """Read an entry of the metadata.

        Raises
        ------
        ValueError
            A key that is missing, or a value of another kind.
        """
        try:
            noise, rate = tuple(float(x) for x in values["noise"]), float(values["rate_hz"])
            topic, unit, held = values["topic"], values["unit"], values["held"]
        except (KeyError, TypeError, ValueError):
            raise InputError(f"a sensor must have topic, unit, rate_hz, held and noise, got {values!r}") from None
        if not (isinstance(topic, str) and isinstance(unit, str) and isinstance(held, bool)):
            raise InputError(f"a sensor must have texts as topic and unit and a truth value as held, got {values!r}")
        if not (rate > 0.0 and all(map(math.isfinite, (rate, *noise)))):
            raise InputError(f"rate_hz and noise of a sensor must be finite numbers, got {values!r}")
        return cls(topic, unit, rate, held, noise)

    def to_mapping(self) -> dict[str, Any]:
        """An entry of the metadata, as :meth:`from_mapping` takes it."""
        return {
            "topic": self.topic,
            "unit": self.unit,
            "rate_hz": self.rate,
            "held": self.held,
            "noise": list(self.noise),
        }


def sensors_of(run: Recording) -> tuple[RecordedSensor, ...]:
    """Sensors that a recording describes and has; none without a readable description."""
    return read_sensors(run)[0]


def read_sensors(run: Recording) -> tuple[tuple[RecordedSensor, ...], str]:
    """What :func:`sensors_of` returns, and what is wrong with the description."""
    entries = run.parameters.get(METADATA)
    if entries is None:
        return (), ""
    try:
        if not isinstance(entries, list):
            raise InputError(f"{METADATA} must be a list, got {type(entries).__name__}")
        sensors = [RecordedSensor.from_mapping(entry) for entry in entries]
    except InputError as error:
        return (), f"the sensors of the recording cannot be read: {error}"
    return tuple(sensor for sensor in sensors if sensor.topic in run), ""


__all__ = ["METADATA", "RecordedSensor", "read_sensors", "sensors_of"]
