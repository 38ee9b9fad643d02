"""Bags: readers that others wrote find what was put in; traces of ticks; the small bag of the repository."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.check import check_bag
from los_testbed.bags.trace import MISSED, events, write_trace
from los_testbed.bags.writer import BagWriter
from los_testbed.config.topics import PMA_COMMAND, TOPICS, TRUTH_LOS
from los_testbed.run import replay
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pointing_analysis.read.mcap.bag_metadata import has_right_hash
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import compare
from titop_plant.interface import TICK_NS

MS = 1_000_000


@pytest.fixture
def bag(tmp_path):
    rng = np.random.default_rng(1)
    stamps = 10**9 + MS * np.arange(300)
    sent = {topic.path: rng.standard_normal((300, topic.size)) for topic in TOPICS}
    with BagWriter(tmp_path / "a", {"los_testbed": {"seed": "1"}}, {"k.json": ("application/json", b"{}")}) as w:
        for first in range(0, 300, 100):
            for topic in TOPICS:
                part = slice(first, first + 100)
                messages = codec_for(topic).encode_many(stamps[part], sent[topic.path][part])
                w.write(topic.path, stamps[part] + 7, stamps[part], messages)
            w.end_chunk()
    return tmp_path / "a", stamps, sent


def _numbers(message):
    if hasattr(message, "effort"):
        return list(message.effort)
    if hasattr(message, "vector"):
        return [message.vector.x, message.vector.y]
    a = message.accel
    return [a.linear.x, a.linear.y, a.linear.z, a.angular.x, a.angular.y, a.angular.z]


def test_rosbags_reads_every_message_back(bag):
    path, stamps, sent = bag
    seen = dict.fromkeys(sent, 0)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == dict.fromkeys(sent, 300)
        last = 0
        for connection, time, raw in reader.messages():
            assert time >= last
            last = time
            message = reader.deserialize(raw, connection.msgtype)
            k = seen[connection.topic]
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert stamp == stamps[k] and time == stamps[k] + 7
            assert _numbers(message) == sent[connection.topic][k].tolist()
            seen[connection.topic] += 1
    assert set(seen.values()) == {300}


def test_the_mcap_reader_agrees_and_finds_checksums_index_metadata(bag):
    path, _, _ = bag
    with (path / "a_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 300 * len(TOPICS)
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 3
        assert all(c.compression == "zstd" for c in summary.chunk_indexes)
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        messages = list(reader.iter_messages(topics=[TRUTH_LOS.path]))
        assert [m.sequence for _, _, m in messages] == list(range(1, 301))
        assert reader.get_header().profile == "ros2"
        table = {m.name: m.metadata for m in reader.iter_metadata()}["los_testbed"]
        assert table["seed"] == "1" and has_right_hash(table)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("k.json", b"{}")]


def test_a_remapped_topic_has_the_name_that_it_was_sent_under_and_is_read_by_its_usual_one(tmp_path):
    stamps, angles = 10**9 + MS * np.arange(50), np.random.default_rng(2).standard_normal((50, 2))
    sent_as = {TRUTH_LOS.path: "/bench/autocollimator"}
    metadata = {"los_testbed": {"remapped": json.dumps(sent_as)}}
    with BagWriter(tmp_path / "a", metadata, topics=[TRUTH_LOS, PMA_COMMAND], sent_as=sent_as) as w:
        w.write("/bench/autocollimator", stamps, stamps, codec_for(TRUTH_LOS).encode_many(stamps, angles))
    with AnyReader([tmp_path / "a"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert {c.topic for c in reader.connections} == {"/bench/autocollimator", PMA_COMMAND.path}
    run = Run.open(tmp_path / "a")
    assert run.namespace == "/telescope" and run.topics == ("pma/command", "truth/los")
    assert run["truth/los"].values[:, :2].tolist() == angles.tolist()
    assert len(run.messages("truth/los")) == 50


REFERENCE = Path(__file__).parents[4] / "bags/reference"

FIRST = 1_000_000_000


def test_each_node_has_the_span_between_what_it_waits_for_and_what_it_sends(tmp_path: Path) -> None:
    """Samples 0.1 ms after the deadline, the estimate 0.2 ms later, commands 0.3 and 0.4 ms after that."""
    late = 5_000.0  # the clock of the messages is ahead; the quickest tick says how much
    times = np.array([0.1e6, 0.3e6, 0.6e6, 0.7e6])
    sent = {FIRST + k * TICK_NS: list(FIRST + k * TICK_NS + late + times) for k in range(3)}
    spans = [event for event in events(sent, FIRST) if event["ph"] == "X" and event["name"].endswith(" 2")]
    assert [event["tid"] for event in spans] == [0, 1, 2, 3, 4]
    begin = [2000.0, 2000.0, 2000.0, 2200.0, 2200.0]
    assert [event["ts"] for event in spans] == pytest.approx(begin)
    assert [event["dur"] for event in spans] == pytest.approx([1000.0, 0.0, 200.0, 300.0, 400.0])
    assert not any(event["name"] == MISSED for event in events(sent, FIRST))
    on_time = [0.0, 0.2e6, 0.3e6, 0.4e6]
    rows = (on_time, [0.0, 0.2e6, 0.3e6, 1.1e6], [0.0, 0.2e6, 0.3e6, np.nan], [np.nan] * 4, on_time)
    sent = {FIRST + k * TICK_NS: [FIRST + k * TICK_NS + time for time in row] for k, row in enumerate(rows)}
    assert [event["ts"] for event in events(sent, FIRST) if event["name"] == MISSED] == [2000.0, 3000.0, 4000.0]
    with pytest.raises(ValueError, match="must be of a run in real time"):
        write_trace(Run.open(REFERENCE), tmp_path / "trace.json")
    assert not list(tmp_path.iterdir())


BAG = Path(__file__).parents[4] / "bags" / "reference"


def test_it_is_small_and_whole() -> None:
    stored = [BAG / "metadata.yaml", *BAG.glob("*.mcap")]  # beside a report that somebody has made
    assert sum(file.stat().st_size for file in stored) <= 2_000_000
    run = Run.open(BAG)
    assert not run.problems
    assert "dirty" not in run.parameters["commit"], "recorded from a tree without changes"
    ticks = round(1000 * run.parameters["duration"])
    assert ticks >= 4000
    for topic in TOPICS:
        found = run[topic.name]
        assert len(found) == (ticks // 20 if topic.framed else ticks), topic.name
        assert found.integrity.missing == 0
    states = {row.name: row.state for row in check_bag(BAG).rows}
    assert states.pop("signature") == "none" and set(states.values()) == {"agrees"}, states


def test_its_controllers_give_its_commands_again() -> None:
    """To rounding: another processor may add up in another order."""
    run = Run.open(BAG)
    chosen = replay.controllers(run)
    assert chosen.as_recorded
    replayed = replay.drive(run, chosen, lambda done, total: None)
    for difference in compare(run, replayed).differences:
        scale = np.abs(run[difference.topic].values).max()
        assert difference.missing == 0
        assert difference.largest <= 1e-9 * scale


def test_a_bag_is_never_overwritten(bag):
    path, _, _ = bag
    before = zlib.crc32((path / "a_0.mcap").read_bytes())
    with pytest.raises(ValueError, match="exists already"):
        BagWriter(path, {})
    assert zlib.crc32((path / "a_0.mcap").read_bytes()) == before
