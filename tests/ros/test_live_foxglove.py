"""A run for Foxglove: a client of its protocol, by the schemas that the server sends, against the bag."""

import asyncio
import json
import os
import signal
import threading
from typing import Any

import pytest

pytest.importorskip("foxglove")
from foxglove_client import FoxgloveClient, FoxgloveSession
from los_testbed.bags.cdr import stamp_of
from los_testbed.live.foxglove_controls import NO_TOKEN
from los_testbed.run.processes.viewers import Live
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic
from ros_runs import PLANT, config_for
from support.unjudged import judged

TICKS = 700
WAIT_S = 60.0


def bag_messages(bag):
    """Bytes of every message, by topic and stamp."""
    found: dict[str, Any] = {}
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, {})[stamp_of(message.data)] = message.data
    return found


def test_a_foxglove_client_decodes_ten_channels_by_their_schemas_with_the_bytes_of_the_bag(tmp_path):
    """In simulated time, with a client that subscribes before the run begins."""
    clients: list[FoxgloveClient] = []
    config = config_for(tmp_path, mode="lockstep", duration=TICKS / 1000, camera_rate=1000.0)
    live = Live(port=0, tell=lambda foxglove, page: clients.append(FoxgloveClient(foxglove)))
    results = Runner(config, commands={"plant": PLANT}, live=live).run()
    (client,) = clients
    client.join()
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


def test_a_viewer_with_the_token_changes_a_run_and_ends_it(tmp_path):
    """The bag names the changes; the values that are told are those of the reports."""
    found, threads, errors, running = {}, [], [], threading.Event()
    noise, stage = "/telescope/plant.noise", "/telescope/controller.loop"

    async def act(address, token):
        async with FoxgloveSession(address) as viewer:
            await viewer.subscribe(noise, stage)
            assert running.wait(WAIT_S)
            found["refused"] = await viewer.call("/telescope/plant/stop")
            await viewer.set({"token": token})
            found["off"] = await viewer.call("/telescope/controller/deactivate")
            found["again"] = await viewer.call("/telescope/controller/deactivate")
            found["set"] = await viewer.set({noise: False, stage: "fsm"})
            found["out of range"] = await viewer.set({"/telescope/plant.camera_dropout": 2.0})
            found["told"] = viewer.told
            while await viewer.parameters(noise, stage) != found["set"]:  # reports come once a second
                await asyncio.sleep(0.1)
            found["stop"] = await viewer.call("/telescope/plant/stop")

    def use(address, token):
        try:
            asyncio.run(asyncio.wait_for(act(address, token), WAIT_S))
        except BaseException as error:
            errors.append(error)

    def tell(foxglove, page):
        threads.append(threading.Thread(target=use, args=(foxglove, page.partition("#token=")[2])))
        threads[0].start()

    def progress(ticks):
        running.set() if ticks >= 100 else None
        if errors:
            raise KeyboardInterrupt from errors[0]

    config = config_for(tmp_path, mode="lockstep", duration=3600.0)
    results = Runner(config, progress, commands={"plant": PLANT}, live=Live(port=0, tell=tell)).run()
    threads[0].join()
    assert not errors, errors
    assert found["refused"] == {"success": False, "message": NO_TOKEN}
    assert found["off"]["success"] and found["stop"] == {"success": True, "message": ""}
    assert not found["again"]["success"]
    assert found["set"] == {noise: False, stage: "fsm"}
    assert found["out of range"] == {"/telescope/plant.camera_dropout": 0.0}
    assert any("camera_dropout must be" in text for text in found["told"])
    changes = {node: json.loads(results.statistics[node]["changes"]) for node in ("plant", "controller")}
    assert {"noise", "stop"} == {change["name"] for change in changes["plant"]}
    assert {("loop", "fsm"), ("active", False)} == {(c["name"], c["value"]) for c in changes["controller"]}


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
