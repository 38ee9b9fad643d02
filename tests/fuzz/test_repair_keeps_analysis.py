"""Repair of a bag changes no figure of its analysis: whatever the damage, the repaired bag gives the same."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from fuzz import mutations, record_mutations
from fuzz.fuzz_profile import examples
from fuzz.mutations import MUTATIONS, Mutation
from fuzz.record_mutations import RECORD_MUTATIONS, Record, RecordMutation, put_together, taken_apart
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_DATA_END, BagError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise


@dataclass(frozen=True)
class Recorded:
    """A whole bag of three chunks, and the records of a shorter run of the same seed and of another one."""

    folder: Path
    data: bytes = field(repr=False)
    shorter: list[Record] = field(repr=False)
    foreign: list[Record] = field(repr=False)

    def with_content(self, data: bytes) -> Path:
        """The bag with another content of its file."""
        shutil.rmtree(self.folder / "new", ignore_errors=True)
        target = self.folder / "changed"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(self.folder / "bag", target)
        (target / "bag_0.mcap").write_bytes(data)
        return target


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("analysis")
    controllers = write_controllers(folder)
    data = []
    for name, duration, seed in (("bag", 2.2, 1), ("short", 1.5, 1), ("other", 1.5, 2)):
        config = RunConfig(duration=duration, mode="inprocess", **controllers)
        run_in_process(config, folder / name, SimpleTelescope(seed=seed))
        data.append((folder / name / f"{name}_0.mcap").read_bytes())
    return Recorded(folder, data[0], taken_apart(data[1]), taken_apart(data[2]))


def figures(bag: Path) -> str:
    """What an analysis says of a bag, to the last digit; the reason if it refuses it."""
    try:
        s = summarise(Run.open(bag))
    except BagError as error:
        return str(error).replace(str(bag), "")
    performance = (s.ape_max, s.ape_p997, s.rpe_rms, s.rpe_p997, s.rpe_windows_p997, s.rpe_axis, s.knowledge)
    data = (s.ticks, s.windows, s.windows_skipped, s.samples_lost, s.lost_by_topic, s.camera_dropped, s.open_end)
    return repr((performance, data, s.verdicts))


def check(recorded: Recorded, data: bytes) -> None:
    bag, new = recorded.with_content(data), recorded.folder / "new"
    before = figures(bag)
    try:
        repair_bag(bag, new)
    except BagError:
        assert not before.startswith("("), "a bag that can be analysed can be repaired"
        return
    after = figures(new)
    # Messages whose definition was altered are taken by the table of topics in repair, and left out before it.
    assert after == before or untyped(bag)


def untyped(bag: Path) -> bool:
    """Whether there are messages of a topic of the testbed whose type the file does not tell."""
    reading = BagPass(bag, bag_files(bag))
    found = (channel for info, block in reading.blocks() for channel, _ in block.by_channel(info.channels))
    return any(not channel.schema for channel in found)


@pytest.mark.parametrize("kind", sorted(mutations.KINDS))
@given(changes=st.lists(MUTATIONS, min_size=1, max_size=2))
@examples(2)
def test_damage(recorded: Recorded, kind: str, changes: list[Mutation]) -> None:
    data = recorded.data
    for change in (replace(changes[0], kind=kind), *changes[1:]):
        data = change(data)
    check(recorded, data)


@pytest.mark.parametrize("kind", sorted(record_mutations.KINDS))
@given(changes=st.lists(RECORD_MUTATIONS, min_size=1, max_size=2), trusted=st.booleans())
@examples(2)
def test_records_that_agree_with_their_checksums(
    recorded: Recorded, kind: str, changes: list[RecordMutation], trusted: bool
) -> None:
    found = taken_apart(recorded.data)
    for change in (replace(changes[0], kind=kind), *changes[1:]):
        found = change(found, recorded.foreign)
    check(recorded, put_together(found, trusted))


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("trusted", [True, False])
def test_a_chunk_that_stands_twice(recorded: Recorded, number: int, trusted: bool) -> None:
    """No message counts twice, and the analysis is that of the bag without the copy."""
    found = taken_apart(recorded.data)
    chunks = [at for at, (op, _) in enumerate(found) if op == OP_CHUNK]
    found.insert(chunks[-1] + 1, found[chunks[number]])
    check(recorded, put_together(found, trusted))
    assert figures(recorded.folder / "new") == figures(recorded.folder / "bag")
    assert any("is in the file twice" in problem for problem in Run.open(recorded.folder / "new").problems)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_chunk_that_is_gone(recorded: Recorded, number: int) -> None:
    """What is lost stands at the same times, also where the first message of the new bag is a later one."""
    found = taken_apart(recorded.data)
    del found[[at for at, (op, _) in enumerate(found) if op == OP_CHUNK][number]]
    check(recorded, put_together(found, True))
    before, after = (Run.open(recorded.folder / name) for name in ("changed", "new"))
    assert before.losses and [str(loss) for loss in after.losses] == [str(loss) for loss in before.losses]


@pytest.mark.parametrize("same", [True, False])
def test_messages_that_stand_twice_in_other_chunks(recorded: Recorded, same: bool) -> None:
    """The same ones, or others under the same numbers."""
    found = taken_apart(recorded.data)
    end = next(at for at, (op, _) in enumerate(found) if op == OP_DATA_END)
    foreign = recorded.shorter if same else recorded.foreign
    chunks = [at for at, (op, _) in enumerate(foreign) if op == OP_CHUNK]
    found[end:end] = foreign[chunks[1] - 1 : chunks[1] + 1]
    check(recorded, put_together(found, True))
    assert not Run.open(recorded.folder / "new").losses


def test_a_message_index_with_the_largest_offset(recorded: Recorded) -> None:
    """Its sum with the length of a head is beyond 64 bit."""
    found = taken_apart(recorded.data)
    found = RecordMutation("index", 0, 1, 2**63 - 1, "", b"x")(found, recorded.foreign)
    check(recorded, put_together(found, True))
    assert figures(recorded.folder / "new") == figures(recorded.folder / "bag")


def test_messages_of_another_type_are_left_out(recorded: Recorded) -> None:
    """The first chunk names another type for the accelerations, its checksum agrees, its manifest is gone."""
    found = taken_apart(recorded.data)
    altered = RecordMutation("forged_content", 0, 19, 15, "", b"geometry_msgs/msg/AccelStompid")
    at = altered(found, recorded.foreign)
    check(recorded, put_together(at, False))
