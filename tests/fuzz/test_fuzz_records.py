"""Bags of a mistaken or hostile writer: no error but `BagError`, nothing nobody recorded where checksums can tell."""

from __future__ import annotations

import shutil
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest
from fuzz.fuzz_profile import examples
from fuzz.mutations import Content, Key, messages, others_get
from fuzz.record_mutations import FORGERIES, RECORD_MUTATIONS, Record, RecordMutation, put_together, taken_apart
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap.records import (
    OP_ATTACHMENT_INDEX,
    OP_CHANNEL,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_METADATA_INDEX,
    BagError,
)
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

LIMIT_S = 20.0


@dataclass(frozen=True)
class Bags:
    """A whole bag, its records and messages, and the records of another one."""

    folder: Path
    found: list[Record]
    foreign: list[Record]
    content: dict[Key, Content]

    def __repr__(self) -> str:
        return "Bags(...)"


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Bags:
    folder = tmp_path_factory.mktemp("records")
    controllers = write_controllers(folder)
    data = []
    for name, duration in (("bag", 1.5), ("other", 2.2)):
        config = RunConfig(duration=duration, mode="inprocess", **controllers)
        run_in_process(config, folder / name, SimpleTelescope())
        data.append((folder / name / f"{name}_0.mcap").read_bytes())
    return Bags(folder, taken_apart(data[0]), taken_apart(data[1]), messages(data[0]))


def changed(bags: Bags, changes: list[RecordMutation], trusted: bool) -> Path:
    found = bags.found
    for change in changes:
        found = change(found, bags.foreign)
    target = bags.folder / "changed"
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(bags.folder / "bag", target)
    (target / "bag_0.mcap").write_bytes(put_together(found, trusted))
    return target


@given(changes=st.lists(RECORD_MUTATIONS, min_size=1, max_size=3), trusted=st.booleans())
@examples(8)
def test_records_that_agree_with_their_checksums(bags: Bags, changes: list[RecordMutation], trusted: bool) -> None:
    bag, new = changed(bags, changes, trusted), bags.folder / "new"
    shutil.rmtree(new, ignore_errors=True)
    start_time = time.process_time()
    try:
        result = repair_bag(bag, new)
    except BagError:
        result = None
        assert not new.exists()
    try:
        run = Run.open(bag)
        summarise(run)
        assert result is None or run.losses == result.losses
    except BagError:
        pass
    assert time.process_time() - start_time < LIMIT_S
    assert not any(path.name.startswith(".") for path in bags.folder.iterdir())
    found = messages((new / "new_0.mcap").read_bytes()) if result is not None else {}
    if any(change.kind in FORGERIES for change in changes):
        return
    assert all(bags.content[key] == content for key, content in found.items())
    assert len(found) >= others_get((bag / "bag_0.mcap").read_bytes(), bags.content)
    if result is not None:
        missing = Counter(topic for topic, _ in bags.content.keys() - found.keys())
        assert {loss.topic: loss.missing for loss in result.losses} == missing


@pytest.mark.parametrize("kind", [OP_CHUNK_INDEX, OP_ATTACHMENT_INDEX, OP_METADATA_INDEX])
def test_a_summary_with_records_shorter_than_their_head_is_not_believed(bags: Bags, kind: int) -> None:
    found, new = list(bags.found), bags.folder / "new"
    at = next(i for i, (op, _) in enumerate(found) if op == kind)
    length = 24 if kind == OP_CHUNK_INDEX else 8
    found[at] = (kind, found[at][1][:length] + (1).to_bytes(8, "little") + found[at][1][length + 8 :])
    bag = changed(bags, [], trusted=True)
    (bag / "bag_0.mcap").write_bytes(put_together(found, True))
    shutil.rmtree(new, ignore_errors=True)
    assert repair_bag(bag, new).messages == len(bags.content)


def test_topics_of_lost_channels_are_those_of_metadata_yaml(bags: Bags) -> None:
    """No chunk and no channel is left, and the statistics count by the numbers of channels."""
    left = [record for record in bags.found if record[0] not in (OP_CHUNK, OP_CHANNEL)]
    bag, new = changed(bags, [], trusted=True), bags.folder / "new"
    (bag / "bag_0.mcap").write_bytes(put_together(left, True))
    shutil.rmtree(new, ignore_errors=True)
    with pytest.raises(BagError, match=f"got none of the {len(bags.content)} recorded"):
        repair_bag(bag, new)
    assert not new.exists()
