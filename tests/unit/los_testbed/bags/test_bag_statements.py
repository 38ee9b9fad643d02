"""What a bag says of its messages and of the end of its run, against the messages that it holds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fuzz.record_mutations import places, put_together, taken_apart
from los_testbed.bags.check import BagCheck, BagCheckRow, check_bag
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
    assert row_of(found, "counts").found.endswith("topics, as in metadata.yaml and the summary")


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
