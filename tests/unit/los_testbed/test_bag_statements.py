"""What a bag says of its messages, against the messages that it holds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fuzz.record_mutations import put_together, taken_apart
from los_testbed.bags.check import BagCheck, Row, check_bag
from support.forged_bags import places

from pointing_analysis.read.mcap.records import OP_STATISTICS


def row_of(found: BagCheck, name: str) -> Row:
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


@pytest.mark.parametrize("more", [-1, 1, 10**6])
def test_the_total_of_the_summary_must_be_that_of_the_messages(bag: Path, more: int) -> None:
    """That of each channel is right."""
    total = sum(check_bag(bag).messages.values())
    with_summary(bag, lambda body: struct.pack("<Q", total + more) + body[8:])
    found = check_bag(bag)
    said = f"the summary counts {total + more} messages in all, {total} can be read"
    assert row_of(found, "counts") == Row("counts", "contradicts", said)
    assert found.code == 5 and f"counts: {said}" in found.contradictions


@pytest.mark.parametrize("more", [-1, 1, 10**6])
def test_the_total_of_metadata_yaml_must_be_that_of_the_messages(bag: Path, more: int) -> None:
    total = sum(check_bag(bag).messages.values())
    with_yaml(bag, message_count=total + more)
    found = check_bag(bag)
    said = f"metadata.yaml counts {total + more} messages in all, {total} can be read"
    assert row_of(found, "counts") == Row("counts", "contradicts", said)
    assert found.code == 5 and f"counts: {said}" in found.contradictions


def test_the_total_alone_is_compared_where_no_topic_is_counted(bag: Path) -> None:
    """The table of channels is empty where a writer does not count them (MCAP specification, Statistics)."""
    with_summary(bag, lambda body: body[:42] + struct.pack("<I", 0))
    with_yaml(bag, topics_with_message_count=[])
    assert row_of(check_bag(bag), "counts").state == "agrees"
    with_yaml(bag, message_count=7)
    assert row_of(check_bag(bag), "counts").state == "contradicts"
