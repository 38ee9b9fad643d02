"""A stranger with publishers of its own on the topics of a run: counted, reported while it lasts, never believed."""

import time
from typing import Any

import numpy as np
import pytest
from bystander import Bystander
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.diagnostics import read_diagnostics
from los_testbed.config.topics import FSM_COMMAND, TOPICS, TRUTH_LOS
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from ros_faults import diagnostics, run_with_fault
from ros_runs import PLANT, assert_plant_is_recorded, config_for, span_of, until

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent
from titop_plant.interface import TICK_NS

HOUR_NS = 3600 * 1_000_000_000
AHEAD, COMMANDS, MALFORMED, FALSE_REPORTS = 10, 50, 5, 3
OWN = "/telescope/plant/diagnostics"


def false_report():
    """What a node would send that claims to be the plant."""
    values = [KeyValue(key="missed_ticks", value="0"), KeyValue(key="ticks", value="zzz")]
    status = DiagnosticStatus(level=b"\0", name="telescope: plant", message="running", values=values)
    return serialize_message(DiagnosticArray(status=[status]))


def await_report(runner, topic):
    """Wait until the runner knows of the second publisher: during the run, not after it."""
    until(lambda: any(line.startswith(f"{topic} ") for line in runner.results.failures), f"nothing is said of {topic}")


def intrude(runner):
    truth, fsm = codec_for(TRUTH_LOS), codec_for(FSM_COMMAND)
    rogue = Bystander(runner.domain, (FSM_COMMAND, TRUTH_LOS), [TRUTH_LOS])
    reports = [rogue.node.create_publisher(DiagnosticArray, name, 100) for name in ("/diagnostics", OWN)]
    try:
        until(lambda: reports[1].get_subscription_count() >= 1, "nobody hears the reports")
        time.sleep(0.3)
        for topic in ("/telescope/truth/los", "/telescope/fsm/command", OWN):
            await_report(runner, topic)
        now = rogue.next(TRUTH_LOS)
        for i in range(AHEAD):
            rogue.send(TRUTH_LOS, truth.encode(now + HOUR_NS + i * TICK_NS, np.full(2, 1e-3)))
        for _ in range(COMMANDS):
            rogue.send(FSM_COMMAND, fsm.encode(rogue.next(TRUTH_LOS), np.full(2, 1e-3)))
        for publisher in reports:
            for i in range(MALFORMED):
                publisher.publish(false_report()[: 20 + i])
            for _ in range(FALSE_REPORTS):
                publisher.publish(false_report())
        rogue.settle()
        time.sleep(0.3)
    finally:
        rogue.close()


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return run_with_fault(tmp_path_factory.mktemp("strangers"), 300, intrude, after=500)


@pytest.mark.parametrize("topic", ["/telescope/truth/los", "/telescope/fsm/command", OWN])
def test_the_run_does_not_end_as_if_it_had_one_source(results, topic):
    """A failure gives the command line's exit code 3."""
    lines = [line for line in results.failures if line.startswith(f"{topic} ")]
    assert lines == [f"{topic} had a second publisher (node /bystander): its messages were not used"]


def test_samples_an_hour_ahead_are_counted_and_neither_stored_nor_lost(results):
    run, recorder = Run.open(results.bag), results.statistics["recorder"]
    assert recorder["foreign_/telescope/truth/los"] == str(AHEAD)
    assert recorder["second_publishers_/telescope/truth/los"] == "1"
    assert_plant_is_recorded(run, int(results.statistics["plant"]["ticks"]))
    span = span_of(run)
    missing = {topic.name: len(span) - len(run[topic.name]) for topic in TOPICS if not topic.framed}
    missing["camera/los"] = np.count_nonzero(span // TICK_NS % 20 == 0) - len(run["camera/los"])
    assert int(recorder["samples_lost"]) == sum(count - unsent(run, name) for name, count in missing.items())


def test_valid_commands_of_the_stranger_reach_no_actuator(results):
    plant, run = results.statistics["plant"], Run.open(results.bag)
    refused = sum(int(plant.get(f"rejected_fsm_{reason}", 0)) for reason in ("foreign", "unmatched", "future"))
    assert refused == COMMANDS
    assert plant["foreign_/telescope/fsm/command"] == str(COMMANDS)
    assert np.abs(run["fsm/strain_gauge"].values[:, :2]).max() < 3e-4, "1e-3 was asked for"
    assert np.abs(run["fsm/command"].values[:, :2]).max() < 3e-4, "nor are they stored"


def test_false_reports_do_not_change_the_statistics_of_the_run(results):
    """On /diagnostics, where everybody reports, and on the plant's own topic."""
    recorder = results.statistics["recorder"]
    recorded = Run.open(results.bag).parameters["statistics"]["plant"]
    assert recorded["ticks"] == results.statistics["plant"]["ticks"]
    assert recorded["missed_ticks"] == results.statistics["plant"]["missed_ticks"]
    assert recorder[f"unreadable_{OWN}"] == str(MALFORMED)
    assert recorder[f"foreign_{OWN}"] == str(FALSE_REPORTS)
    assert recorder["foreign_/telescope/truth/los"] == str(AHEAD)
    reports = list(reports_of_the_plant(results.bag))
    assert all(report.values["ticks"].isdecimal() for report in reports), "the false ones say zzz"
    assert reports[-1].values["ticks"] == results.statistics["plant"]["ticks"]
    assert any("second publisher on" in text for _, level, text in diagnostics(results.bag, "recorder") if level == 2)


def reports_of_the_plant(bag):
    """Its states in the bag, in order."""
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/diagnostics"]):
            yield from (s for s in read_diagnostics(message.data)[1] if s.name == "telescope: plant")


@pytest.mark.further
def test_a_second_publisher_is_reported_within_50_ms_of_its_first_message(tmp_path):
    """One message in each tick that it hears, from the moment it appears: at the report there are at most 50."""
    counts: list[Any] = []

    def follow(runner):
        fsm = codec_for(FSM_COMMAND)
        rogue = Bystander(runner.domain, (FSM_COMMAND,), [TRUTH_LOS], wait=False, pause=0.0)
        end = time.monotonic() + 60.0
        try:
            while not runner.results.failures or len(counts) < 200:
                assert time.monotonic() < end, "not reported"
                now = rogue.next(TRUTH_LOS)
                rogue.send(FSM_COMMAND, fsm.encode(now, np.zeros(2)))
                counts.append(now)
        finally:
            rogue.close()

    found = run_with_fault(tmp_path, 300, follow, after=100)
    reports = [s for s in reports_of_the_plant(found.bag) if "second publisher on /telescope/fsm/command" in s.message]
    assert int(reports[0].values.get("foreign_/telescope/fsm/command", 0)) <= 50
    assert int(found.statistics["plant"]["foreign_/telescope/fsm/command"]) > 50


def test_a_run_does_not_begin_with_two_senders_of_commands(tmp_path):
    config = config_for(tmp_path)
    rogue = Bystander(config.domain, wait=False, sends=(FSM_COMMAND,))
    try:
        with pytest.raises(
            RunError, match=r"/telescope/fsm/command must have one publisher, got also .*/bystander"
        ) as e:
            Runner(config, commands={"plant": PLANT}).run()
    finally:
        rogue.close()
    assert e.value.code == 2
