"""A run for Foxglove: a client of its protocol, by the schemas that the server sends, against the bag."""

import os
import signal
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")
from foxglove_client import FoxgloveClient
from los_testbed.bags.cdr import stamp_of
from los_testbed.run.processes.viewers import Live
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic
from ros_runs import PLANT, config_for
from support.unjudged import judged

from titop_plant.interface import TICK_NS

pytestmark = pytest.mark.ros
TICKS = 700


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A run in simulated time with a client that subscribes before it begins."""
    folder, clients = tmp_path_factory.mktemp("live"), []
    config = config_for(folder, mode="lockstep", duration=TICKS / 1000, camera_rate=1000.0)
    live = Live(port=0, tell=lambda foxglove, page: clients.append(FoxgloveClient(foxglove)))
    runner = Runner(config, commands={"plant": PLANT}, live=live)
    results = runner.run()
    clients[0].join()
    return clients[0], results, runner._seen["live", "done"]["statistics"]


def bag_messages(bag):
    """Bytes of every message, by topic and stamp."""
    found: dict[str, Any] = {}
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, {})[stamp_of(message.data)] = message.data
    return found


def test_a_foxglove_client_decodes_ten_channels_by_their_schemas_with_the_bytes_of_the_bag(watched):
    client, results, _ = watched
    assert len(client.channels) == 10
    # a run of half a second may be over before the server has heard of a topic
    assert sum(bool(client.messages[topic]) for topic in client.channels) >= 8
    recorded = bag_messages(results.bag)
    for topic, channel in client.channels.items():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        decode = generate_dynamic(channel["schemaName"], channel["schema"])[channel["schemaName"]]
        payloads = [payload for _, payload in client.messages[topic]]
        for payload in payloads[:: max(1, len(payloads) // 200)]:
            header = decode(payload).header
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp_of(payload)
        if topic != "/diagnostics":
            judged(bool(payloads), f"the channel {topic}", "samples were lost")
            assert all(recorded[topic][stamp_of(payload)] == payload for payload in payloads), topic


def test_nine_of_the_channels_have_a_kilohertz_but_for_what_the_server_did_not_get(watched):
    """Counted by stamps, since the machine may be slow; the server counts the samples that it was too late for."""
    client, _, lost = watched
    channels = [topic for topic in client.channels if topic != "/diagnostics"]
    assert len(channels) == 9
    for topic in channels:
        if not judged(bool(client.messages[topic]), f"the rate of {topic}", "samples were lost"):
            continue
        stamps = np.array([stamp_of(payload) for _, payload in client.messages[topic]])
        span = (stamps.max() - stamps.min()) // TICK_NS + 1
        assert len(stamps) == len(set(stamps.tolist())) and np.all(stamps % TICK_NS == 0), topic
        assert abs(len(stamps) + int(lost[f"lost_{topic}"]) - span) <= 0.01 * span, topic


def test_a_run_goes_on_when_its_server_for_viewers_dies(tmp_path):
    config = config_for(tmp_path, mode="lockstep", duration=0.6)

    def progress(ticks):
        if ticks >= 300 and not killed:
            killed.append(runner.processes["live"])
            os.kill(killed[0], signal.SIGKILL)

    killed: list[Any] = []
    runner = Runner(config, progress, commands={"plant": PLANT}, live=Live(port=0))
    results = runner.run()
    assert killed and results.statistics["plant"]["ticks"] == "600"
    assert not results.failures
    assert results.warnings[-1] == "the server for viewers ended unexpectedly: code -9"


@pytest.mark.slow
def test_a_viewer_gets_only_the_topics_that_the_run_names(tmp_path):
    clients = []
    live = Live(port=0, tell=lambda foxglove, page: clients.append(FoxgloveClient(foxglove)), topics=("truth/los",))
    config = config_for(tmp_path, mode="lockstep", duration=0.3)
    Runner(config, commands={"plant": PLANT}, live=live).run()
    clients[0].join()
    assert set(clients[0].channels) == {"/telescope/truth/los"}
    assert clients[0].messages["/telescope/truth/los"]
