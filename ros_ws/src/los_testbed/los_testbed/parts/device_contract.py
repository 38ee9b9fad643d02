"""Interface of a device: a mirror, actuators, sensors and their clock, behind five methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.config.plugins import RAISED, in_one_line, make
from los_testbed.config.run_config import RunConfig
from pointing_analysis.command.exit_codes import ExitCode

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED, ERROR = "unconfigured", "inactive", "active", "finalized", "error"
"""States of a device, named as in the life cycle of a ROS 2 node."""

CONFIRMED = "mirror and forces are at zero, confirmed by the rig"
ASKED = "mirror and forces were asked to go to zero, not confirmed by the rig"
NOT_ZERO = "mirror and forces could NOT be set to zero"
"""States of mirror and forces at the end of a run."""

METHODS = ("open", "read", "write", "safe", "close")

TRUTH_PORT = "los_controlled"
"""Port of the true line of sight, for a rig that measures it by another instrument. Not needed."""


class DeviceError(RuntimeError):
    """A device failed or was silent too long: the run ends. The message says whether its actuators are at zero."""

    code = ExitCode.DEVICE


@dataclass(frozen=True)
class Sample:
    """One sample of one sensor.

    Attributes
    ----------
    port : name of the sensor's port, as in :mod:`titop_plant.sensors`, or `TRUTH_PORT`
    acquired_ns : time of acquisition on the steady clock of this host (``time.monotonic_ns``)
    values : (size of the port,) [SI]
    """

    port: str
    acquired_ns: int
    values: FloatArray


@dataclass(frozen=True)
class RigReport:
    """The latest that a rig has said of itself.

    Attributes
    ----------
    received_ns : time of arrival on the steady clock of this host
    safe : whether it holds mirror and forces at zero, whatever is commanded
    limited : whether it applies less than the last command
    unanswered : whether a request to it has had no answer yet
    """

    received_ns: int
    safe: bool = False
    limited: bool = False
    unanswered: bool = False


class Device(Protocol):
    """A rig.

    It is opened once, before the run begins, and never stepped for a trial; it need not be copied and need not know the
    truth. In each tick `write` and then `read` are called once, at the deadline and never before it. Both return
    immediately: `read` returns the samples since the last call, possibly none. Between `open` and the run only `read`
    is called, every 20 ms. **Signs and units are those of :mod:`titop_plant.interface`.**

    Further methods are optional. ``notes()`` returns the device's own names and texts for the statistics; it is
    called last between `safe` and `close`. ``begin_counts()`` sets its counts to zero for a run. ``report()`` returns a
    `RigReport`, or None before the first one: without it, nothing confirms that mirror and forces are at zero. A fourth
    one, ``check(config)``, raises an exception for settings with which it cannot be opened, before anything is started.
    """

    def open(self, config: RunConfig) -> None:
        """Connect; the actuators stay at zero."""

    def read(self, now_ns: int) -> Sequence[Sample]:
        """Samples since the last call; `now_ns` is the deadline (steady clock)."""

    def write(self, command: FloatArray, now_ns: int) -> None:
        """Apply mirror angles [rad] and forces [N], (8,), until the next call."""

    def safe(self) -> None:
        """Set mirror and forces to zero in any state; may be called repeatedly."""

    def close(self) -> None:
        """Release the device."""


def make_device(config: RunConfig) -> Any:
    """Device that the setting ``device`` names; it is not opened.

    Raises
    ------
    ValueError
        It cannot be made, lacks a method, or refuses its settings.
    """
    device = make(config, "device")
    for name in METHODS:
        try:
            method = getattr(device, name, "none")
        except RAISED as error:
            raise InputError(f"device {config.device} must have methods, got {in_one_line(error)}") from error
        if not callable(method):
            raise InputError(f"device {config.device}: {name} must be a method, got {method!r}")
    if callable(check := getattr(device, "check", None)):
        try:
            check(config)
        except InputError:
            raise
        except RAISED as error:
            text = in_one_line(error)
            raise InputError(f"device {config.device} must be one that can be opened, got {text}") from error
    return device
