"""The configuration of a run: every setting, checked once, when it is made.

The same fields make the options of the commands, the YAML file, the ROS parameters with their descriptions and ranges,
and the metadata of the bag.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic.dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.file_kind import kind_of_file
from pointing_analysis.files.settings import nearest
from pointing_analysis.files.structured_text import load_yaml, read_text
from pointing_analysis.replay.gap_stepping import FILLS
from titop_plant.interface import NO_SCENARIO, RATE, STAGES
from titop_plant.physical_settings import DISTURBANCES, TELESCOPE, PhysicalSettings
from titop_plant.settings import STRICT, grouped, setting, settings_class, unknown

NAMESPACE = "/telescope"
"""Namespace of nodes and topics where none is given."""

ACTIVE = "active"
"""Change during a run that lets the output of a node fade to zero or in again."""

MODES = ("realtime", "lockstep", "inprocess")

AUTO = "auto"
"""Mode of the command line: real time on a fast enough machine, else lockstep; see :mod:`los_testbed.run.modes`."""

PROCESSES = COMPOSED, SEPARATE = ("composed", "separate")
"""Estimator and controller in one process, or each in its own."""

STEADY, AT_REST = STARTS = ("steady", "rest")
"""Start of a run: in the steady state of the loop under its tones and the sensors' bias; all states zero."""

OLD_FRAMES = ("correct", "use", "drop")
"""Treatment of an old frame: corrected for the mirror's motion since, used unchanged, not used."""

CONTROL, RIG, ROS = "Controllers and actuators", "Your own plant or rig", "ROS 2 and real time"
"""Groups of settings, beside those of the physical ones."""

WORST_OF = ("RPE", "APE", "slow", "fast")
"""Index for which the tone of the scenario worst_case is worst, see :mod:`los_loop.worst_tone`."""


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class RunConfig(PhysicalSettings):
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
    lftkit.errors.InputError: unknown parameter 'durtion': did you mean duration?
    """

    duration: float = setting(10.0, "length of the run", "s", 1e-3, 86400.0)
    mode: str = setting(MODES[0], "how plant, estimator and controller run", choices=MODES)
    loop: str = setting(STAGES[-1], "stage, the loops that are closed", choices=STAGES)
    worst_of: str = grouped(
        DISTURBANCES, setting(WORST_OF[0], "index for which the scenario worst_case is worst", choices=WORST_OF)
    )
    start: str = grouped(
        CONTROL, setting(STARTS[0], "start in the steady state of the running loop, or at rest", choices=STARTS)
    )
    fsm_authority: float | None = grouped(
        CONTROL, setting(None, "largest mirror angle per axis", "rad", 0.0, 1.0, absent="the telescope's own")
    )
    pma_authority: float | None = grouped(
        CONTROL, setting(None, "largest force of one actuator", "N", 0.0, 1e6, absent="the telescope's own")
    )
    nonlinear: bool = grouped(
        TELESCOPE, setting(False, "stroke and rate limits, quantised sensors, anti-alias filters")
    )
    plant: str | None = grouped(
        RIG, setting(None, "plant of your own, MODULE:NAME or entry point", absent="the telescope")
    )
    device: str | None = grouped(
        RIG, setting(None, "rig instead of the telescope, MODULE:NAME or entry point", absent="none")
    )
    device_address: str = grouped(
        RIG, setting("127.0.0.1:47800", "HOST:PORT or serial line of a rig with a reference driver")
    )
    device_key: str | None = grouped(
        RIG, setting(None, "key file of a rig, required for one on another machine", absent="no key")
    )
    disturbance_source: str | None = grouped(
        DISTURBANCES,
        setting(None, "disturbance of your own, MODULE:NAME or entry point", absent="that of the scenario"),
    )
    disturbance_files: str | None = grouped(
        DISTURBANCES, setting(None, "disturbance files, separated by semicolons", absent="none")
    )
    k_fsm: str | None = grouped(
        CONTROL, setting(None, "observer: file, MODULE:NAME or entry point", absent="the stored design")
    )
    k_pma: str | None = grouped(
        CONTROL, setting(None, "proof-mass controller: file, MODULE:NAME or entry point", absent="the stored design")
    )
    ports_in_order: bool = grouped(
        CONTROL,
        setting(False, "inputs and outputs without names are those of the loop in order"),
    )
    hold_ticks: int = grouped(
        CONTROL, setting(20, "ticks without a valid command before the command fades out", "ms", 1, 1000)
    )
    fade_ticks: int = grouped(CONTROL, setting(20, "ticks of the fade to zero and back", "ms", 1, 10000))
    old_frames: str = grouped(
        CONTROL, setting(OLD_FRAMES[0], "treatment of an old camera frame in the observer", choices=OLD_FRAMES)
    )
    lost_samples: str = grouped(
        CONTROL, setting(FILLS[0], "replacement for the samples of lost ticks in observer and law", choices=FILLS)
    )
    camera_latency: float = grouped(
        CONTROL, setting(0.0, "age up to which a camera frame is not late", "ms", 0.0, 60.0)
    )
    output: str | None = setting(None, "new folder of the bag", absent="one under bags/")
    namespace: str = grouped(ROS, setting(NAMESPACE, "namespace of nodes and topics; manually: -r __ns:=NAMESPACE"))
    domain: int | None = grouped(ROS, setting(None, "ROS domain", "", 0, 232, absent="ROS_DOMAIN_ID or 0"))
    processes: str = grouped(
        ROS, setting(PROCESSES[0], "estimator and controller in one process or in two", choices=PROCESSES)
    )
    priority: bool = grouped(ROS, setting(True, "ask for real-time scheduling and locked memory"))
    pin: bool = grouped(ROS, setting(True, "pin each node to one processor, if real-time scheduling is permitted"))
    wait_for_recorder: bool = grouped(ROS, setting(False, "start only when a recorder has matched every topic"))
    wait_for_start: bool = grouped(ROS, setting(False, "start only when the service plant/start is called"))
    start_timeout: float = grouped(ROS, setting(60.0, "longest wait for the other nodes", "s", 0.1, 3600.0))
    hang_timeout: float = grouped(
        ROS, setting(60.0, "time without a report of a node or a tick after which the run ends", "s", 5, 86400)
    )
    exercise: float = grouped(
        ROS, setting(0.0, "length of the trial before a real-time run; a slow trial ends the run", "s", 0, 60)
    )
    max_missed: float = grouped(ROS, setting(0.5, "largest share of missed ticks in real time", "%", 0.0, 100.0))
    mode_choice: str | None = grouped(ROS, setting(None, "reason for the mode", absent="requested"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not re.fullmatch(r"/|(/[A-Za-z_]\w*)+", self.namespace, re.ASCII):
            raise InputError(f"namespace must be an absolute ROS name such as {NAMESPACE}, got {self.namespace!r}")
        self._check_code()
        if abs(self.ticks - self.duration * RATE) > 1e-6:
            raise InputError(f"duration must be a whole number of milliseconds, got {self.duration} s")

    def _check_code(self) -> None:
        """Reject settings that are incompatible with a user's plant, controller or disturbance."""
        if self.device and (self.plant or self.mode != "realtime" or self.start != "rest"):
            got = f"plant {self.plant}, mode {self.mode}, start {self.start}"
            raise InputError(f"device must be given with mode realtime, start rest and no plant, got {got}")
        if self.plant and self.start != "rest":
            raise InputError(f"start must be rest with a plant of your own, got {self.start}")
        if self.disturbance_source and self.plant:
            raise InputError(
                f"disturbance_source must be absent with a plant of your own, got {self.disturbance_source}"
            )
        if self.disturbance_files and self.plant:
            raise InputError(f"disturbance_files must be absent with a plant of your own, got {self.disturbance_files}")
        if self.disturbance_files and (self.ramp_duration or self.motion_from_file):
            raise InputError("ramp_duration must be 0 and profile linear with files of disturbances, got a ramp")
        if self.disturbance_source and (self.ramp_duration or self.motion_from_file):
            raise InputError("ramp_duration must be 0 and profile linear with a disturbance of your own, got a ramp")

    @property
    def other_plant(self) -> str | None:
        """User's plant, or device, instead of the telescope; None for the telescope."""
        return self.plant or self.device

    @property
    def files_of_disturbance(self) -> tuple[str, ...]:
        """Files of disturbances, each ``FILE`` or ``FILE@PLACE``."""
        return tuple(part.strip() for part in (self.disturbance_files or "").split(";") if part.strip())

    @property
    def scenario_acts(self) -> bool:
        """Whether the tones of a scenario are on; of a configuration that says its scenario.

        Examples
        --------
        >>> [RunConfig(scenario=name).scenario_acts for name in ("imbalance", "none")]
        [True, False]
        """
        return self.disturbance and self.scenario != NO_SCENARIO

    @property
    def code_of_user(self) -> dict[str, str]:
        """Settings that name user code, with their values.

        Examples
        --------
        >>> RunConfig(plant="my.module:Plant", k_pma="designs/k_pma.json", start="rest").code_of_user
        {'plant': 'my.module:Plant'}
        """
        named = {name: getattr(self, name) for name in ("plant", "device", "disturbance_source")}
        named |= {name: law for name in ("k_fsm", "k_pma") if is_code(law := getattr(self, name))}
        return {name: value for name, value in named.items() if value}

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return round(self.duration * RATE)

    @property
    def bag(self) -> Path:
        """Folder of the bag.

        Raises
        ------
        ValueError
            None was given.
        """
        if self.output is None:
            raise InputError("output must be the folder of the bag, got none")
        return Path(self.output)

    def at_rest(self) -> RunConfig:
        """Configuration of a run with another plant: only the telescope has a known steady state."""
        return replace(self, start="rest")

    def emulated(self) -> RunConfig:
        """Configuration of the telescope that a rig emulator simulates, which has no duration."""
        return replace(self, device=None, start="rest", duration=RunConfig.SETTINGS["duration"].default)

    @classmethod
    def from_file(cls, path: Path) -> RunConfig:
        """Read a YAML file of names and values; the form of a ROS parameter file is accepted too."""
        return cls.from_mapping(read_yaml(path))


def is_library(text: str) -> bool:
    """Whether the name of a controller is that of a flight library.

    Examples
    --------
    >>> is_library("build/liblos_flight.so"), is_library("my.laws:Observer")
    (True, False)
    """
    return text.endswith(".so")


def is_code(text: str | None) -> bool:
    """Whether a controller is code: MODULE:NAME, an entry point or a flight library, and not a file of numbers.

    Examples
    --------
    >>> [is_code(name) for name in ("my.laws:Observer", "observer", "observer.json", "designs/k_fsm", None)]
    [True, True, False, False, False]
    """
    if text is None:
        return False
    if is_library(text):
        return True
    return bool(re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*|[A-Za-z_][\w-]*", text)) and not Path(text).is_file()


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
        raise InputError(
            f"{path} must be a YAML file of names and values, got {kind_of_file(path) or 'another content'}"
        )
    return content


def parse_value(name: str, text: str) -> Any:
    """Value of a ``NAME=VALUE`` on the command line."""
    if name not in RunConfig.SETTINGS:
        raise InputError(unknown(name, RunConfig.SETTINGS))
    if RunConfig.SETTINGS[name].kind is str:
        return text
    if RunConfig.SETTINGS[name].kind is tuple and "[" not in text:
        text = f"[{', '.join(text.split())}]"
    return load_yaml(text, name)


def settings_of(words: Iterable[str]) -> dict[str, Any]:
    """Settings of some ``NAME=VALUE``; a name that is like no setting is that of a parameter, for ``parameter_values``.

    Raises
    ------
    ValueError
        Another form, an unknown setting, a parameter that is given twice.

    Examples
    --------
    >>> settings_of(["seed=3", "isolator.stiffness=1.03"])
    {'seed': 3, 'parameter_values': {'isolator.stiffness': 1.03}}
    """
    settings: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign:
            raise InputError(f"--set must be NAME=VALUE, got {word!r}")
        if name in RunConfig.SETTINGS or ("." not in name and nearest(name, RunConfig.SETTINGS)):
            settings[name] = parse_value(name, text)
            continue
        values = settings.setdefault("parameter_values", {})
        if name in values:
            raise InputError(f"{name} must be given once, got {values[name]!r} and {text}")
        values[name] = load_yaml(text, name)
    return settings
