"""Whole runs: four processes on ROS 2, started and ended by the test."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simple_telescope
from los_testbed.run.processes.node_launch import environment, node_command, parameter_file
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_faults import diagnostics
from ros_runs import (
    PLANT,
    assert_gaps_are_counted,
    assert_plant_is_recorded,
    config_for,
    judged_at_pace,
    lockstep_and_alone,
    span_of,
    topic_hashes,
)
from simple_telescope import SimpleTelescope

from pointing_analysis.read.run import Run

FOLLOWERS = {"los_estimate": "estimator", "fsm/command": "controller", "pma/command": "controller"}
"""Topics of the nodes that follow the plant."""


@pytest.fixture(scope="module")
def real_time(tmp_path_factory):
    folder = tmp_path_factory.mktemp("realtime")
    config = config_for(folder, duration=1.1)
    seen: list[Any] = []
    results = Runner(config, seen.append, {"plant": PLANT}).run()
    return config, results, seen


def test_every_sample_of_every_topic_is_in_the_bag(real_time):
    _, results, seen = real_time
    run = Run.open(results.bag)
    assert not run.problems
    assert_plant_is_recorded(run, 1100)
    for name, node in FOLLOWERS.items():
        assert_gaps_are_counted(run, name, node)
        assert run[name].integrity.duplicates == 0
        assert np.isin(run[name].stamp, run["truth/los"].stamp).all()
    assert seen == sorted(seen)
    if judged_at_pace(run, "how often the plant tells of its progress"):
        assert len(seen) > 1100 / 200  # one for 100 ticks that are sent, where nothing else waits


def test_reports_of_a_run_that_has_lost_no_sample_do_not_say_that_it_has(real_time):
    _, results, _ = real_time
    texts = [text for _, _, text in diagnostics(results.bag, "recorder")]
    assert texts and ("samples lost" in texts) <= (results.statistics["recorder"]["samples_lost"] != "0")


def test_lockstep_gives_the_bytes_of_the_run_in_one_process(tmp_path):
    config = config_for(tmp_path, mode="lockstep", duration=1.1, seed=4, camera_dropout=0.2)
    hashes, *_ = lockstep_and_alone(config, tmp_path, SimpleTelescope(seed=4, dropout=0.2))
    assert hashes["/telescope/fsm/command"][0] == 1100 and hashes == topic_hashes(tmp_path / "alone")


SECOND = f"""
import sys
sys.path.insert(0, {str(Path(simple_telescope.__file__).parent)!r})
import simple_telescope
sys.exit(simple_telescope.main(listen_s=float(sys.argv.pop(1))))
"""
"""A plant that listens for so long before it sends; not at all is as where discovery takes longer than it listens."""


def second_plant(config, folder, listen_s):
    """A plant that is started by hand beside the one of a run."""
    parameters = folder / "run.yaml"
    parameter_file(config, parameters)
    command = [sys.executable, "-c", SECOND, str(listen_s), "--ros-args", "--params-file", str(parameters)]
    return subprocess.Popen(
        command, env=environment(config.domain, folder), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def interrupted_run(folder, heard="", listen_s=0.0):
    """A long run that is interrupted after others were refused beside it, and what they said."""
    config, found = config_for(folder, duration=600.0), {}
    found["folder of the second run"] = folder / "second"
    found["folder of the second run"].mkdir()
    second = config_for(found["folder of the second run"])

    def meanwhile(ticks):
        if ticks > 200 and "second run" not in found:
            begin = time.monotonic()
            with pytest.raises(ValueError) as refused:
                Runner(second, commands={"plant": PLANT}).run()
            found["second run"] = str(refused.value)
            if heard:
                found[heard] = second_plant(config, folder, listen_s)
                found[f"{heard}, told"] = found[heard].communicate(timeout=240)[1]
            found["ticks"] = ticks + 1000 * (time.monotonic() - begin)  # the plant did not wait for this
        if ticks > 500 and "stopped" not in found:
            found["stopped"] = True
            raise KeyboardInterrupt

    return Runner(config, meanwhile, {"plant": PLANT}).run(), found


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    return interrupted_run(tmp_path_factory.mktemp("interrupted"))


def test_an_interrupt_ends_the_run_cleanly_with_a_good_bag(interrupted):
    results, found = interrupted
    assert results.interrupted
    run = Run.open(results.bag)
    assert not run.problems
    count = len(span_of(run))
    assert 500 < count < found["ticks"] + 10_000
    assert_plant_is_recorded(run, count)
    for name, node in FOLLOWERS.items():
        assert_gaps_are_counted(run, name, node)


def test_a_second_run_on_the_same_domain_is_refused(interrupted):
    found = interrupted[1]
    assert "must be a ROS domain without another run" in found["second run"]
    assert not (found["folder of the second run"] / "bag").exists()


@pytest.mark.further
@pytest.mark.parametrize(
    ("heard", "listen_s"), [("at once", 20.0), pytest.param("discovered late", 0.0, marks=pytest.mark.slow)]
)
def test_a_plant_that_hears_another_one_refuses_to_start(tmp_path, heard, listen_s):
    """Also from another machine, where no lock file helps. It listens until it hears: on a busy machine, longer."""
    results, found = interrupted_run(tmp_path, heard, listen_s)
    assert found[heard].returncode == 2
    told = found[f"{heard}, told"]
    assert "ROS_DOMAIN_ID must be a domain without a plant" in told
    assert told.count("\n") == 1
    run = Run.open(results.bag)
    assert run["truth/los"].integrity.conflicts == 0


FAKE = """
import json, signal
def tell(event, **values):
    print(json.dumps({"event": event, **values}), flush=True)
signal.signal(signal.SIGINT, lambda *_: None)
tell("ready")
if PATIENT:
    signal.pause()
tell("done", bag=None, statistics={})
"""
"""A recorder that ends in order without a bag, at once or when it is told to."""


@pytest.mark.parametrize(
    "node",
    ["recorder", pytest.param("estimator", marks=pytest.mark.slow), pytest.param("controller", marks=pytest.mark.slow)],
)
def test_a_node_that_is_told_to_end_before_the_run_begins_ends_it_at_once(tmp_path, node):
    commands = {"plant": PLANT, node: [sys.executable, "-c", FAKE.replace("PATIENT", "False")]}
    with pytest.raises(RunError, match=rf"^{node} was ended before the run began$") as error:
        Runner(config_for(tmp_path), commands=commands).run()
    assert error.value.code == 1


def test_a_node_that_the_kernel_ended_for_computing_without_a_pause_is_told_of(tmp_path):
    killed = "import os, signal; os.kill(os.getpid(), signal.SIGXCPU)"
    words = r"^estimator ended unexpectedly \(signal 24: it computed for 1 s without yielding at real-time priority\)"
    with pytest.raises(RunError, match=words):
        Runner(config_for(tmp_path), commands={"plant": PLANT, "estimator": [sys.executable, "-c", killed]}).run()


ONCE = """
import os, signal, sys
from pathlib import Path
mark = Path({mark!r})
if not mark.exists():
    mark.touch()
    os.kill(os.getpid(), signal.SIGKILL)
from los_testbed.nodes import {node}
sys.exit({node}.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("node", "mode"),
    [
        ("estimator", "lockstep"),
        pytest.param("recorder", "realtime", marks=pytest.mark.slow),
        pytest.param("recorder", "lockstep", marks=pytest.mark.slow),
    ],
)
def test_a_node_that_dies_before_the_run_begins_is_started_again(tmp_path, node, mode):
    """Nothing is lost with it: the run is whole, with a warning."""
    commands = {"plant": PLANT, node: [sys.executable, "-c", ONCE.format(node=node, mark=str(tmp_path / "mark"))]}
    results = Runner(config_for(tmp_path, mode=mode, duration=0.6), commands=commands).run()
    assert not results.failures
    (warning,) = [text for text in results.warnings if text.startswith(node)]
    assert warning == f"{node} ended unexpectedly (signal 9); it was restarted before the run began"
    assert results.bag == tmp_path / "bag"
    stamps = Run.open(results.bag)["truth/los"].stamp
    assert len(stamps) == 600 if mode == "lockstep" else len(stamps) > 300


def test_a_run_that_nobody_interrupted_and_that_has_no_bag_has_failed(tmp_path):
    commands = {"plant": PLANT, "recorder": [sys.executable, "-c", FAKE.replace("PATIENT", "True")]}
    with pytest.raises(RunError, match=r"^recorder: no message received; there is no bag$") as error:
        Runner(config_for(tmp_path, duration=0.3, wait_for_recorder=False), commands=commands).run()
    assert error.value.code == 1


def test_a_node_that_dies_ends_the_run_and_is_named(tmp_path):
    config = config_for(tmp_path, duration=60.0)
    dying = [sys.executable, "-c", "import time; time.sleep(1); raise SystemExit('broken on purpose')"]
    with pytest.raises(RunError, match=r"controller ended unexpectedly .*broken on purpose"):
        Runner(config, commands={"plant": PLANT, "controller": dying}).run()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_leaves_at_once_when_it_is_told_to(tmp_path, number):
    config = config_for(tmp_path)
    parameters = tmp_path / "run.yaml"
    parameter_file(config, parameters)
    process = subprocess.Popen(
        [*node_command("estimator"), "--ros-args", "--params-file", str(parameters)],
        env=environment(config.domain, tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        while json.loads(process.stdout.readline())["event"] != "ready":
            pass
        os.kill(process.pid, number)
        assert process.wait(10) == 0
        assert b"Traceback" not in process.stderr.read()
    finally:
        process.kill()
        process.communicate()
