"""A node that stops answering, or a tick that nobody completes: a line, then the end of the run with a readable bag."""

import os
import signal
import subprocess

import pytest
from los_testbed.run.processes.node_launch import EVENTS_VARIABLE, environment, parameter_file, ros_arguments
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for, live_nodes

from pointing_analysis.read.run import Run


def run_that_hangs(config, node):
    """Results of a run in which this node is stopped after 200 ticks, and the lines that were told meanwhile."""
    told: list[str] = []
    stopped: list[int] = []

    def progress(ticks):
        if ticks >= 200 and not stopped:
            stopped.append(runner.processes[node])
            os.kill(stopped[0], signal.SIGSTOP)

    runner = Runner(config, progress, tell=told.append, commands={"plant": PLANT})
    return runner.run(), told


@pytest.mark.parametrize(
    ("mode", "node"),
    [
        ("lockstep", "recorder"),
        ("realtime", "plant"),
        pytest.param("lockstep", "estimator", marks=pytest.mark.slow),
        pytest.param("realtime", "controller", marks=pytest.mark.slow),
    ],
)
def test_a_stopped_node_ends_the_run_with_a_bag(tmp_path, mode, node):
    """It is said after 5 s who is silent; after the time of the option the run ends, and the bag is whole."""
    results, told = run_that_hangs(config_for(tmp_path, duration=60.0, mode=mode, hang_timeout=6.0), node)
    assert told == [f"{node} has not responded for 5 s"]
    assert results.failures == [f"{node} has not responded for 6 s: the run was ended (--hang-timeout)"]
    run = Run.open(results.bag)
    assert len(run["truth/los"]) >= 200
    assert not [problem for problem in run.problems if "truncated" in problem]


def test_a_plant_that_no_runner_watches_ends_by_itself(tmp_path):
    """As on several hosts, where an observer dies: `run --only plant` waited for ever."""
    config = config_for(tmp_path, duration=3600.0, mode="lockstep", hang_timeout=5.0, wait_for_recorder=False)
    parameter_file(config, tmp_path / "plant.yaml")
    variables = environment(config.domain, tmp_path)
    del variables[EVENTS_VARIABLE]
    with live_nodes(config, tmp_path, "estimator", "controller"):
        plant = subprocess.Popen(
            [*PLANT, *ros_arguments(config.namespace, tmp_path / "plant.yaml")],
            env=variables,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert plant.stderr is not None
        assert any("run begins" in line for line in plant.stderr)
    _, said = plant.communicate(timeout=300)
    assert plant.returncode == 3
    assert said.splitlines()[-1].startswith("los_testbed plant: no tick for 7 s: no message on ")
    assert said.splitlines()[-1].endswith("the run was ended (--hang-timeout)")
