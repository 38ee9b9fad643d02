"""What a bag says of its messages, the end of its run and its checksums, against the messages that it holds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fuzz.record_mutations import places, put_together, taken_apart
from los_testbed.bags.check import BagCheck, BagCheckRow, check_bag
from mcap.writer import CompressionType, Writer
from support.forged_bags import cut_short, with_metadata

from pointing_analysis.read.mcap.records import OP_STATISTICS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

Call = Callable[..., tuple[int, str, str]]


def row_of(found: BagCheck, name: str) -> BagCheckRow:
    (row,) = [row for row in found.rows if row.name == name]
    return row


def with_summary(bag: Path, change: Callable[[bytes], bytes]) -> None:
    """Change the statistics in the summary of a bag, with the checksum made anew."""
    file = bag / "bag_0.mcap"
    found = taken_apart(file.read_bytes())
    (at,) = places(found, OP_STATISTICS)
    found[at] = (OP_STATISTICS, change(found[at][1]))
    file.write_bytes(put_together(found, True))


def with_yaml(bag: Path, **entries: Any) -> None:
    """Change entries of metadata.yaml."""
    file = bag / "metadata.yaml"
    content = yaml.safe_load(file.read_text())
    content["rosbag2_bagfile_information"].update(entries)
    file.write_text(yaml.safe_dump(content))


def test_a_whole_run_ends_by_its_plan(bag: Path) -> None:
    found = check_bag(bag)
    assert row_of(found, "end of the run") == BagCheckRow("end of the run", "agrees", "as planned, after 3000 ticks")
    assert found.code == 0 and Run.open(bag).covered_ticks == 3000
    assert row_of(found, "counts").found.endswith("topics, as in metadata.yaml, the summary and the run's record")


def test_messages_that_end_before_the_record_of_the_run_are_told(bag: Path, tmp_path: Path, call: Call) -> None:
    """The run is 3 s long and says so; the bag was made anew of its first two, and all its counts agree."""
    cut = cut_short(bag, tmp_path / "cut", 2.0)
    found = check_bag(cut)
    said = "the run's record says that it ended by its plan, after 3000 ticks, but the messages cover 2000 of them"
    assert row_of(found, "end of the run") == BagCheckRow("end of the run", "early", said)
    counts = row_of(found, "counts")
    assert counts.state == "contradicts" and counts.found.startswith("the run's record counts")
    assert found.code == 5 and not found.losses
    assert said in summarise(Run.open(cut)).problems
    code, out, _ = call("bag", "verify", str(cut))
    assert code == 5 and "by its plan, after 3000 ticks, but" in " ".join(out.split())


@pytest.mark.parametrize("entries", [{"duration": "long"}, {"statistics": "{}"}, {"rate_hz": "none"}])
def test_without_plan_or_ticks_nothing_is_said_to_have_gone_by_plan(bag: Path, entries: dict[str, str]) -> None:
    with_metadata(bag, **entries)
    row = row_of(check_bag(bag), "end of the run")
    assert row.state == "none" and "not known" in row.found


def test_messages_that_a_repair_left_out_are_no_contradiction(bag: Path, call: Call) -> None:
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 20_000] = bytes(20_000)
    file.write_bytes(data)
    assert call("bag", "repair", str(bag), "--output", "repaired")[0] in (0, 1)
    assert "contradicts" not in {row.state for row in check_bag(Path("repaired")).rows}


@pytest.mark.parametrize("more", [-1, 10**6])
def test_the_total_of_the_summary_must_be_that_of_the_messages(bag: Path, more: int) -> None:
    """That of each channel is right."""
    total = sum(check_bag(bag).messages.values())
    with_summary(bag, lambda body: struct.pack("<Q", total + more) + body[8:])
    found = check_bag(bag)
    said = f"the summary counts {total + more} messages in all, {total} can be read"
    assert row_of(found, "counts") == BagCheckRow("counts", "contradicts", said)
    assert found.code == 5 and f"counts: {said}" in found.contradictions


def test_the_total_alone_is_compared_where_no_topic_is_counted(bag: Path) -> None:
    """The table of channels is empty where a writer does not count them (MCAP specification, Statistics)."""
    with_summary(bag, lambda body: body[:42] + struct.pack("<I", 0))
    with_yaml(bag, topics_with_message_count=[])
    assert row_of(check_bag(bag), "counts").state == "agrees"
    with_yaml(bag, message_count=7)
    assert row_of(check_bag(bag), "counts").state == "contradicts"


MESSAGES = 3000

DEFINITION = b"std_msgs/Header header\ngeometry_msgs/Vector3 vector"


def written(file: Path, *, chunks: bool, checksums: bool, of_data: bool) -> Path:
    """A file with values on one topic, as the package mcap writes it."""
    with file.open("wb") as stream:
        writer = Writer(
            stream,
            compression=CompressionType.NONE,
            use_chunking=chunks,
            enable_crcs=checksums,
            enable_data_crcs=of_data,
        )
        writer.start("ros2", "test")
        schema = writer.register_schema("geometry_msgs/msg/Vector3Stamped", "ros2msg", DEFINITION)
        channel = writer.register_channel("/los", "cdr", schema)
        for k in range(MESSAGES):
            time = 10**9 + k * 10**6
            head = b"\0\1\0\0" + struct.pack("<iII", time // 10**9, time % 10**9, 1) + b"\0\0\0\0"
            writer.add_message(channel, time, head + struct.pack("<ddd", 1e-8 * k, 2e-8, 0.0), time, k + 1)
        writer.finish()
    return file


def damaged(file: Path) -> None:
    """Change a value in the middle of the file."""
    content = bytearray(file.read_bytes())
    at = content.index(struct.pack("<d", 1e-8 * (MESSAGES // 2)))
    content[at : at + 8] = struct.pack("<d", 5.0)
    file.write_bytes(content)


@pytest.mark.parametrize(
    ("chunks", "of_chunks", "of_data", "state", "after"),
    [
        (True, False, True, "agrees", "damaged"),
        (False, False, True, "agrees", "damaged"),
        (True, True, False, "agrees", "damaged"),
        (True, False, False, "none", "none"),
        (False, False, False, "none", "none"),
    ],
)
def test_the_checksums_that_are_there_are_compared(
    tmp_path: Path, chunks: bool, of_chunks: bool, of_data: bool, state: str, after: str
) -> None:
    """A file without any is not called whole."""
    file = written(tmp_path / "los.mcap", chunks=chunks, checksums=of_chunks, of_data=of_data)
    for change, expected in ((lambda _: None, state), (damaged, after)):
        change(file)
        found = check_bag(file)
        row = next(row for row in found.rows if row.name == "checksums")
        assert row.state == expected and (found.title == "whole") == (expected == "agrees")
        assert expected != "none" or "no checksum of any of the 3000 messages" in found.title
        assert expected != "damaged" or (found.code, found.title) == (1, "not whole")
    assert not of_data or row.found.endswith("the checksum of the data does not match")
