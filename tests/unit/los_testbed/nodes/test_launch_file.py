"""The launch file: arguments, parameters of the nodes, restarts, end. The launch packages have no wheels: stand-ins."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml
from los_testbed.config.run_config import RunConfig

PACKAGE = Path(__file__).parents[4] / "ros_ws" / "src" / "los_testbed"


class Kept(SimpleNamespace):
    """An action that keeps what it was given."""

    def __init__(self, *positional, **named):
        super().__init__(positional=positional, **named)

    def perform(self, context):
        return context.arguments[self.positional[0]]


@pytest.fixture
def launched(monkeypatch):
    """The launch file's functions, with stand-ins for the packages that it imports."""
    names: dict[str, dict[str, Any]] = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(PACKAGE)},
        "launch": {"LaunchDescription": Kept},
        "launch.actions": dict.fromkeys(
            ("DeclareLaunchArgument", "EmitEvent", "LogInfo", "OpaqueFunction", "RegisterEventHandler"), Kept
        ),
        "launch.event_handlers": {"OnProcessExit": Kept},
        "launch.events": {"Shutdown": Kept},
        "launch.substitutions": {"LaunchConfiguration": Kept},
        "launch_ros.actions": {"Node": type("Node", (Kept,), {})},
    }
    for name, content in names.items():
        for part in (name.split(".")[0], name):
            module = ModuleType(part)
            module.__dict__.update({**(content if part == name else {}), "__path__": []})
            if part == name or part not in sys.modules:
                monkeypatch.setitem(sys.modules, part, module)
    return SimpleNamespace(**runpy.run_path(str(PACKAGE / "launch" / "testbed.launch.py")))


def actions(launched, **given):
    defaults = {name: value for name, (value, _) in launched.ARGUMENTS.items()}
    found = launched.start(SimpleNamespace(arguments={**defaults, **given}))
    nodes = {action.executable: action for action in found if hasattr(action, "executable")}
    ends = {
        action.positional[0].target_action.executable: action.positional[0].on_exit
        for action in found
        if action.positional
    }
    return nodes, ends


@pytest.mark.parametrize(("mode", "simulated"), [("", False), ("realtime", False), ("lockstep", True)])
def test_simulated_time_and_restarts_follow_from_the_mode(launched, mode, simulated):
    nodes, _ = actions(launched, mode=mode)
    assert set(nodes) == {"plant", "estimator_controller", "recorder"}
    for node in nodes.values():
        values = node.parameters[1]
        assert values["use_sim_time"] is simulated
        assert node.respawn is not simulated
        assert node.respawn_max_retries == 3
        assert set(values) - {"use_sim_time"} <= set(RunConfig.SETTINGS)
        RunConfig.from_mapping({name: value for name, value in values.items() if name != "use_sim_time"})


def test_the_mode_may_stand_in_the_parameter_file(launched, tmp_path):
    file = tmp_path / "run.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"mode": "lockstep"}}}))
    nodes, _ = actions(launched, params=str(file), namespace="/foo", duration="2.5", record="false", composed="false")
    assert set(nodes) == {"plant", "estimator", "controller"}
    values = nodes["plant"].parameters[1]
    assert values == {"mode": "lockstep", "duration": 2.5, "use_sim_time": True, "wait_for_recorder": False}
    assert nodes["plant"].namespace == "/foo"


def test_a_run_without_failures_ends_with_the_plant(launched):
    _, ends = actions(launched, composed="false")
    (over,) = ends["plant"](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=False))
    assert over.event.reason == "the run is over"
    for name in ("estimator", "controller"):
        assert ends[name](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=True)) == []
    (last,) = ends["recorder"](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=True))
    assert last.msg == "all nodes ended without an error"


def test_a_node_that_died_is_started_again_and_the_launch_fails_at_the_end(launched):
    _, ends = actions(launched, composed="false")
    for _ in range(3):
        (told,) = ends["controller"](SimpleNamespace(returncode=-9), SimpleNamespace(is_shutdown=False))
        assert told.msg == "controller ended with code -9; it is started again"
    (given_up,) = ends["controller"](SimpleNamespace(returncode=-9), SimpleNamespace(is_shutdown=False))
    assert given_up.event.reason == "controller ended with code -9"
    for name in ("plant", "estimator"):
        ends[name](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=True))
    with pytest.raises(RuntimeError, match="controller ended with code -9"):
        ends["recorder"](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=True))
    _, ends = actions(launched, mode="lockstep", composed="false")  # there it ends the run
    (over,) = ends["estimator"](SimpleNamespace(returncode=1), SimpleNamespace(is_shutdown=False))
    assert over.event.reason == "estimator ended with code 1"
