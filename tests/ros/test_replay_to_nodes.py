"""Replay of bags of real runs: bit by bit, in this process and through live nodes that the bag drives."""

import json
import subprocess
import sys

import numpy as np
import pytest
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import IMAGE_NAME
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.processes.node_launch import environment
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for, live_nodes
from support.unjudged import judged

from pointing_analysis.read.run import Run


@pytest.fixture(scope="module", params=["realtime", pytest.param("lockstep", marks=pytest.mark.slow)])
def recorded(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    config = config_for(folder, mode=request.param, duration=1.2, seed=5, camera_dropout=0.2)
    results = Runner(config, commands={"plant": PLANT}).run()
    return config, results.bag


def call(config, folder, *arguments):
    """The command line as a user starts it: exit code, last line as JSON, error output."""
    variables = environment(config.domain, folder)
    variables.pop("LOS_TESTBED_EVENTS")
    command = [sys.executable, "-m", "los_testbed.cli.app", "replay", *map(str, arguments)]
    done = subprocess.run(command, env=variables, cwd=folder, capture_output=True, text=True, timeout=200)
    lines = done.stdout.strip().splitlines()
    return done.returncode, json.loads(lines[-1]) if lines else {}, done.stderr


def test_a_recorded_run_comes_out_again_bit_by_bit(recorded, tmp_path):
    config, bag = recorded
    code, found, errors = call(config, tmp_path, bag, "--json")
    assert code == 0, errors
    assert found["as_recorded"] and found["identical"]
    assert {d["topic"] for d in found["differences"]} == {"los_estimate", "fsm/command", "pma/command"}
    original = Run.open(bag)
    assert {d["topic"]: d["compared"] for d in found["differences"]} == {
        name: len(original[name]) for name in ("los_estimate", "fsm/command", "pma/command")
    }
    assert found["recorded"] == found["replayed"]


def test_live_nodes_driven_by_a_bag_answer_as_recorded(recorded, tmp_path):
    """Estimator and controller, fresh processes: a tick that a busy machine lets them miss is the only difference."""
    config, bag = recorded
    with live_nodes(config, tmp_path, "estimator", "controller"):
        code, found, errors = call(
            config, tmp_path, bag, "--to-ros", f"--domain={config.domain}", "--output", tmp_path / "answers", "--json"
        )
    assert code == 0, errors
    assert found["ticks"] == len(Run.open(bag)["truth/los"])
    assert min(found["answers"].values()) > 0.5 * found["ticks"]
    answers, original = Run.open(tmp_path / "answers"), Run.open(bag)
    assert answers["isolator/accel"].values.tobytes() == original["isolator/accel"].values.tobytes()
    ours, theirs = answers["los_estimate"], original["los_estimate"]
    count = min(len(ours), len(theirs))
    until = int(np.argmin(np.append(np.diff(ours.stamp[:count]) == np.diff(theirs.stamp[:count]), False))) + 1
    same = ours.values[:until, :2] == theirs.values[:until, :2]
    assert np.all(same), "the nodes did not start from their zero state"
    missed = found["ticks"] - min(found["answers"].values())
    if judged(not missed and not found["late"], "that all answers of live nodes are as recorded", "samples were lost"):
        assert found["identical"], errors


def test_frames_of_the_camera_come_to_a_recorder(tmp_path):
    """The bag of a run with images drives live nodes and a recorder, whose bag has the same frames, byte by byte."""
    file = tmp_path / "image.toml"
    file.write_text('base = "reference"\n[sensors]\ncamera = "image"\n', "utf-8")
    config = config_for(tmp_path, mode="realtime", duration=1.0, seed=5, parameters=str(file))
    original = tmp_path / "original"
    run_in_process(config, original)
    with live_nodes(config, tmp_path, "estimator", "controller", "recorder"):
        code, found, errors = call(config, tmp_path, original, "--to-ros", f"--domain={config.domain}", "--json")
    assert code == 0, errors
    recorded = Run.open(config.output)
    ours, theirs = ({stamp_of(m): m for m in run.messages(IMAGE_NAME)} for run in (recorded, Run.open(original)))
    assert len(theirs) == 50 and found["ticks"] == 1000
    assert ours and all(theirs[stamp] == message for stamp, message in ours.items())
    assert recorded.parameters["camera"]["magnitude"] == 14.0
    angles, sent = recorded["camera/los"], Run.open(original)["camera/los"]
    _, i, j = np.intersect1d(angles.stamp, sent.stamp, return_indices=True)
    assert len(i) and np.array_equal(angles.values[i], sent.values[j], equal_nan=True)
    lost = recorded.parameters["statistics"]["recorder"]["samples_lost"]
    if judged(lost == "0", "that a recorder has all frames", "samples were lost"):
        assert set(ours) == set(theirs)
