"""Damaged bags, and bags of a mistaken or hostile writer.

A repair gives nothing but what was recorded, at least what other readers get, an exact report of the loss, and a bag
whose analysis is that of the damaged one. No verdict is better than that of the whole bag, and no error is another than
`BagError`. The oracle is the mcap package: its seeking and its streaming reader.
"""

from __future__ import annotations

import io
import resource
import shutil
import struct
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations, record_mutations
from fuzz.fuzz_profile import examples
from fuzz.mutations import (
    MUTATIONS,
    Content,
    Key,
    Mutation,
    messages,
    others_find,
    others_get,
    records,
    without_checksum,
)
from fuzz.record_mutations import (
    FORGERIES,
    RECORD_MUTATIONS,
    Record,
    RecordMutation,
    as_text,
    chunk_of,
    places,
    put_together,
    taken_apart,
)
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.repair import RepairResult, repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from mcap.reader import make_reader
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.records import (
    OP_ATTACHMENT_INDEX,
    OP_CHANNEL,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DATA_END,
    OP_MANIFEST,
    OP_METADATA_INDEX,
    BagError,
)
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import Summary, summarise
from pointing_analysis.requirements.verdict import parse

LIMIT_S, LIMIT_MB = 20.0, 1000.0
REQUIREMENTS = tuple(
    parse(text)
    for text in (
        "prob(|APE| < 10 arcsec) >= 0.5 at 60 % confidence",
        "prob(|RPE(20 ms)| < 400 mas) >= 0.7 at 60 % confidence",
        "prob(|RPE(20 ms)| < 1 mas) >= 0.9 at 90 % confidence",
    )
)
REFERENCE = Path(__file__).parents[2] / "bags" / "reference"


@dataclass(frozen=True)
class Recorded:
    """A whole bag of three chunks, what is in it, and the records of a shorter run of the same seed and of another."""

    folder: Path
    data: bytes
    content: dict[Key, Content]
    summary: Summary
    shorter: list[Record]
    foreign: list[Record]

    def __repr__(self) -> str:
        return "Recorded(...)"

    @property
    def new(self) -> Path:
        """Folder of the repaired bag."""
        return self.folder / "new"

    def with_content(self, data: bytes) -> Path:
        """The bag with another content of its file."""
        return changed(self.folder / "bag", self.folder, data)


def changed(good: Path, folder: Path, data: bytes) -> Path:
    """A bag with another content of its file in a folder without the repaired one."""
    target = folder / "changed"
    for old in (folder / "new", target):
        shutil.rmtree(old, ignore_errors=True)
    shutil.copytree(good, target)
    next(target.glob("*.mcap")).write_bytes(data)
    return target


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("recorded")
    controllers = write_controllers(folder)
    data = []
    for name, duration, seed in (("bag", 2.2, 1), ("short", 1.5, 1), ("other", 1.5, 2)):
        config = RunConfig(duration=duration, mode="inprocess", **controllers)
        run_in_process(config, folder / name, SimpleTelescope(seed=seed))
        data.append((folder / name / f"{name}_0.mcap").read_bytes())
    found = summarise(Run.open(folder / "bag"), requirements=REQUIREMENTS)
    return Recorded(folder, data[0], messages(data[0]), found, taken_apart(data[1]), taken_apart(data[2]))


def checked(recorded: Recorded, data: bytes, forged: bool = False) -> RepairResult | None:
    """Repair a bag and hold it against the laws; those of the content do not hold for what nobody recorded."""
    bag, start = recorded.with_content(data), time.process_time()
    others = others_get(data, recorded.content)
    ours = time.process_time()
    try:
        result = repair_bag(bag, recorded.new)
    except BagError:
        result = None
        assert not recorded.new.exists()
    assert time.process_time() - ours < LIMIT_S + (ours - start)
    assert not any(path.name.startswith(".") for path in recorded.folder.iterdir())
    check_analysis(recorded, bag, result, forged)
    if not forged:
        check_content(recorded, data, result, others)
    return result


def check_content(recorded: Recorded, data: bytes, result: RepairResult | None, others: int) -> None:
    """The repaired bag has what was recorded, as much as others get, and the loss that is told is what is missing."""
    found = messages((recorded.new / "new_0.mcap").read_bytes()) if result else {}
    assert all(recorded.content[key] == content for key, content in found.items())
    if len(found) < others:
        best = max(others_find(data, recorded.content), key=len)
        others -= without_checksum(data, recorded.data, best - found.keys())
    assert len(found) >= others
    if result:
        missing = Counter(topic for topic, _ in recorded.content.keys() - found.keys())
        said = {loss.topic: loss.missing for loss in result.losses}
        known = {*said, *(topic for topic, _ in found)}  # a topic of which nothing at all is left may be unknown
        assert said == {topic: count for topic, count in missing.items() if topic in known}


def figures(bag: Path) -> str:
    """What an analysis says of a bag, to the last digit; the reason if it refuses it."""
    try:
        s = summarise(Run.open(bag))
    except BagError as error:
        return str(error).replace(str(bag), "")
    quantiles = (s.ape_quantile, s.rpe_quantile, s.rpe_windows_quantile)
    performance = (s.ape_max, s.rpe_rms, quantiles, s.rpe_axis, s.knowledge)
    data = (s.ticks, s.windows, s.windows_skipped, s.samples_lost, s.lost_by_topic, s.camera_dropped, s.open_end)
    return repr((performance, data, s.verdicts))


def untyped(bag: Path) -> bool:
    """Whether there are messages of a topic of the testbed whose type the file does not tell."""
    reading = BagPass(bag, bag_files(bag))
    found = (channel for info, block in reading.blocks() for channel, _ in block.by_channel(info.channels))
    return any(not channel.schema for channel in found)


def check_analysis(recorded: Recorded, bag: Path, result: RepairResult | None, forged: bool) -> None:
    """Repair changes no figure; without a forgery no verdict is better than that of the whole bag."""
    before = figures(bag)
    if result is None:
        assert not before.startswith("("), "a bag that can be analysed can be repaired"
        return
    # Messages whose definition was altered are taken by the table of topics in repair, and left out before it.
    assert figures(recorded.new) == before or untyped(bag)
    try:
        run = Run.open(bag)
        found = summarise(run, requirements=REQUIREMENTS)
    except BagError:
        return
    assert run.losses == result.losses
    if forged:
        return
    for whole, left in zip(recorded.summary.verdicts, found.verdicts):
        assert left.status != "compliant" or whole.status == "compliant"
        assert whole.status != "compliant" or left.status != "not compliant"
    every = Run.open(recorded.folder / "bag")
    for name in run.topics:
        some, all_of_it = run[name], every[name]
        if not len(some):  # the message that tells how many values the arrays of this topic have is lost
            continue
        rows = np.searchsorted(all_of_it.stamp, some.stamp)
        assert np.array_equal(all_of_it.stamp[rows], some.stamp)
        assert np.array_equal(all_of_it.values[rows], some.values, equal_nan=True)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 < LIMIT_MB


@pytest.mark.further
@pytest.mark.parametrize("kind", sorted(mutations.KINDS))
@given(changes=st.lists(MUTATIONS, min_size=1, max_size=3))
@examples(2)
def test_damage(recorded: Recorded, kind: str, changes: list[Mutation]) -> None:
    data = recorded.data
    for change in (replace(changes[0], kind=kind), *changes[1:]):
        data = change(data)
    checked(recorded, data)


@pytest.mark.further
@pytest.mark.parametrize("kind", sorted(record_mutations.KINDS))
@given(changes=st.lists(RECORD_MUTATIONS, min_size=1, max_size=3), trusted=st.booleans())
@examples(2)
def test_records_that_agree_with_their_checksums(
    recorded: Recorded, kind: str, changes: list[RecordMutation], trusted: bool
) -> None:
    found = taken_apart(recorded.data)
    changes[0] = replace(changes[0], kind=kind)
    for change in changes:
        found = change(found, recorded.foreign)
    checked(recorded, put_together(found, trusted), any(change.kind in FORGERIES for change in changes))


# -- single forms of damage, in which a reader was wrong


@pytest.mark.further
def test_a_chunk_with_a_damaged_head_under_the_manifest_of_another_is_whole(recorded: Recorded) -> None:
    found = taken_apart(recorded.data)
    first, *_, last = places(found, OP_CHUNK)
    found[first], found[last] = found[last], found[first]
    head, kind, data = chunk_of(found[first][1])
    body = struct.pack("<QQQI", *head[:2], 8306, head[3]) + as_text(kind) + struct.pack("<Q", len(data)) + data
    found[first] = (OP_CHUNK, body)
    result = checked(recorded, put_together(found, True))
    assert result and result.messages == len(recorded.content)


@pytest.mark.further
@pytest.mark.parametrize("kind", [OP_CHUNK_INDEX, OP_ATTACHMENT_INDEX, OP_METADATA_INDEX])
def test_a_summary_with_records_shorter_than_their_head_is_not_believed(recorded: Recorded, kind: int) -> None:
    found = taken_apart(recorded.data)
    at = places(found, kind)[0]
    length = 24 if kind == OP_CHUNK_INDEX else 8
    found[at] = (kind, found[at][1][:length] + (1).to_bytes(8, "little") + found[at][1][length + 8 :])
    result = checked(recorded, put_together(found, True))
    assert result and result.messages == len(recorded.content)


@pytest.mark.further
def test_topics_of_lost_channels_are_those_of_metadata_yaml(recorded: Recorded) -> None:
    """No chunk and no channel is left, and the statistics count by the numbers of channels."""
    left = [record for record in taken_apart(recorded.data) if record[0] not in (OP_CHUNK, OP_CHANNEL)]
    bag = recorded.with_content(put_together(left, True))
    with pytest.raises(BagError, match=f"got none of the {len(recorded.content)} recorded"):
        repair_bag(bag, recorded.new)
    assert not recorded.new.exists()


@pytest.mark.further
@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("trusted", [True, False])
def test_a_chunk_that_stands_twice(recorded: Recorded, number: int, trusted: bool) -> None:
    """No message counts twice, and the analysis is that of the bag without the copy."""
    found = taken_apart(recorded.data)
    chunks = places(found, OP_CHUNK)
    found.insert(chunks[-1] + 1, found[chunks[number]])
    checked(recorded, put_together(found, trusted))
    assert figures(recorded.new) == figures(recorded.folder / "bag")
    assert any("is in the file twice" in problem for problem in Run.open(recorded.new).problems)


@pytest.mark.further
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_chunk_that_is_gone(recorded: Recorded, number: int) -> None:
    """What is lost stands at the same times, also where the first message of the new bag is a later one."""
    found = taken_apart(recorded.data)
    del found[places(found, OP_CHUNK)[number]]
    checked(recorded, put_together(found, True))
    before, after = (Run.open(recorded.folder / name) for name in ("changed", "new"))
    assert before.losses and [str(loss) for loss in after.losses] == [str(loss) for loss in before.losses]


@pytest.mark.further
@pytest.mark.parametrize("same", [True, False])
def test_messages_that_stand_twice_in_other_chunks(recorded: Recorded, same: bool) -> None:
    """The same ones, or others under the same numbers."""
    found, foreign = taken_apart(recorded.data), recorded.shorter if same else recorded.foreign
    end, second = places(found, OP_DATA_END)[0], places(foreign, OP_CHUNK)[1]
    found[end:end] = foreign[second - 1 : second + 1]
    checked(recorded, put_together(found, True), forged=True)
    assert not Run.open(recorded.new).losses


@pytest.mark.further
def test_a_message_index_with_the_largest_offset(recorded: Recorded) -> None:
    """Its sum with the length of a head is beyond 64 bit."""
    found = RecordMutation("index", 0, 1, 2**63 - 1, "", b"x")(taken_apart(recorded.data), recorded.foreign)
    checked(recorded, put_together(found, True))
    assert figures(recorded.new) == figures(recorded.folder / "bag")


@pytest.mark.further
def test_messages_of_another_type_are_left_out(recorded: Recorded) -> None:
    """The first chunk names another type for the accelerations, its checksum agrees, its manifest is gone."""
    altered = RecordMutation("forged_content", 0, 19, 15, "", b"geometry_msgs/msg/AccelStompid")
    checked(recorded, put_together(altered(taken_apart(recorded.data), recorded.foreign), False), forged=True)


# -- single bits: what repair says of the loss, number by number and place by place


def check_loss(result: RepairResult, found: dict[Key, Content], original: dict[Key, Content]) -> None:
    """What repair says of the loss is what is missing, topic by topic, number by number and place by place."""
    missing = sorted(original.keys() - found.keys())
    assert {loss.topic: loss.missing for loss in result.losses} == Counter(topic for topic, _ in missing)
    copied = Counter(topic for topic, _ in found)
    assert {topic: count for topic, count in result.copied.items() if count} == copied
    start = min(log for log, _, _ in original.values())
    for loss in result.losses:
        assert loss.recovered == copied[loss.topic]
        lost = [original[key][0] - start for key in missing if key[0] == loss.topic]
        left = [log - start for (topic, _), (log, _, _) in found.items() if topic == loss.topic]
        for span in loss.spans:
            inside = [log for log in lost if span.start - 1e-9 < log * 1e-9 < span.stop + 1e-9]
            assert len(inside) == span.messages, (loss.topic, span)
            assert not any(span.start + 1e-9 < log * 1e-9 < span.stop - 1e-9 for log in left), (loss.topic, span)
        assert sum(span.messages for span in loss.spans) == len(lost)


def beside(data: bytes) -> dict[str, object]:
    """What an intact file holds beside messages: attachments and the records of the run, by name and number."""
    reader = make_reader(io.BytesIO(data))
    tables = [record.metadata for record in reader.iter_metadata() if record.name == METADATA_NAME]
    return {a.name: a.data for a in reader.iter_attachments()} | {"run": {k: v for t in tables for k, v in t.items()}}


def check_beside(result: RepairResult, new: bytes, original: bytes) -> None:
    """What stands beside the messages is there as it was, or its loss is told."""
    there, before = beside(new), beside(original)
    text = " ".join(result.problems)
    for name, content in before.items():
        if name == "run" and there[name] != content:
            assert "metadata record" in text, result.problems
        elif there.get(name) != content:
            assert name not in there and ("attachment" in text or "record" in text), result.problems


def check_bit(good: Path, bit: int, original: dict[Key, Content], folder: Path) -> None:
    """The laws of a bag with one wrong bit."""
    data, new = next(good.glob("*.mcap")).read_bytes(), folder / "new"
    damaged = bytearray(data)
    damaged[bit // 8] ^= 1 << (bit % 8)
    bag = changed(good, folder, damaged)
    result = repair_bag(bag, new)
    repaired = (new / "new_0.mcap").read_bytes()
    found = messages(repaired)
    assert all(original[key] == content for key, content in found.items()), bit
    assert all(found.keys() >= others for others in others_find(bytes(damaged), original)), bit
    check_loss(result, found, original)
    check_beside(result, repaired, data)
    run = Run.open(bag)
    assert run.losses == result.losses, bit
    copied = {name: result.copied.get(f"{run.namespace}/{name}", 0) for name in run.topics}
    assert {name: len(run[name]) for name in run.topics} == copied, bit


@pytest.mark.slow
@pytest.mark.parametrize("part", range(24))
def test_a_flipped_bit_of_the_reference_bag(part: int, tmp_path: Path) -> None:
    """500 bits anywhere and 100 in the heads of records."""
    data, rng = next(REFERENCE.glob("*.mcap")).read_bytes(), np.random.default_rng(15)
    heads = 8 * rng.choice(np.array([begin for begin, _ in records(data)]), 100) + rng.integers(8 * 60, size=100)
    bits = np.append(rng.integers(8 * len(data), size=500), np.minimum(heads, 8 * len(data) - 1))
    original = messages(data)
    for bit in bits[25 * part : 25 * (part + 1)].tolist():
        check_bit(REFERENCE, bit, original, tmp_path)


def test_bits_of_each_kind_of_record(recorded: Recorded, tmp_path: Path) -> None:
    """Of `make test`: in the first manifest, in head and data of the first chunk, in the summary."""
    data = recorded.data
    chunk, manifest = (next(b for b, _ in records(data) if data[b] == op) for op in (OP_CHUNK, OP_MANIFEST))
    for place in (manifest + 50, chunk, chunk + 3, chunk + 20_000, len(data) - 100):
        check_bit(recorded.folder / "bag", 8 * place, recorded.content, tmp_path)
