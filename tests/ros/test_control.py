"""A run that is changed while it goes on: settings at one tick, faults, life cycle, refusals, the record."""

import json
import time
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")
from los_testbed.run.processes.node_launch import node_command
from los_testbed.run.runner import Runner
from ros_faults import run_with_fault
from ros_runs import PLANT, config_for, topic_hashes
from user_node import UserNode

from fsm_pma_controller.fade import FADE_TICKS
from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

pytestmark = pytest.mark.ros


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
