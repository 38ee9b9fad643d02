"""Damaged bags: what is whole is saved, what is not is named with its place."""

import numpy as np
import pytest
from los_testbed.bags.repair import repair_bag
from los_testbed.config import RunConfig
from los_testbed.loop.simulate import run_in_process
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read import Run


@pytest.fixture
def bag(tmp_path):
    config = RunConfig(duration=4.0, mode="inprocess", **write_controllers(tmp_path))
    run_in_process(config, tmp_path / "bag", SimpleTelescope())
    return tmp_path / "bag"


def chunks(bag):
    with next(bag.glob("*.mcap")).open("rb") as stream:
        return make_reader(stream).get_summary().chunk_indexes


def test_an_intact_bag_is_copied_message_by_message(bag, tmp_path):
    result = repair_bag(bag, tmp_path / "new")
    assert (result.messages, result.chunks, result.damaged, result.cut_at) == (32_200, 4, [], None)
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
    result = repair_bag(bag, tmp_path / "new")
    assert result.chunks == 3
    assert result.cut_at == cut.chunk_start_offset
    with AnyReader([tmp_path / "new"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert sum(1 for _ in reader.messages()) == result.messages
    assert counts["/telescope/truth/los"] == 3000
    assert Run.open(tmp_path / "new").parameters["loop"] == "fsm+pma"


def test_a_damaged_chunk_is_reported_with_its_offset_and_the_others_are_copied(bag, tmp_path):
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    hurt = chunks(bag)[1]
    data[hurt.chunk_start_offset + hurt.chunk_length // 2] ^= 0x10
    file.write_bytes(data)
    result = repair_bag(bag, tmp_path / "new")
    assert [offset for offset, _ in result.damaged] == [hurt.chunk_start_offset]
    truth = Run.open(tmp_path / "new")["truth/los"]
    assert len(truth) == 3000
    assert truth.integrity.missing == 1000
    assert truth.integrity.gaps == ((0.999, 1000),)


def test_what_is_no_bag_is_refused(tmp_path, bag):
    (tmp_path / "text").write_text("no bag")
    for source in (tmp_path / "nothing", tmp_path / "text"):
        with pytest.raises(ValueError):
            repair_bag(source, tmp_path / "new")
        assert not (tmp_path / "new").exists()
    with pytest.raises(ValueError, match="exists already"):
        repair_bag(bag, bag)


def test_a_reader_names_the_place_of_a_damaged_chunk_and_reads_the_others(bag):
    file = bag / "bag_0.mcap"
    hurt = chunks(bag)[2]
    data = bytearray(file.read_bytes())
    data[hurt.chunk_start_offset + hurt.chunk_length // 2] ^= 0x10
    file.write_bytes(data)
    run = Run.open(bag)
    assert any(f"byte {hurt.chunk_start_offset}:" in problem for problem in run.problems), run.problems
    assert len(run["truth/los"]) == 3000
