"""Two testbeds on one domain of one machine, each in its namespace: names, counts and verdicts of its own."""

import socket
import subprocess
import sys
import threading

import pytest
from bystander import Bystander
from los_testbed.config.run_config import RunConfig
from los_testbed.run.processes.domains import (
    DOMAIN_GAIN,
    FIRST_PARTICIPANT,
    PARTICIPANT_GAIN,
    PORT_BASE,
    domain_lock,
    free_domain,
    output_lock,
)
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from ros_runs import PLANT, config_for, lost_samples, span_of

from pointing_analysis.read.run import Run

SEEDS = {"/foo": 3, "/foo/bar": 4}
TICKS = {"/foo": 800, "/foo/bar": 1200}


def run_both(tmp_path_factory, ticks):
    """Results of two runs at the same time."""
    found = {}

    def run(namespace):
        folder = tmp_path_factory.mktemp("run")
        values = {"namespace": namespace, "seed": SEEDS[namespace], "duration": ticks[namespace] / 1000}
        found[namespace] = Runner(config_for(folder, **values), commands={"plant": PLANT}).run()

    threads = [threading.Thread(target=run, args=(namespace,)) for namespace in SEEDS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(found) == set(SEEDS)
    return found


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    return run_both(tmp_path_factory, TICKS)


@pytest.mark.parametrize("namespace", SEEDS)
def test_each_run_counts_its_own_ticks_and_is_alone_on_its_topics(both, namespace):
    results = both[namespace]
    assert not results.failures
    plant = results.statistics["plant"]
    assert plant["ticks"] == str(TICKS[namespace])
    assert 0 <= int(plant["missed_ticks"]) <= int(plant["ticks"]) + 1
    assert not [name for name in results.statistics["recorder"] if name.startswith(("foreign", "second"))]


@pytest.mark.parametrize("namespace", SEEDS)
def test_the_bag_has_the_names_that_were_used_and_its_own_statistics(both, namespace):
    bag = both[namespace].bag
    with next(bag.glob("*.mcap")).open("rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    assert {topic for topic in topics if not topic.startswith(f"{namespace}/")} == {"/diagnostics"}
    run = Run.open(bag)
    assert run.namespace == namespace
    assert run.parameters["namespace"] == namespace
    assert run.parameters["seed"] == SEEDS[namespace]
    assert run.parameters["statistics"]["plant"]["ticks"] == str(TICKS[namespace])
    missing = len(span_of(run)) - len(run["truth/los"])
    assert lost_samples(run, "truth/los", namespace) == missing


def test_a_free_domain_is_one_without_participants_and_without_a_run():
    with free_domain("/telescope") as first, free_domain("/telescope") as second:
        assert second > first
        with pytest.raises(ValueError, match="must be a ROS domain without another run in namespace /telescope"):
            domain_lock(first, "/telescope").__enter__()
    assert 0 <= first < second <= 101


def test_a_run_to_a_place_that_another_run_has_is_refused_before_anything_is_started(tmp_path):
    """The other one may not have made its bag yet."""
    config = config_for(tmp_path)
    with output_lock(config.bag):
        runner = Runner(config, commands={"plant": PLANT})
        with pytest.raises(ValueError, match="--output must not be in use by another run"):
            runner.run()
        assert not runner.processes
    with output_lock(config.bag):
        pass


def test_a_domain_with_a_participant_is_not_free():
    with free_domain("/another") as domain:
        pass
    stranger = Bystander(domain, wait=False)
    try:
        with free_domain("/another") as other:
            assert other != domain
    finally:
        stranger.close()


def test_a_domain_whose_first_participant_has_ended_is_not_free():
    """As after a run whose plant was killed: its other nodes may still be there."""
    with free_domain("/another") as domain:
        pass
    second = PORT_BASE + DOMAIN_GAIN * domain + FIRST_PARTICIPANT + PARTICIPANT_GAIN
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as left:
        left.bind(("", second))
        with free_domain("/another") as other:
            assert other != domain


HOLDING = """
import sys
from los_testbed.run.processes.domains import free_domain
sys.stdin.readline()
with free_domain("/telescope") as domain:
    print(domain, flush=True)
    sys.stdin.readline()
"""
"""Looks for a free domain when it is told to, and has it until it is told again."""


def test_processes_that_look_for_a_free_domain_at_the_same_moment_get_two():
    command = [sys.executable, "-c", HOLDING]
    started = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    for process in started:
        process.stdin.write("look\n")
        process.stdin.flush()
    domains = [process.stdout.readline() for process in started]
    for process in started:
        process.communicate("end\n", timeout=600)
    assert [process.returncode for process in started] == [0, 0]
    assert "" not in domains and len(set(domains)) == 2, domains


@pytest.mark.parametrize("name", ["foo", "", "/foo/", "/foo//bar", "/9", "/a b"])
def test_a_namespace_is_an_absolute_name(name):
    with pytest.raises(ValueError, match="namespace must be an absolute ROS name such as /telescope, got"):
        RunConfig(namespace=name)
