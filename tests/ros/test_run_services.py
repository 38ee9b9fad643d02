"""Start, stop and reset of a run by the clients of ROS, in lockstep, where the bits tell what was done."""

import json
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("std_srvs")
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for, until
from std_srvs.srv import Trigger
from user_node import UserNode

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
PLAIN_TICKS = 500


def ask(user, name):
    """Answer of a service of the plant."""
    answer = user.remote._call(Trigger, f"plant/{name}", Trigger.Request())
    return answer.success, answer.message


def control(runner, *requests):
    """Exit code and error output of `los-testbed control` with each of these words, all at the same time."""
    command = [sys.executable, "-m", "los_testbed.cli.app", "control"]
    commands = [[*command, *words, "--domain", str(runner.domain)] for words in requests]
    started = [
        subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for words in commands
    ]
    told = [process.communicate(timeout=240)[1] for process in started]
    return [(process.returncode, text) for process, text in zip(started, told)]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Bytes of a run that nobody touches."""
    folder = tmp_path_factory.mktemp("plain")
    config = config_for(folder, mode="lockstep", duration=PLAIN_TICKS / 1000)
    return Run.open(Runner(config, commands={"plant": PLANT}).run().bag)


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A run that waits for its start; its stage changes, it is reset, started again, and stopped."""
    folder = tmp_path_factory.mktemp("served")
    config = config_for(folder, mode="lockstep", duration=3600.0, wait_for_start=True)
    runner = Runner(config, commands={"plant": PLANT})
    found: dict[str, Any] = {}
    errors: list[BaseException] = []

    def use():
        user = UserNode(runner.domain)
        try:
            found["waiting"] = {name: ask(user, name) for name in ("stop", "reset")}
            found["ticks before the start"] = runner.ticks_done
            found["start"] = ask(user, "start")
            until(lambda: runner.ticks_done >= 300)
            found["running"] = ask(user, "start")
            found["commands"] = control(runner, ["reset", "--at", "0.001"], ["stage", "isolator"])
            user.remote.change("noise", False)
            ticks = runner.ticks_done
            until(lambda: runner.ticks_done >= ticks + 300)
            found["reset"] = ask(user, "reset")
            until(lambda: runner.ticks_done == 0)
            found["start again"] = ask(user, "start")
            until(lambda: runner.ticks_done >= PLAIN_TICKS + 200)
            found["stage after the reset"] = user.dump("controller")["loop"]
            found["stop"] = ask(user, "stop")
        except BaseException as error:
            errors.append(error)
            raise KeyboardInterrupt from error
        finally:
            user.close()

    thread = threading.Thread(target=use)
    thread.start()
    results = runner.run()
    thread.join()
    assert not errors, errors
    return found, results


def test_a_run_that_waits_begins_when_it_is_started(served):
    found, _ = served
    assert found["ticks before the start"] == 0
    answers = {name: found[name] for name in ("start", "reset", "start again", "stop")}
    assert all(obeyed for obeyed, _ in answers.values()), answers


def test_a_request_in_the_wrong_state_is_refused_with_the_reason(served):
    found, _ = served
    for name in ("stop", "reset"):
        assert found["waiting"][name] == (False, f"the run must be running for {name}, got waiting for its start")
    assert found["running"] == (False, "the run must be waiting for its start for start, got running")
    (late, reason), done = found["commands"]
    assert done == (0, "")
    assert late == 2 and reason.startswith("los-testbed: at must be later than") and reason.count("\n") == 1


def test_after_a_reset_the_run_has_the_same_bits_as_one_that_nobody_touched(served, plain):
    """Plant, estimator and controller are as new, the stage and the noise those of the start, in a bag of its own."""
    found, results = served
    assert found["stage after the reset"] == "fsm+pma"
    assert results.bag.name == "bag-2" and not results.failures and not results.interrupted
    again = Run.open(results.bag)
    for topic in plain.topics:
        n = len(plain[topic])
        assert np.array_equal(plain[topic].stamp, again[topic].stamp[:n]), topic
        assert np.array_equal(plain[topic].values, again[topic].values[:n], equal_nan=True), topic


def test_the_bag_from_before_the_reset_is_whole_and_names_the_changes(served, plain):
    (earlier,) = served[1].earlier
    assert served[1].warnings[-1] == f"the part before the reset is in {earlier}"
    run = Run.open(earlier)
    statistics = run.parameters["statistics"]["plant"]
    ticks = int(statistics["ticks"])
    assert len(run["truth/los"]) == ticks
    names = [change["name"] for change in json.loads(statistics["changes"])]
    assert names == ["noise", "reset"]
    assert np.array_equal(run["truth/los"].values[:300], plain["truth/los"].values[:300])
    assert plain["fsm/command"].values[-100:, :2].any() and not run["fsm/command"].values[-100:, :2].any()
