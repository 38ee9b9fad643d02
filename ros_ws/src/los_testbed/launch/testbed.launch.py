"""All nodes of a run; it ends when the plant has finished, with an error if one of them failed.

ros2 launch los_testbed testbed.launch.py duration:=60.0 loop:=fsm
ros2 launch los_testbed testbed.launch.py composed:=false
ros2 launch los_testbed testbed.launch.py params:=/path/to/run.yaml namespace:=/foo mode:=lockstep record:=false
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from los_testbed.config.run_config import NAMESPACE, RunConfig

from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.files.structured_text import load_yaml, read_text

SEPARATE = ("plant", "estimator", "controller", "recorder")
COMPOSED = ("plant", "estimator_controller", "recorder")
"""Programs of a run, with estimator and controller in two processes or in one."""

SETTINGS = ("mode", "duration", "loop", "scenario", "output")
ARGUMENTS = {
    "params": ("", "parameter file; empty for the one that is installed with the package"),
    "namespace": (NAMESPACE, RunConfig.SETTINGS["namespace"].text),
    **{
        name: ("", f"{own.text}; {own.range}" if (own := RunConfig.SETTINGS[name]).range else own.text)
        for name in SETTINGS
    },
    "composed": ("true", "whether estimator and controller are two nodes of one process"),
    "record": ("true", "whether a recorder takes part"),
    "live": ("false", "whether to serve viewers on 127.0.0.1: Foxglove's protocol on port 8765, a page on 8766"),
    "respawn": ("true", "in real time: whether a node that dies is started again, at most three times"),
}
"""Arguments with defaults and descriptions; an empty one leaves the value of the parameter file."""

RESPAWNS = 3
RESPAWN_DELAY_S = 0.5
"""The end of the run arrives within this time: a plant that has finished is not started again."""


def generate_launch_description() -> LaunchDescription:
    """Arguments, and the nodes that follow from them."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context):
    """Nodes and event handlers.

    Raises
    ------
    ValueError
        No such parameter file, or an argument that is neither true nor false.
    """
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    for name in ("composed", "record", "live", "respawn"):
        if given[name].lower() not in ("true", "false"):
            raise ValueError(f"{name} must be true or false, got {given[name]!r}")
    file = Path(given["params"] or Path(get_package_share_directory("los_testbed"), "config", "run.yaml"))
    if not file.is_file():
        raise ValueError(f"params must be a file, got {file}")
    record = given["record"].lower() == "true"
    values = settings(file, given, record)
    respawn = given["respawn"].lower() == "true" and values["mode"] == "realtime"
    programs = COMPOSED if given["composed"].lower() == "true" else SEPARATE
    names = programs if record else programs[:-1]
    # a recorder with a bag of a given name cannot begin it twice
    again = {name: respawn and not (name == "recorder" and values.get("output")) for name in names}
    nodes = {
        name: Node(
            package="los_testbed",
            executable=name,
            namespace=given["namespace"],
            parameters=[str(file), values],
            output="screen",
            respawn=again[name],
            respawn_delay=RESPAWN_DELAY_S,
            respawn_max_retries=RESPAWNS,
        )
        for name in names
    }
    end = LaunchEnd({name: RESPAWNS if again[name] else 0 for name in names})
    handlers = [
        RegisterEventHandler(OnProcessExit(target_action=node, on_exit=end.handler(name)))
        for name, node in nodes.items()
    ]
    parameters = [str(file), values]
    live = [
        Node(
            package="los_testbed",
            executable="live",
            namespace=given["namespace"],
            parameters=parameters,
            output="screen",
        )
    ]
    return [*handlers, *nodes.values(), *(live if given["live"].lower() == "true" else [])]


def settings(file, given, record):
    """Parameters that the arguments name, the mode, and what follows from it."""
    content = load_yaml(read_text(file), file)
    try:
        stated = content["/**"]["ros__parameters"]
    except (KeyError, TypeError):
        raise ValueError(f"params must be a ROS parameter file with /**: ros__parameters:, got {file}") from None
    values = {name: stated[name] for name in ("output",) if stated.get(name)}
    values.update({name: given[name] for name in SETTINGS if given[name]})
    if "duration" in values:
        values["duration"] = float(values["duration"])
    values["mode"] = values.get("mode", stated.get("mode", "realtime"))
    return {**values, "use_sim_time": values["mode"] == "lockstep", "wait_for_recorder": record}


class LaunchEnd:
    """Ends the run with the plant, or with a node that cannot be started again; fails if a node failed."""

    def __init__(self, respawns):
        self.running = set(respawns)
        self.respawns = dict(respawns)
        self.failures = []

    def handler(self, name):
        """What to do when this node ends."""

        def ended(event, context):
            code = event.returncode
            if code:
                self.failures.append(f"{name} ended with code {code}")
            if code and code != ExitCode.MISSED_TICKS and not context.is_shutdown and self.respawns[name]:
                self.respawns[name] -= 1
                return [LogInfo(msg=f"{self.failures[-1]}; it is started again")]
            self.running.discard(name)
            if not context.is_shutdown and (code or name == "plant"):
                why = self.failures[-1] if code else "the run is over"
                return [EmitEvent(event=Shutdown(reason=why))]
            if not self.running and self.failures:  # makes the return code of the launch 1
                raise RuntimeError("; ".join(self.failures))
            return [LogInfo(msg="all nodes ended without an error")] if not self.running else []

        return ended
