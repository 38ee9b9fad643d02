"""The configuration of a run: every setting, checked once, when it is made.

The same table of fields makes the command line's ``--set``, the YAML file, the ROS parameters with their
descriptions and ranges, and the metadata of the bag.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from pointing_analysis.files.structured_text import load_yaml, read_text
from titop_plant.interface import CAMERA_RATE, RATE, SCENARIOS, STAGES, frame_ticks

NAMESPACE = "/telescope"
"""Namespace of nodes and topics where none is given."""

MODES = ("realtime", "lockstep", "inprocess")

STARTS = ("steady", "rest")
"""Start of a run: in the steady state of the loop under its tones and the sensors' bias; all states zero."""

WORST_OF = ("RPE", "APE", "slow", "fast")
"""Index that the tone of the scenario worst_case is worst for, see :mod:`los_loop.worst_tone`."""


def _parameter(
    default: Any, description: str, unit: str = "", low: float | None = None, high: float | None = None
) -> Any:
    """Field with its description for the user; `low` and `high` are inclusive bounds."""
    return field(default=default, metadata={"description": description, "unit": unit, "low": low, "high": high})


def _choice(default: str, description: str, choices: tuple[str, ...]) -> Any:
    return field(default=default, metadata={"description": description, "unit": "", "choices": choices})


@dataclass(frozen=True)
class RunConfig:
    """All settings of a run.

    Raises
    ------
    ValueError
        A value of another type, out of range or not finite, or a camera rate that does not divide the tick rate.

    Examples
    --------
    >>> RunConfig(duration=10.0).ticks
    10000
    >>> RunConfig(camera_rate=50.0).frame_ticks
    20
    >>> RunConfig.from_mapping({"durtion": 3.0})
    Traceback (most recent call last):
        ...
    ValueError: unknown parameter 'durtion': did you mean duration?
    """

    duration: float = _parameter(10.0, "length of the run", "s", 1e-3, 86400.0)
    mode: str = _choice("realtime", "how plant, estimator and controller run", MODES)
    loop: str = _choice(STAGES[-1], "stage: which loops are closed", STAGES)
    scenario: str = _choice(SCENARIOS[0], "disturbance scenario", SCENARIOS)
    worst_of: str = _choice(WORST_OF[0], "what the scenario worst_case is worst for", WORST_OF)
    start: str = _choice(STARTS[0], "start: steady state of the loop that runs, or rest", STARTS)
    seed: int = _parameter(1, "seed of noise and disturbance phases", "", 0, 2**31 - 1)
    noise: bool = _parameter(True, "sensor noise on")
    disturbance: bool = _parameter(True, "wheel and drive disturbances on")
    camera_rate: float = _parameter(CAMERA_RATE, f"frames per second; it divides {RATE}", "Hz", 1.0, float(RATE))
    camera_dropout: float = _parameter(0.0, "probability that a frame is dropped", "1", 0.0, 1.0)
    theta: float = _parameter(0.0, "angle of both solar arrays", "rad", -6.28, 6.28)
    tau: float = _parameter(0.0, "tan(theta/4) instead of theta; 0 for the value of theta", "", -1e3, 1e3)
    wheel_speed: tuple[float, ...] = _parameter(
        (), "speeds of the four wheels; empty for the plant's own", "rad/s", -1e5, 1e5
    )
    omega_1: float = _parameter(0.0, "first frequency of the solar arrays; 0 for the nominal one", "rad/s", 0.0, 1000.0)
    omega_2: float = _parameter(
        0.0, "second frequency of the solar arrays; 0 for the nominal one", "rad/s", 0.0, 1000.0
    )
    theta_rate: float = _parameter(0.0, "rate of the arrays during the ramp", "rad/s", -1.0, 1.0)
    wheel_acceleration: tuple[float, ...] = _parameter(
        (), "accelerations of the four wheels during the ramp; empty for none", "rad/s2", -100.0, 100.0
    )
    ramp_duration: float = _parameter(0.0, "how long the ramp lasts; 0 for none", "s", 0.0, 86400.0)
    profile: str = _parameter("linear", "how the ramp goes: linear, trapezoidal, or a CSV file of angle and speeds")
    parameters: str = _parameter("", "parameter file of the telescope; empty for the reference")
    fsm_authority: float = _parameter(0.0, "largest mirror angle per axis; 0 for the telescope's own", "rad", 0.0, 1.0)
    pma_authority: float = _parameter(0.0, "largest force of one actuator; 0 for the telescope's own", "N", 0.0, 1e6)
    nonlinear: bool = _parameter(False, "stroke and rate limits, quantised sensors, anti-alias filters")
    plant: str = _parameter("", "plant of your own, MODULE:NAME or entry point; empty for the telescope")
    disturbance_source: str = _parameter(
        "", "disturbance of your own, MODULE:NAME or entry point; empty for that of the scenario"
    )
    k_fsm: str = _parameter("", "observer: file, MODULE:NAME or entry point; empty for the stored design")
    k_pma: str = _parameter("", "proof-mass controller: file, MODULE:NAME or entry point; empty for the stored design")
    hold_ticks: int = _parameter(20, "ticks without a valid command before it fades out", "ms", 1, 1000)
    fade_ticks: int = _parameter(20, "ticks of the fade to zero and back", "ms", 1, 10000)
    output: str = _parameter("", "folder of the bag; empty for a new one under bags/")
    namespace: str = _parameter(NAMESPACE, "namespace of nodes and topics; by hand: -r __ns:=NAMESPACE")
    domain: int = _parameter(-1, "ROS domain; -1 for ROS_DOMAIN_ID or 0", "", -1, 232)
    priority: bool = _parameter(True, "ask for real-time scheduling and locked memory")
    pin: bool = _parameter(True, "keep each node on one processor, if real-time scheduling is permitted")
    wait_for_recorder: bool = _parameter(False, "begin only when a recorder sees every topic")
    wait_for_start: bool = _parameter(False, "begin only when the service plant/start is called")
    start_timeout: float = _parameter(60.0, "wait for the other nodes at most this long", "s", 0.1, 3600.0)

    def __post_init__(self) -> None:
        for entry in fields(self):
            object.__setattr__(self, entry.name, _checked(entry, getattr(self, entry.name)))
        frame_ticks(self.camera_rate)
        for name in ("wheel_speed", "wheel_acceleration"):
            if len(getattr(self, name)) not in (0, 4):
                raise ValueError(f"{name} must hold four numbers, got {len(getattr(self, name))}")
        if not re.fullmatch(r"/|(/[A-Za-z_]\w*)+", self.namespace, re.ASCII):
            raise ValueError(f"namespace must be an absolute ROS name such as {NAMESPACE}, got {self.namespace!r}")
        self._check_code()
        if self.tau and self.theta:
            both = f"{self.theta:g} rad and {self.tau:g}"
            raise ValueError(f"one of theta or tau = tan(theta/4) must be 0, got both: {both}")
        if abs(self.ticks - self.duration * RATE) > 1e-6:
            raise ValueError(f"duration must be a whole number of milliseconds, got {self.duration} s")

    def _check_code(self) -> None:
        """Refuse settings that do not go with a plant, a controller or a disturbance of the user."""
        if self.plant and self.start != "rest":
            raise ValueError(f"start must be rest with a plant of your own, got {self.start}")
        for name in ("k_fsm", "k_pma"):
            if is_code(getattr(self, name)) and self.start != "rest":
                raise ValueError(f"start must be rest with {name} of your own code, got {self.start}")
        if self.disturbance_source and self.plant:
            raise ValueError(
                f"disturbance_source must be empty with a plant of your own, got {self.disturbance_source}"
            )
        if self.disturbance_source and (self.ramp_duration or self.profile not in ("linear", "trapezoidal")):
            raise ValueError("ramp_duration must be 0 and profile linear with a disturbance of your own, got a ramp")

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return round(self.duration * RATE)

    @property
    def array_angle(self) -> float:
        """Angle theta of both solar arrays at the start [rad], given as itself or as tau = tan(theta/4)."""
        return 4.0 * math.atan(self.tau) if self.tau else self.theta

    @property
    def frame_ticks(self) -> int:
        """Ticks from one camera frame to the next."""
        return frame_ticks(self.camera_rate)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> RunConfig:
        """Make a configuration from names and values; unknown names are refused.

        Raises
        ------
        ValueError
            Unknown name (the nearest known one is proposed) or a value that does not fit.
        """
        for name in values:
            if name not in FIELDS:
                raise ValueError(unknown(str(name)))
        return cls(**dict(values))

    @classmethod
    def from_file(cls, path: Path) -> RunConfig:
        """Read a YAML file of names and values; the form of a ROS parameter file is accepted too."""
        return cls.from_mapping(read_yaml(path))

    def to_mapping(self) -> dict[str, Any]:
        """Names and values with plain types, as :meth:`from_mapping` takes them."""
        values = {name: getattr(self, name) for name in FIELDS}
        return {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}

    def to_strings(self) -> dict[str, str]:
        """Names and values as text, for the metadata of a bag."""
        return {name: json.dumps(v) if not isinstance(v, str) else v for name, v in self.to_mapping().items()}


FIELDS: dict[str, Field[Any]] = {entry.name: entry for entry in fields(RunConfig)}

PHYSICAL = (
    "scenario",
    "worst_of",
    "seed",
    "noise",
    "disturbance",
    "camera_rate",
    "camera_dropout",
    "theta",
    "wheel_speed",
    "omega_1",
    "omega_2",
    "theta_rate",
    "wheel_acceleration",
    "ramp_duration",
    "profile",
    "parameters",
)
"""Fields that the plant is built from (beside the isolator, which follows from `loop`)."""


CHANGED = ("plant", "nonlinear", "disturbance_source")
"""Fields that change the plant itself; part of its hash where they are set."""


def is_code(text: str) -> bool:
    """Whether the name of a controller is that of code, MODULE:NAME or an entry point, and not that of a file.

    Examples
    --------
    >>> [is_code(name) for name in ("my.laws:Observer", "observer", "observer.json", "designs/k_fsm", "")]
    [True, True, False, False, False]
    """
    return bool(re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*|[A-Za-z_][\w-]*", text)) and not Path(text).is_file()


def unknown(name: str) -> str:
    """Message about a name that is not a parameter."""
    near = difflib.get_close_matches(name, FIELDS, 1)
    hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(FIELDS)}"
    return f"unknown parameter {name!r}: {hint}"


def read_yaml(path: Path) -> dict[str, Any]:
    """Names and values of a YAML file.

    Raises
    ------
    ValueError
        No such file, not YAML, or not a table.
    """
    content = load_yaml(read_text(path), path)
    if isinstance(content, dict) and set(content) == {"/**"}:
        content = content["/**"].get("ros__parameters") if isinstance(content["/**"], dict) else None
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold names and values, got another content")
    return content


def parse_value(name: str, text: str) -> Any:
    """Value of a ``NAME=VALUE`` on the command line."""
    if name not in FIELDS:
        raise ValueError(unknown(name))
    if isinstance(FIELDS[name].default, str):
        return text
    return load_yaml(text, name)


def physical_hash(config: RunConfig) -> str:
    """SHA-256 of the settings that the plant is built from."""
    values = {name: config.to_mapping()[name] for name in (*PHYSICAL, *(n for n in CHANGED if getattr(config, n)))}
    if values["profile"] == FIELDS["profile"].default:  # bags from before there were profiles keep their hash
        del values["profile"]
    values["theta"], values["isolated"] = config.array_angle, config.loop != "none"
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _checked(entry: Field[Any], value: Any) -> Any:
    meta, default = entry.metadata, entry.default
    name, unit = entry.name, f" {meta['unit']}" if meta["unit"] else ""
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{name} must be true or false, got {value!r}")
        return value
    if isinstance(default, str):
        choices = meta.get("choices")
        if not isinstance(value, str) or (choices and value not in choices):
            expected = f"one of {', '.join(choices)}" if choices else "a text"
            raise ValueError(f"{name} must be {expected}, got {value!r}")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)):
            raise ValueError(f"{name} must be a list of numbers, got {value!r}")
        return tuple(_number(name, unit, meta, float, item) for item in value)
    return _number(name, unit, meta, type(default), value)


def _number(name: str, unit: str, meta: Mapping[str, Any], kind: type, value: Any) -> Any:
    whole = kind is int
    odd = isinstance(value, bool) or not isinstance(value, (int, float))
    if odd or (whole and isinstance(value, float) and math.isfinite(value) and value != int(value)):
        raise ValueError(f"{name} must be {'a whole number' if whole else 'a number'}, got {value!r}")
    low, high = meta["low"], meta["high"]
    try:
        number = float(value)
    except OverflowError:  # an integer of more than 308 digits
        number = math.inf
    if not math.isfinite(number) or not low <= value <= high:
        raise ValueError(f"{name} must be between {low:g} and {high:g}{unit}, got {number:g}")
    return kind(value)
