"""A node that another program ends by a signal is replaced like one that crashed; a recorder at the very end."""

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_faults import run_with_fault
from ros_runs import PLANT, assert_plant_is_recorded, config_for, until

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros


def end_once(name):
    return lambda runner: os.kill(runner.processes[name], signal.SIGTERM)


def until_replaced(name):
    """End the node, and wait until another one was started and works."""

    def fault(runner):
        before = runner.processes[name]
        os.kill(before, signal.SIGTERM)
        until(lambda: runner.processes[name] != before and (name, "ready") in runner._seen, f"no other {name}")

    return fault


@pytest.mark.parametrize("name", ["controller", pytest.param("estimator", marks=pytest.mark.slow)])
def test_a_follower_that_is_told_to_end_by_a_stranger_is_replaced(tmp_path, name):
    # long enough for the new node to find the recorder, too
    results = run_with_fault(tmp_path, 400, until_replaced(name), after=5000)
    told = [line for line in results.failures if not line.startswith("recorder")]  # starved, it may be replaced as well
    assert told == [f"{name} ended unexpectedly (signal 15); it was restarted"]
    run = Run.open(results.bag)
    assert run["fsm/command"].stamp[-1] > run["truth/los"].stamp[-1] - 2_000_000_000, "commands came back"


def test_a_recorder_that_is_told_to_end_by_a_stranger_records_the_rest_of_the_run(tmp_path):
    results = run_with_fault(tmp_path, 500, end_once("recorder"), 1.5)
    assert not results.failures
    assert results.bag == tmp_path / "bag"
    run = Run.open(results.bag)
    assert not run.problems
    assert_plant_is_recorded(run, int(results.statistics["plant"]["ticks"]))


def test_in_lockstep_it_ends_the_run_with_the_reason(tmp_path):
    with pytest.raises(RunError, match=r"^controller ended unexpectedly \(signal 15\)") as told:
        run_with_fault(tmp_path, 300, end_once("controller"), 60.0, mode="lockstep")
    assert told.value.code == 1


def test_a_recorder_that_is_killed_when_the_run_is_over_is_named_with_what_it_has_left(tmp_path):
    """So late that no other one can be there in time."""

    def progress(ticks):
        if ticks >= 1300 and not ended:
            ended.append(runner.processes["recorder"])
            os.kill(ended[0], signal.SIGKILL)

    ended, runner = [], None
    runner = Runner(config_for(tmp_path, duration=1.5), progress, {"plant": PLANT})
    with pytest.raises(RunError) as told:
        runner.run()
    text = str(told.value)
    assert text.startswith("recorder ended unexpectedly (signal 9)"), text
    assert text.endswith(f"{tmp_path / 'bag'} (if incomplete: los-testbed bag repair {tmp_path / 'bag'})"), text
    assert "KeyboardInterrupt" not in text and "there is no bag" not in text
    assert told.value.code == 1


def test_too_little_memory_for_the_nodes_is_refused_at_once(tmp_path):
    """The middleware of a process that cannot map its stacks waits in silence."""
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", "--duration=1", f"--output={tmp_path / 'bag'}"]
    limited = ["bash", "-c", 'ulimit -v 700000 && exec "$@"', "bash", *command]
    done = subprocess.run(
        limited, capture_output=True, text=True, timeout=600, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    )
    assert done.returncode == 2
    assert done.stderr.startswith("los-testbed: memory of a process (ulimit -v) must be at least"), done.stderr
    assert "got 700000" in done.stderr and "too little memory" in done.stderr
    assert not (tmp_path / "bag").exists()
