"""Bad links: lost, repeated, late and reordered messages between nodes; two hosts with a link that loses packets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import bad_link
import numpy as np
import pytest
from bad_link import DELAYED, LOST, SWAPPED, TWICE, fate
from los_testbed.run.processes.node_launch import node_command
from los_testbed.run.runner import Runner
from lossy_link import LOST_OUTWARD, LOST_RETURNING
from ros_runs import (
    PLANT,
    assert_gaps_are_counted,
    assert_plant_is_recorded,
    config_for,
    judged_at_pace,
    lost_samples,
    span_of,
)
from two_hosts import NotPermittedError, lossy_link, veth_pair

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent

MS = 1_000_000
TICKS, HOST_TICKS = 3000, 2500


def over_link(command, *names):
    remapped = [part for name in names for part in ("-r", f"{name}:=link/{name}")]
    return [*command, "--ros-args", *remapped]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run whose commands, and one of whose sensors, go over the bad link."""
    folder = tmp_path_factory.mktemp("bad_link")
    config = config_for(folder, duration=TICKS / 1000)
    names = ["fsm/command", "pma/command", "m1/accel"]
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    script = str(Path(bad_link.__file__))
    link = subprocess.Popen([sys.executable, script, str(config.domain), *names], env=variables)
    commands = {
        "plant": over_link(PLANT, "m1/accel"),
        "controller": over_link(node_command("controller"), "fsm/command", "pma/command"),
    }
    try:
        results = Runner(config, commands=commands).run()
    finally:
        link.terminate()
        link.wait(10)
    run = Run.open(results.bag)
    return results, run, span_of(run)


def among(stamps, *kinds):
    return sum(fate(int(stamp)) in kinds for stamp in stamps)


def test_the_plant_never_stops(recorded):
    results, run, stamps = recorded
    assert TICKS - 100 < len(stamps) <= TICKS == int(results.statistics["plant"]["ticks"])
    assert not results.failures
    assert run["fsm/command"].stamp[-1] >= stamps[-1] - 500 * MS, "the loop works until the end"


def test_the_link_is_as_bad_as_it_is_meant_to_be(recorded):
    """What the recorder got over the link: otherwise the tests below would prove nothing."""
    _, run, stamps = recorded
    received = set(run["m1/accel"].stamp.tolist())
    assert not any(int(stamp) in received for stamp in stamps if fate(int(stamp)) == LOST)
    assert len(received) + lost_samples(run, "m1/accel") == len(stamps)
    assert len(received) >= 0.1 * (TICKS - among(stamps, LOST))
    if judged_at_pace(run, "the share of samples that come over the link"):
        assert len(received) >= 0.8 * (TICKS - among(stamps, LOST))


def test_repeated_and_late_commands_are_counted_and_not_obeyed(recorded):
    """Every command that came twice or out of order; more can be late on a busy machine, and none can be missing.

    Where the loop does not keep pace, a newer command may be there before the copy of an older one: it counts as late.
    """
    results, run, stamps = recorded
    plant = results.statistics["plant"]
    at_pace = judged_at_pace(run, "that commands that come twice are counted as such")
    # a tick whose sensor was lost has no command at all: the link then has nothing to repeat or to delay
    sent = set(run["fsm/command"].stamp.tolist())
    for name in ("fsm", "pma"):
        twice = sum(fate(s) == TWICE for s in sent)
        old = sum(fate(s) in (DELAYED, SWAPPED) for s in sent)
        duplicate, late = (int(plant.get(f"rejected_{name}_{reason}", 0)) for reason in ("duplicate", "late"))
        assert duplicate <= twice + lost_samples(run, f"{name}/command")
        assert duplicate > 0 or not at_pace
        assert duplicate + late >= twice + old
    assert int(plant["missed_ticks"]) >= among(stamps, LOST)


def test_the_estimator_steps_over_what_is_missing_and_goes_on(recorded):
    results, run, stamps = recorded
    estimates = run["los_estimate"]
    assert_gaps_are_counted(run, "los_estimate", "estimator")
    assert_gaps_are_counted(run, "fsm/command", "controller")
    assert not among(estimates.stamp, LOST)
    # a delayed sample is late when a newer tick is already complete; a busy machine may still take it in time
    made = set(estimates.stamp.tolist())
    too_late = [s for s in stamps[:-10] if fate(int(s)) in (DELAYED, SWAPPED) and int(s) not in made]
    unknown = lost_samples(run, "los_estimate")  # estimated, perhaps, and not in the bag
    assert len(too_late) <= int(results.statistics["estimator"]["rejected_late"]) + unknown
    if judged_at_pace(run, "that samples come too late"):
        assert too_late
    assert np.isfinite(estimates.values).all()
    assert np.all(np.diff(estimates.stamp) >= MS), "in order, none twice"


def test_the_mirror_never_goes_back_to_an_older_command(recorded):
    """Each angle of the strain gauge (noise 1e-8 rad) is looked up among the commands of the last 40 ticks.

    Where the loop does not keep pace, few commands are obeyed, perhaps none: what can be compared, must agree. A mirror
    that fades to zero passes the angles of some commands by chance, but not of one at each of nine ticks.
    """
    _, run, _ = recorded
    gauge, command = run["fsm/strain_gauge"], run["fsm/command"]
    angle, stamps = gauge.values[:, 0], gauge.stamp
    if judged_at_pace(run, "that the mirror moves"):
        assert np.abs(angle).max() > 5e-5, "the loop works"
    steepest = np.abs(np.diff(command.values[600:, 0]) / np.diff(command.stamp[600:])).max()
    slope = np.abs(np.gradient(command.values[:, 0], command.stamp))
    obeyed = np.full(len(stamps), -1)
    for k in range(600, len(stamps)):
        first, end = np.searchsorted(command.stamp, [stamps[k] - 40 * MS, stamps[k]])
        if end - first < 5 or slope[first:end].min() < 0.3 * steepest:  # near its turning points an angle comes twice
            continue
        nearest = first + int(np.argmin(np.abs(command.values[first:end, 0] - angle[k])))
        if abs(command.values[nearest, 0] - angle[k]) < 6e-8:
            obeyed[k] = nearest
    sure = np.flatnonzero(np.convolve(obeyed >= 0, np.ones(9), "same") == 9)
    follows = sure[1:][np.diff(stamps[sure]) == MS]
    assert np.all(obeyed[follows] >= obeyed[follows - 1])
    if judged_at_pace(run, "that commands are obeyed at once"):
        assert len(follows) > 20


@pytest.fixture(scope="module", params=[pytest.param(veth_pair, marks=pytest.mark.slow), lossy_link])
def over_hosts(request, tmp_path_factory):
    """A run over two hosts: the hosts with the link's account, and the bag."""
    folder = tmp_path_factory.mktemp(request.param.__name__)
    try:
        with request.param() as hosts:
            hosts.run(config_for(folder, duration=HOST_TICKS / 1000), folder, PLANT)
            hosts.unplug()
    except NotPermittedError as error:
        pytest.skip(f"network namespaces are not permitted: {error}")
    return hosts, Run.open(folder / "bag")


def scheduled(run, tick):
    """Stamps of the run whose tick is `tick` modulo 100."""
    return [int(stamp) for stamp in span_of(run) if stamp // MS % 100 == tick]


def test_nothing_is_lost_on_the_plant_s_own_host(over_hosts):
    assert_plant_is_recorded(over_hosts[1], HOST_TICKS)


@pytest.mark.parametrize("over_hosts", [lossy_link], indirect=True)
def test_the_link_loses_what_the_schedule_says(over_hosts):
    hosts, run = over_hosts
    outward = scheduled(run, LOST_OUTWARD)
    assert set(hosts.lost_outward) <= set(outward)
    assert len(outward) - len(hosts.lost_outward) <= unsent(run, "truth/los"), "but for ticks without samples"
    assert set(hosts.lost_returning) <= set(scheduled(run, LOST_RETURNING))
    assert hosts.lost >= 5 * len(hosts.lost_outward), "every sensor of these ticks"
    assert float(run.parameters["statistics"]["plant"]["latency_median_us"]) >= 400, "twice 0.2 ms"


@pytest.mark.parametrize("over_hosts", [lossy_link], indirect=True)
def test_a_lost_sample_costs_its_own_tick(over_hosts):
    """No estimate of a lost tick, an estimate of its successor: no other tick waits until it was sent again."""
    hosts, run = over_hosts
    estimates = set(run["los_estimate"].stamp.tolist())
    assert not estimates & set(hosts.lost_outward)
    followed = sum(stamp + MS in estimates for stamp in hosts.lost_outward)
    assert followed >= len(hosts.lost_outward) / 4, "a busy machine may cost some of the successors"


@pytest.mark.parametrize(("node", "topic"), [("estimator", "los_estimate"), ("controller", "fsm/command")])
def test_what_a_node_counts_as_missing_is_missing(over_hosts, node, topic):
    """By the node that stepped over it and by the recorder."""
    _, run = over_hosts
    assert_gaps_are_counted(run, topic, node)
    assert np.isfinite(run[topic].values).all()


@pytest.mark.parametrize("over_hosts", [lossy_link], indirect=True)
def test_the_plant_counts_the_commands_it_missed(over_hosts):
    hosts, run = over_hosts
    commanded = set(run["fsm/command"].stamp.tolist())
    lost = set(hosts.lost_outward) | set(hosts.lost_returning)
    assert int(run.parameters["statistics"]["plant"]["missed_ticks"]) >= len(lost)
    assert commanded & set(hosts.lost_returning), "sent again to the recorder, if it has a processor in time"
