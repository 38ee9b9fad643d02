"""Estimator and controller as two nodes of one process: the same bits, the same faults, and the choice of the mode."""

import sys
from pathlib import Path

import numpy as np
import pytest
from bystander import kill_a_node, middleware
from los_testbed.bags.cdr import stamp_of
from los_testbed.cli.run import configure
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import FSM_COMMAND, LOS_ESTIMATE
from los_testbed.nodes.remote_control import remote_control
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.modes import EXERCISE_S
from los_testbed.run.runner import Runner
from ros_faults import when_running
from ros_runs import private_domain

from pointing_analysis.read.run import Run

SLOW_LAW = """
import time
import numpy as np

class Slow:
    def reset(self): pass
    def step(self, accel, out):
        time.sleep(3e-3)
        out[:] = 0.0
"""


def config_of(folder: Path, name: str, **values: object) -> RunConfig:
    base = {"duration": 0.4, "domain": private_domain(), "output": str(folder / name), "wait_for_recorder": True}
    return RunConfig.from_mapping({**base, **values})


def assert_same_samples(one: Path, other: Path) -> None:
    first, second = Run.open(one), Run.open(other)
    assert list(first.topics) == list(second.topics)
    for topic in first.topics:
        np.testing.assert_array_equal(first[topic].stamp, second[topic].stamp)
        np.testing.assert_array_equal(first[topic].values, second[topic].values)


def test_a_composed_run_in_lockstep_has_the_bits_of_one_process(tmp_path):
    """Separate nodes: test_runs_with_processes.py."""
    settings = {"mode": "lockstep", "camera_dropout": 0.3, "seed": 5}
    results = Runner(config_of(tmp_path, "composed", **settings)).run()
    assert not results.failures
    run_in_process(config_of(tmp_path, "inprocess", **settings), tmp_path / "inprocess")
    assert np.isnan(Run.open(tmp_path / "inprocess")["camera/los"].values).any()
    assert_same_samples(tmp_path / "composed", tmp_path / "inprocess")


@pytest.mark.further
def test_the_program_of_both_laws_is_replaced_as_one_and_the_plant_goes_on(tmp_path):
    config = config_of(tmp_path, "bag", duration=240.0)
    killed = []

    def kill(runner):
        assert runner.processes["estimator"] == runner.processes["controller"]
        killed.extend(kill_a_node(runner, "estimator"))  # both laws answer again

    results = when_running(config, kill, at=500, after=1000)
    assert len(results.failures) == 1
    assert results.failures[0].startswith("estimator_controller ended unexpectedly (signal 9)")
    run = Run.open(results.bag)
    for topic in (FSM_COMMAND.name, LOS_ESTIMATE.name):
        stamps = run[topic].stamp
        widest = int(np.argmax(np.diff(stamps)))
        assert stamps[widest + 1] - stamps[widest] > 50_000_000
        assert stamps[widest] < killed[1] and stamps[widest + 1] > killed[0]


@pytest.mark.parametrize("name", ["controller", pytest.param("estimator", marks=pytest.mark.slow)])
def test_a_node_that_is_shut_down_leaves_the_other_one(tmp_path, name):
    """Without an estimate there are no commands; the estimates go on without a controller."""
    config = config_of(tmp_path, "bag", duration=240.0)

    def shut_down(runner):
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        # it chooses the middleware by the environment, which the programs of later tests inherit
        with middleware(), remote_control(runner.domain, "/telescope", 10.0) as control:
            request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
            assert control._call(ChangeState, f"{name}/change_state", request).success

    results = when_running(config, shut_down, at=100, after=800)
    assert not results.failures
    assert [w for w in results.warnings if w.startswith(f"{name} was shut down by a life-cycle request")]
    run = Run.open(results.bag)
    end = run["truth/los"].stamp[-1]
    estimated, commanded = run["los_estimate"].stamp[-1], run["fsm/command"].stamp[-1]
    assert commanded < end - 500_000_000
    if name == "controller":
        assert estimated > commanded + 500_000_000, "the estimates go on"
    else:
        assert estimated < end - 500_000_000


@pytest.mark.further
def test_a_slow_law_runs_in_lockstep_where_no_mode_is_asked_for(tmp_path, monkeypatch):
    """Measured in the trial before the run, in which the law computes; the bag says what was asked and measured."""
    (tmp_path / "slow_law.py").write_text(SLOW_LAW)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    given = {"duration": 0.3, "domain": private_domain(), "output": "bag", "k_pma": "slow_law:Slow"}
    config = configure(None, [], given, free_mode=True)
    assert (config.mode, config.mode_choice, config.exercise) == ("realtime", "auto", EXERCISE_S)
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.run.execution import execute

    results = execute(RunParts(config))
    parameters = Run.open(results.bag).parameters
    assert parameters["mode"] == "lockstep"
    assert parameters["mode_choice"].startswith("auto: ")
    assert "ticks were answered late (limit 0.5 %)" in parameters["mode_choice"]


def test_the_trial_does_not_change_the_run(tmp_path):
    """Laws that have computed at hold ticks begin anew: lockstep after it has the same bits."""
    config = config_of(tmp_path, "tried", mode="lockstep")
    Runner(RunConfig.from_mapping({**config.to_plain(), "exercise": 0.5})).run()
    run_in_process(config, tmp_path / "inprocess")
    assert_same_samples(tmp_path / "tried", tmp_path / "inprocess")


def test_everything_of_a_tick_comes_in_one_message(tmp_path):
    """The message names its values, so that any ROS program can read it."""
    from los_testbed.nodes.support.transport.bundle import command_bundle, measurement_bundle
    from los_testbed.parts.run_parts import RunParts

    parts = RunParts(config_of(tmp_path, "bag"))
    measured, commanded = measurement_bundle(parts), command_bundle(parts)
    assert measured.size == 23 and commanded.size == 8
    assert measured.names[0] == "isolator/accel[0]" and measured.names[-1] == "camera/los age"
    assert commanded.names[:3] == ["fsm/command[0]", "fsm/command[1]", "pma/command[0]"]
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import JointState

    values = np.arange(23.0)
    data = bytes(measured.codec().encode(3_000_000, values))
    message = deserialize_message(data, JointState)
    assert list(message.name) == measured.names
    assert list(message.effort) == values.tolist()
    assert stamp_of(data) == 3_000_000
