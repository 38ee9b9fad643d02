"""Damaged bags: what is whole is saved, what is not is named with its place."""

import shutil

import numpy as np
import pytest
import yaml
from los_testbed.bags.check import check_bag
from los_testbed.bags.describe import describe_bag
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.run import Run


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    config = RunConfig(duration=4.0, mode="inprocess", **write_controllers(folder))
    run_in_process(config, folder / "bag", SimpleTelescope())
    return folder / "bag"


@pytest.fixture
def bag(recorded, tmp_path):
    """A copy for each test, which damages it."""
    return shutil.copytree(recorded, tmp_path / "bag")


def contents(bag):
    run = Run.open(bag)
    return {name: run[name].values.tobytes() for name in run.topics}


def chunks(bag):
    with next(bag.glob("*.mcap")).open("rb") as stream:
        return make_reader(stream).get_summary().chunk_indexes


def test_an_intact_bag_is_copied_message_by_message(bag, tmp_path):
    result = repair_bag(bag, tmp_path / "new")
    assert (result.messages, result.losses, result.damage, result.finished) == (32_200, (), (), True)
    assert result.sentences() == ["nothing is lost"]
    old, new = Run.open(bag), Run.open(tmp_path / "new")
    for name in old.topics:
        assert np.array_equal(old[name].values, new[name].values, equal_nan=True)
        assert np.array_equal(old[name].stamp, new[name].stamp)
    assert dict(old.parameters) == dict(new.parameters)
    assert dict(old.attachments) == dict(new.attachments)


@pytest.mark.parametrize("part", [0.3, 0.999])
def test_a_bag_that_ends_within_a_chunk_keeps_all_chunks_before(bag, tmp_path, part):
    file = bag / "bag_0.mcap"
    cut = chunks(bag)[3]
    file.write_bytes(file.read_bytes()[: cut.chunk_start_offset + int(part * cut.chunk_length)])
    (bag / "metadata.yaml").unlink()
    described = describe_bag(bag)
    result = repair_bag(bag, tmp_path / "new")
    assert not result.finished and any("truncated" in text for text in result.sentences())
    lost = {loss.topic: loss.missing for loss in result.losses}
    assert sum(lost.values()) == 32_200 - result.messages, "the manifest before the chunk says what it held"
    with AnyReader([tmp_path / "new"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert (described["messages"], described["end_ns"]) == (sum(counts.values()), reader.end_time - 1)
        assert sum(1 for _ in reader.messages()) == result.messages
    assert counts["/telescope/truth/los"] == 4000 - lost.get("/telescope/truth/los", 0) >= 3000
    assert Run.open(tmp_path / "new").parameters["loop"] == "fsm+pma"


@pytest.mark.parametrize("places", [[6], [50], [-5, -2000]])
def test_damage_in_a_chunk_and_in_its_manifest_leaves_the_records_that_are_whole(bag, tmp_path, places):
    """A wrong bit of the manifest is undone; with two, what its checksums of records confirm is used."""
    file, hurt = bag / "bag_0.mcap", chunks(bag)[1]
    data = bytearray(file.read_bytes())
    begin = data.rfind(b"\x81", 0, hurt.chunk_start_offset)
    while begin + 9 + int.from_bytes(data[begin + 1 : begin + 9], "little") != hurt.chunk_start_offset:
        begin = data.rfind(b"\x81", 0, begin)
    for place in places:
        data[place + (begin + 9 if place >= 0 else hurt.chunk_start_offset)] ^= 4
    data[hurt.chunk_start_offset + hurt.chunk_length // 2] ^= 1
    file.write_bytes(data)
    result = repair_bag(bag, tmp_path / "new")
    assert 32_199 - len(places) <= result.messages <= 32_200
    assert sum(loss.missing for loss in result.losses) == 32_200 - result.messages
    assert begin in [place for place, _ in result.damage], "the manifest is named"
    old, new = Run.open(bag), Run.open(tmp_path / "new")
    assert all(np.array_equal(old[name].values, new[name].values, equal_nan=True) for name in old.topics)


def test_a_wrong_byte_in_a_chunk_is_put_right_by_its_manifest(bag):
    file = bag / "bag_0.mcap"
    good, hurt = file.read_bytes(), chunks(bag)[0]
    before = contents(bag)
    data = bytearray(good)
    data[hurt.chunk_start_offset + 9 + 28 + 8 + 8] ^= 4  # magic number of zstd
    file.write_bytes(data)
    assert contents(bag) == before


def test_log_times_beyond_the_signed_ones_are_kept(bag, tmp_path):
    (tmp_path / "odd").mkdir()
    times = [7, 2**63 + 5, 2**64 - 1]
    with (tmp_path / "odd" / "odd_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"uint8 structure_needs_at_least_one_member\n")
        channel = writer.register_channel("/odd", "cdr", schema)
        for number, stamp in enumerate(times):
            writer.add_message(channel, stamp, b"\0\1\0\0\0", stamp, number)
        writer.finish()
    result = repair_bag(tmp_path / "odd", tmp_path / "new")
    assert (result.messages, result.last_stamp) == (3, 2**64 - 1)
    with (tmp_path / "new" / "new_0.mcap").open("rb") as stream:
        assert [message.log_time for *_, message in make_reader(stream).iter_messages()] == times
    about = yaml.safe_load((tmp_path / "new" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about["duration"]["nanoseconds"] == 2**63 - 8


def test_a_repair_gives_no_digests_to_messages_that_had_none(bag, tmp_path):
    """Written anew by another program, where any value may have been changed: the digests of the repair made it whole,
    and its loop "proven"."""
    other = tmp_path / "other"
    other.mkdir()
    with next(bag.glob("*.mcap")).open("rb") as stream, (other / "other_0.mcap").open("wb") as target:
        reader, writer = make_reader(stream), Writer(target)
        writer.start()
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    repair_bag(bag, tmp_path / "again")
    repair_bag(other, tmp_path / "laundered")
    repair_bag(tmp_path / "laundered", tmp_path / "twice")
    digests = {name: Run.open(tmp_path / name).has_digests for name in ("bag", "again", "other", "laundered", "twice")}
    assert digests == {"bag": True, "again": True, "other": False, "laundered": False, "twice": False}
    assert "not all messages of the bag that was repaired had digests" in Run.open(tmp_path / "laundered").problems
    (row,) = [row for row in check_bag(tmp_path / "laundered").rows if row.name == "digests of chunks"]
    assert row.state == "none" and "a bag of which not all messages had digests" in row.found
