"""Interface of plant and controllers: rate, ports, stages, scenarios, and design basis of a controller.

This module needs numpy only, so that the controllers at run time may import it. It holds the constants of the
protocol, each of them only here; physical values (limits of the actuators, sensitivity of the mirror) are those of the
parameter file, see :mod:`titop_plant.telescope.load`.

================  =====  =============================================================================
vector            size   content
================  =====  =============================================================================
measurement       22     values of the sensors, see :mod:`titop_plant.sensors`
los estimate      2      line of sight without the mirror's share [rad]
command           8      ``fsm_command`` (2) [rad], ``pma_force`` (6) [N]
truth             2      controlled line of sight [rad]
================  =====  =============================================================================
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from lftkit.arrays import IntArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port, port_slices, total_size
from titop_plant.sensors import (
    ACCELEROMETER_GROUP,
    CAMERA_PORT,
    GAUGE_PORT,
    MEASURED_SENSORS,
    PLATFORM_PORT,
    TICKS_PER_SECOND,
    divided_ticks,
)

RATE = TICKS_PER_SECOND
"""Ticks per second."""

DT = 1.0 / RATE
"""Sampling period: one tick [s]."""

TICK_NS = 1_000_000_000 // RATE
"""The same [ns]; every stamp is a multiple of it."""

HOLD_DELAY = 0.5 * DT
"""Mean delay of a command that is held for one tick [s]."""

LOOP_DELAY = DT + HOLD_DELAY
"""Delay of the loop: a tick from measurement to command, and the mean delay of the held command [s]."""

STAGES = ("none", "isolator", "fsm", "fsm+pma")
"""Stages of the control: hard-mounted payload, payload on its isolator, and the two actuator loops on top."""

MIRROR_STAGES = STAGES[2:]
"""Stages with the mirror's loop closed, by the observer K_FSM."""

FORCE_STAGES = STAGES[3:]
"""Stages with the loop of the proof-mass actuators closed, by the controller K_PMA."""

SCENARIOS = ("worst_case", "unit_norm", "design", "imbalance", "ramp")
"""Disturbances: the tone of unit norm that is worst for the loop that runs; tones of unit norm at the worst frequencies
of the telescope on its isolator; imbalance of the wheels and micro-steps of the drives; the same while wheel speeds and
array angle follow a profile."""

NO_SCENARIO = "none"
"""In the place of a scenario: no tones of one, only the sources of files, of code and of the telescope's tables."""

MEASURED_PORTS = tuple(entry.port for entry in MEASURED_SENSORS)
"""Ports of the measurement vector: the inputs of K_FSM."""

ESTIMATE_PORTS = (Port("los_estimate", 2, "rad"),)
"""Ports of the estimate: the output of K_FSM."""

COMMAND_PORTS = (Port("fsm_command", 2, "rad"), Port("pma_force", 6, "N"))
"""Ports of the command vector."""

TRUTH_PORTS = (Port("los_controlled", 2, "rad"),)
"""Ports of the truth."""

K_FSM_INPUTS, K_FSM_OUTPUTS = MEASURED_PORTS, ESTIMATE_PORTS
"""Ports of an observer."""

K_PMA_INPUTS = tuple(port for port in MEASURED_PORTS if port.name == PLATFORM_PORT)
K_PMA_OUTPUTS = COMMAND_PORTS[1:]
"""Ports of a proof-mass controller."""

LAW_PORTS: Mapping[str, tuple[tuple[Port, ...], tuple[Port, ...]]] = MappingProxyType(
    {"k_fsm": (K_FSM_INPUTS, K_FSM_OUTPUTS), "k_pma": (K_PMA_INPUTS, K_PMA_OUTPUTS)}
)
"""Inputs and outputs of the stored controllers."""

ESTIMATES, TRUTH = total_size(ESTIMATE_PORTS), total_size(TRUTH_PORTS)
"""Sizes of the vectors that every loop has."""

MEASURED = tuple(port.name for port in MEASURED_PORTS)
"""Names of the measured ports in the order of the vector."""

ACCELEROMETERS = tuple(entry.port.name for entry in MEASURED_SENSORS if entry.group == ACCELEROMETER_GROUP)
"""Names of the accelerometers' ports."""

COMMANDED = tuple(port.name for port in COMMAND_PORTS)
"""Names of the command ports in the order of the vector."""

COLUMNS: Mapping[str, slice] = MappingProxyType(
    {
        name: columns
        for ports in (MEASURED_PORTS, ESTIMATE_PORTS, COMMAND_PORTS, TRUTH_PORTS)
        for name, columns in port_slices(ports).items()
    }
)
"""Columns of each port in its vector."""

PLATFORM, CAMERA, FSM_ANGLE = (COLUMNS[name] for name in (PLATFORM_PORT, CAMERA_PORT, GAUGE_PORT))
"""Columns of the platform's accelerometer, of the camera and of the mirror's strain gauges in the measurement."""

ACCELERATIONS = slice(COLUMNS[ACCELEROMETERS[0]].start, COLUMNS[ACCELEROMETERS[-1]].stop)
"""Columns of all accelerometers in the measurement."""

MIRROR, FORCES = (COLUMNS[name] for name in COMMANDED)
"""Columns of the mirror and of the proof-mass actuators in the command."""


def frame_ticks(camera_rate: float) -> int:
    """Ticks from one camera frame to the next.

    Parameters
    ----------
    camera_rate : float
        Frames per second.

    Raises
    ------
    ValueError
        The rate does not divide the tick rate.

    Examples
    --------
    >>> frame_ticks(50.0)
    20
    """
    return divided_ticks(camera_rate, "camera_rate")


FRAMED = tuple(entry.port.name for entry in MEASURED_SENSORS if entry.framed)
"""Ports with a value at some ticks only, which is held between them."""

HELD: IntArray = np.concatenate([np.arange(COLUMNS[name].start, COLUMNS[name].stop) for name in FRAMED])
"""Their columns in the measurement."""

HELD_PARTS: Mapping[str, slice] = MappingProxyType(port_slices(p for p in MEASURED_PORTS if p.name in FRAMED))
"""Part of each of them in the vector of held values."""


@dataclass(frozen=True)
class DesignBasis:
    """Properties of a telescope for which a controller was designed, or those of a telescope; ``None``: not stated.

    The object ``design_basis`` of a controller's file holds these values. The sampling period, which belongs to it, is
    the file's ``dt``.

    Parameters
    ----------
    parameters_hash : str, optional
        Name of the parameter values, :attr:`titop_plant.telescope.telescope.Telescope.parameters_hash`.
    los_sensitivity : float, optional
        Line of sight by an angle of the mirror, rad/rad. **The mirror is driven to -estimate / los_sensitivity.**
    fsm_authority, pma_authority : float, optional
        Largest mirror angle per axis [rad] and largest force of one actuator [N].

    Raises
    ------
    ValueError
        A number that is not positive and finite.

    Examples
    --------
    >>> DesignBasis.from_mapping({"los_sensitivity": 0.1}, "mine").mirror_sensitivity(DesignBasis(los_sensitivity=0.2))
    0.1
    >>> DesignBasis().mirror_sensitivity(DesignBasis(los_sensitivity=0.2))
    0.2
    """

    parameters_hash: str | None = None
    los_sensitivity: float | None = None
    fsm_authority: float | None = None
    pma_authority: float | None = None

    def __post_init__(self) -> None:
        for name, value in self.to_mapping().items():
            if name == "parameters_hash":
                if not isinstance(value, str):
                    raise InputError(f"parameters_hash must be a text, got {value!r}")
            elif isinstance(value, bool) or not isinstance(value, (int, float)):
                raise InputError(f"{name} must be a number, got {value!r}")
            elif not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} must be positive and finite, got {value}")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], name: str) -> DesignBasis:
        """Read the ``design_basis`` of the controller `name`.

        Raises
        ------
        ValueError
            An unknown key or a value that does not fit; the message begins with `name`.
        """
        known = [entry.name for entry in fields(cls)]
        for key in values:
            if key not in known:
                raise InputError(f"{name}: keys of design_basis must be among {', '.join(known)}, got {key!r}")
        try:
            return cls(**values)
        except ValueError as error:
            raise InputError(f"{name}: design_basis: {error}") from None

    def to_mapping(self) -> dict[str, Any]:
        """Stated values, as :meth:`from_mapping` takes them."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def authority(self) -> tuple[float, float]:
        """Largest mirror angle [rad] and largest force of one actuator [N].

        Raises
        ------
        ValueError
            One of them is not stated.
        """
        if self.fsm_authority is None or self.pma_authority is None:
            raise InputError(f"fsm_authority and pma_authority must be given, got {self.to_mapping()}")
        return self.fsm_authority, self.pma_authority

    def mirror_sensitivity(self, telescope: DesignBasis) -> float:
        """Sensitivity that the mirror law of this observer divides by: its own, else that of the `telescope`.

        Raises
        ------
        ValueError
            Neither states one.
        """
        sensitivity = telescope.los_sensitivity if self.los_sensitivity is None else self.los_sensitivity
        if sensitivity is None:
            raise InputError("los_sensitivity must be given by the observer's file or by the telescope, got neither")
        return sensitivity

    def differences(self, other: DesignBasis) -> dict[str, tuple[Any, Any]]:
        """Values that both state and that differ: name to (own, other)."""
        mine, others = self.to_mapping(), other.to_mapping()
        return {name: (mine[name], others[name]) for name in mine if name in others and mine[name] != others[name]}


class Designed(Protocol):
    """A controller with a design basis, such as a :class:`lftkit.SampledSystem`."""

    @property
    def name(self) -> str:
        """Name for messages."""

    @property
    def design_basis(self) -> Mapping[str, Any]:
        """As :meth:`DesignBasis.from_mapping` takes it; empty where nothing is known."""


def design_warnings(controllers: Iterable[Designed], telescope: DesignBasis, *, closed: bool) -> tuple[str, ...]:
    """Compare controllers with the telescope that they are to control.

    Parameters
    ----------
    controllers : iterable of Designed
    telescope : DesignBasis
        The telescope's values, with the limits of the run.
    closed : bool
        Whether these controllers close a loop.

    Returns
    -------
    tuple of str
        One line for each controller that was made for other parameters or other limits.

    Raises
    ------
    ValueError
        A loop would be closed with a controller made for another sensitivity of the mirror: its gain is then wrong by
        the ratio of the two.
    """
    lines = []
    for controller in controllers:
        differences = DesignBasis.from_mapping(controller.design_basis, controller.name).differences(telescope)
        if closed and "los_sensitivity" in differences:
            of_design, of_telescope = differences["los_sensitivity"]
            raise InputError(
                f"{controller.name}: fsm.los_sensitivity of its design must be {of_telescope:g}, got {of_design:g}"
            )
        if differences:
            made, present = (
                ", ".join(f"{name} {_text(pair[side])}" for name, pair in differences.items()) for side in (0, 1)
            )
            lines.append(f"{controller.name} was designed for {made}, not for {present}")
    return tuple(lines)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"
