"""Topics under other names: recorded as they were sent, and a remap that was forgotten is told."""

import pytest
from los_testbed.run.processes.node_launch import node_command
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from ros_runs import PLANT, config_for

from pointing_analysis.read.run import Run


def remapped(command, **names):
    words = [word for name, other in names.items() for word in ("-r", f"{name}/accel:={other}")]
    return [*command, "--ros-args", *words]


def test_a_remapped_topic_is_recorded_as_it_was_sent_and_read_as_the_sensor(tmp_path):
    commands = {
        "plant": remapped(PLANT, m1="bench/m1"),
        "estimator": remapped(node_command("estimator"), m1="bench/m1"),
        "recorder": remapped(node_command("recorder"), m1="bench/m1"),
    }
    results = Runner(config_for(tmp_path, duration=0.3, mode="lockstep"), commands=commands).run()
    with next(results.bag.glob("*.mcap")).open("rb") as stream:
        counts = {channel.topic: 0 for channel in make_reader(stream).get_summary().channels.values()}
        for _, channel, _ in make_reader(stream).iter_messages():
            counts[channel.topic] += 1
    assert counts["/telescope/bench/m1"] == 300 and "/telescope/m1/accel" not in counts
    run = Run.open(results.bag)
    assert len(run["m1/accel"]) == 300 and run.parameters["remapped"] == {"/telescope/m1/accel": "/telescope/bench/m1"}
    assert run.parameters["statistics"]["recorder"]["samples_lost"] == "0"


@pytest.mark.parametrize(
    ("node", "told"),
    [
        ("plant", "no subscriber for /telescope/bench/m1; no publisher for /telescope/m1/accel"),
        pytest.param(
            "estimator",
            "no subscriber for /telescope/m1/accel; no publisher for /telescope/bench/m1",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_remap_of_one_node_alone_is_told_with_both_names(tmp_path, node, told):
    own = PLANT if node == "plant" else node_command(node)
    commands = {"plant": PLANT, node: remapped(own, m1="bench/m1")}
    runner = Runner(config_for(tmp_path, start_timeout=8.0, wait_for_recorder=False), commands=commands)
    with pytest.raises(RunError, match=r"got no message on /telescope/\w+/command.*; ") as error:
        runner.run()
    assert told in str(error.value)
