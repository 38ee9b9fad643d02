"""A run that is changed while it goes on: settings, faults, life cycle, services, refusals, impostors, the record."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
import yaml
from bystander import Bystander
from los_testbed.bags.cdr import codec_for
from los_testbed.config.topics import FSM_COMMAND, TRUTH_LOS
from los_testbed.nodes.support.parameters import FAULT
from los_testbed.run.processes.node_launch import node_command
from los_testbed.run.runner import Runner
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_faults import run_with_fault
from ros_runs import PLANT, config_for, judged_at_pace, topic_hashes, until
from std_srvs.srv import Trigger
from user_node import UserNode

from fsm_pma_controller.fade import FADE_TICKS
from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS


@pytest.fixture(scope="module")
def controlled(tmp_path_factory):
    """One run in real time with all that a user may do."""
    folder = tmp_path_factory.mktemp("controlled")
    found: dict[str, Any] = {}

    def use(runner):
        user = UserNode(runner.domain)
        remote = user.remote
        try:
            found["refused"] = {
                "stage": user.refused(remote.change, "stage", "none"),
                "unknown": user.refused(remote.change, "stage", "fast"),
                "range": user.refused(remote.change, "camera_dropout", 1.5),
                "authority": user.refused(remote.change, "fsm_authority", 1.0),
                "past": user.refused(remote.change, "noise", False, 0.01),
                "name": user.refused(remote.change, "seed", 3),
                "active": user.refused(remote.turn, "controller", "activate"),
            }
            remote.turn("controller", "deactivate")
            time.sleep(0.5)
            remote.turn("controller", "activate")
            remote.change("disturbance", False)
            remote.change("stage", "isolator")
            time.sleep(0.5)
            found["after"] = user.dump("controller")["loop"]
        finally:
            user.close()

    results = run_with_fault(folder, 700, use, after=300)
    run = Run.open(results.bag)
    changes = {
        (c["name"], c["value"]): c["tick"]
        for node in ("plant", "controller")
        for c in json.loads(run.parameters["statistics"][node]["changes"])
    }
    return found, results, run, changes


def test_what_is_out_of_range_or_in_the_wrong_state_is_refused_with_the_reason(controlled):
    refused = controlled[0]["refused"]
    assert refused["stage"].startswith("loop must be a stage with the isolator")
    assert refused["unknown"].startswith("loop must be one of")
    assert refused["range"] == "camera_dropout must be between 0 and 1, got 1.5"
    assert refused["authority"].startswith("fsm_authority must be positive and at most")
    assert refused["past"].startswith("at must be later than")
    assert refused["name"].startswith("name must be a setting that can change during a run")
    assert refused["active"].startswith("controller must be inactive")
    assert not any(line in str(controlled[3]) for line in ("none", "fast", "seed"))


def test_an_inactive_controller_brings_the_actuators_smoothly_to_zero_and_back(controlled):
    _, _, run, changes = controlled
    angle, stamp = run["fsm/command"].values[:, :2], run["fsm/command"].stamp
    tick = (stamp - run["truth/los"].stamp[0]) // TICK_NS
    inside = (tick > changes["active", False] + 60) & (tick < changes["active", True] - 5)
    assert inside.sum() > 20
    assert np.all(angle[inside] == 0.0)
    largest = np.abs(angle).max()
    assert largest > 5e-5
    rates = np.abs(np.diff(angle, axis=0)).max(axis=1) / np.diff(tick)
    fading = (tick[1:] > 600) & (tick[1:] < changes["loop", "isolator"])
    assert rates[fading].max() < 0.2 * largest, "over 20 ticks, not at once"


def test_changes_apply_at_the_tick_that_the_bag_names(controlled):
    found, _, run, changes = controlled
    command, truth = run["fsm/command"], run["truth/los"]
    tick = (command.stamp - truth.stamp[0]) // TICK_NS
    switched = changes["loop", "isolator"]
    faded = command.values[tick >= switched][FADE_TICKS - 1 :, :2]  # in steps of the law: ticks may be missed
    assert len(faded) > 100 and np.all(faded == 0.0)
    steps = np.abs(np.diff(command.values[:, :2], axis=0)).max(axis=1) / np.diff(tick)
    largest = np.abs(command.values[:, :2]).max()
    assert steps[tick[1:] >= switched].max() < 0.2 * largest, "over 20 ticks, not at once"
    assert np.any(command.values[tick < switched][-50:, :2] != 0.0)
    assert found["after"] == "isolator", "the parameter follows"
    quiet = truth.values[
        (truth.stamp - truth.stamp[0]) // TICK_NS >= max(switched, changes["disturbance", False]) + 50 + FADE_TICKS
    ]
    assert len(quiet) > 100
    assert np.abs(quiet).max() < 1e-7


def test_a_change_at_a_tick_gives_the_same_bits_twice_in_lockstep(tmp_path):
    changes = {
        "controller": {"name": "stage", "value": "isolator", "at": 0.5},
        "plant": {"name": "stop", "value": True, "at": 0.699},
    }
    hashes = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        commands = {}
        for node, change in changes.items():
            file = folder / f"{node}.yaml"
            file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"fault": json.dumps(change)}}}))
            own = PLANT if node == "plant" else node_command(node)
            commands[node] = [*own, "--ros-args", "--params-file", str(file)]
        config = config_for(folder, mode="lockstep", duration=60.0)
        results = Runner(config, commands={"plant": PLANT, **commands}).run()
        hashes.append(topic_hashes(folder / "bag"))
    assert hashes[0] == hashes[1]
    assert hashes[0]["/telescope/truth/los"][0] == 700
    assert not results.interrupted and not results.failures
    run = Run.open(results.bag)
    zero = np.all(run["fsm/command"].values[:, :2] == 0.0, axis=1)
    last = 500 + FADE_TICKS - 1  # of the fade, at zero
    assert np.flatnonzero(zero)[last - 700 :].tolist() == list(range(last, 700))
    assert not zero[300:last].any()


TURNS, FORGED = 6, 50

NO_CHANGES = [
    '{"name": "camera_dropout", "value": NaN}',
    '{"name": "camera_dropout", "value": Infinity}',
    '{"name": "camera_dropout", "value": ' + "9" * 400 + "}",
    '{"name": "camera_dropout", "value": ' + "9" * 5000 + "}",
    '{"name": "camera_dropout", "value": 0.1, "at": NaN}',
    '{"name": "camera_dropout", "value": "0.1"}',
    '{"name": "stop", "value": false}',
    '{"name": "active", "value": false}',
    '{"name": "\\ud800", "value": "\\ud800"}',
    "[" * 20_000,
    "{",
]


def set_fault(*texts):
    """A request with these values, each set by itself; a node answers five requests a second."""
    return SetParameters.Request(parameters=[Parameter(FAULT, value=text).to_parameter_msg() for text in texts])


def use(runner, found):
    user = UserNode(runner.domain)
    remote = user.remote
    try:
        found["refused"] = [
            result
            for node in ("plant", "controller")
            for result in remote._call(SetParameters, f"{node}/set_parameters", set_fault(*NO_CHANGES)).results
        ]
        for _ in range(TURNS):
            remote.turn("controller", "deactivate")
            remote.turn("controller", "activate")
        forge(runner.domain)
    finally:
        user.close()


def forge(domain):
    """Commands from a node with the name of the controller."""
    codec = codec_for(FSM_COMMAND)
    impostor = Bystander(domain, [FSM_COMMAND], [TRUTH_LOS], name="controller", namespace="/telescope")
    try:
        for _ in range(FORGED):
            impostor.send(FSM_COMMAND, codec.encode(impostor.next(TRUTH_LOS), np.full(2, 1e-3)))
        impostor.settle()
    finally:
        impostor.close()


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    found: dict[str, Any] = {}
    results = run_with_fault(tmp_path_factory.mktemp("rough"), 300, lambda runner: use(runner, found), after=500)
    return found, results, Run.open(results.bag)


def test_texts_that_are_no_change_are_refused_with_a_reason_and_end_no_node(rough):
    assert [result.successful for result in rough[0]["refused"]] == [False] * 2 * len(NO_CHANGES)
    reasons = [result.reason for result in rough[0]["refused"]]
    assert [text for text in reasons if "must be" not in text and "unknown parameter 'active'" not in text] == []
    assert not any("again" in line for line in rough[1].failures), "no node was started again"


def test_a_controller_turned_off_and_on_many_times_is_on_in_the_end(rough):
    statistics, run = rough[1].statistics["controller"], rough[2]
    turns = [change["value"] for change in json.loads(statistics["changes"]) if change["name"] == "active"]
    assert turns == [False, True] * TURNS
    assert np.abs(run["fsm/command"].values[-200:, :2]).max() > 5e-5


def test_commands_of_an_impostor_with_the_name_of_the_controller_reach_no_actuator(rough):
    _, results, run = rough
    line = "/telescope/fsm/command had a second publisher (node of the same name): its messages were not used"
    assert line in results.failures
    plant = results.statistics["plant"]
    seen = int(plant["foreign_/telescope/fsm/command"])
    assert seen <= FORGED
    if judged_at_pace(run, "that the plant sees every forged command"):
        assert seen == FORGED
    refused = sum(int(plant.get(f"rejected_fsm_{reason}", 0)) for reason in ("foreign", "unmatched", "future"))
    assert refused == seen
    own = np.abs(run["fsm/command"].values[:, :2]).max()
    assert own < 9e-4, "1e-3 was asked for"
    angle = np.abs(run["fsm/strain_gauge"].values[:, :2]).max()
    assert angle < 9e-4
    if judged_at_pace(run, "that the mirror follows the recorded commands"):
        assert angle < 1.1 * own


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

    def started_again(user):
        """The plant may not yet wait for its start when its first ticks are gone."""
        found["start again"] = ask(user, "start")
        return found["start again"][0]

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
            until(lambda: started_again(user))
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
