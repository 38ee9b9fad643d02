"""Plant and recorder on one host, estimator and controller on another: two network namespaces and a link."""

import numpy as np
import pytest
from lossy_link import LOST_OUTWARD, LOST_RETURNING
from ros_runs import PLANT, assert_gaps_are_counted, assert_plant_is_recorded, config_for, span_of
from two_hosts import NotPermittedError, lossy_link, veth_pair

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent

MS = 1_000_000
TICKS = 2500


@pytest.fixture(scope="module", params=[pytest.param(veth_pair, marks=pytest.mark.slow), lossy_link])
def recorded(request, tmp_path_factory):
    """A run over two hosts: the hosts with the link's account, and the bag."""
    folder = tmp_path_factory.mktemp(request.param.__name__)
    try:
        with request.param() as hosts:
            hosts.run(config_for(folder, duration=TICKS / 1000), folder, PLANT)
            hosts.unplug()
    except NotPermittedError as error:
        pytest.skip(f"network namespaces are not permitted: {error}")
    return hosts, Run.open(folder / "bag")


def scheduled(run, tick):
    """Stamps of the run whose tick is `tick` modulo 100."""
    return [int(stamp) for stamp in span_of(run) if stamp // MS % 100 == tick]


def test_nothing_is_lost_on_the_plant_s_own_host(recorded):
    assert_plant_is_recorded(recorded[1], TICKS)


@pytest.mark.parametrize("recorded", [lossy_link], indirect=True)
def test_the_link_loses_what_the_schedule_says(recorded):
    hosts, run = recorded
    outward = scheduled(run, LOST_OUTWARD)
    assert set(hosts.lost_outward) <= set(outward)
    assert len(outward) - len(hosts.lost_outward) <= unsent(run, "truth/los"), "but for ticks without samples"
    assert set(hosts.lost_returning) <= set(scheduled(run, LOST_RETURNING))
    assert hosts.lost >= 5 * len(hosts.lost_outward), "every sensor of these ticks"
    assert float(run.parameters["statistics"]["plant"]["latency_median_us"]) >= 400, "twice 0.2 ms"


@pytest.mark.parametrize("recorded", [lossy_link], indirect=True)
def test_a_lost_sample_costs_its_own_tick(recorded):
    """No estimate of a lost tick, an estimate of its successor: no other tick waits until it was sent again."""
    hosts, run = recorded
    estimates = set(run["los_estimate"].stamp.tolist())
    assert not estimates & set(hosts.lost_outward)
    followed = sum(stamp + MS in estimates for stamp in hosts.lost_outward)
    assert followed >= len(hosts.lost_outward) / 4, "a busy machine may cost some of the successors"


@pytest.mark.parametrize(("node", "topic"), [("estimator", "los_estimate"), ("controller", "fsm/command")])
def test_what_a_node_counts_as_missing_is_missing(recorded, node, topic):
    """By the node that stepped over it and by the recorder."""
    _, run = recorded
    assert_gaps_are_counted(run, topic, node)
    assert np.isfinite(run[topic].values).all()


@pytest.mark.parametrize("recorded", [lossy_link], indirect=True)
def test_the_plant_counts_the_commands_it_missed(recorded):
    hosts, run = recorded
    commanded = set(run["fsm/command"].stamp.tolist())
    lost = set(hosts.lost_outward) | set(hosts.lost_returning)
    assert int(run.parameters["statistics"]["plant"]["missed_ticks"]) >= len(lost)
    assert commanded & set(hosts.lost_returning), "sent again to the recorder, if it has a processor in time"
