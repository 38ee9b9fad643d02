"""500 random single-bit flips of the reference bag: what is recovered, and what is said of the loss.

The oracle is the mcap package: its seeking and its streaming reader on the damaged file, and its seeking reader on the
original and on the repaired bag.
"""

from __future__ import annotations

import io
import shutil
from collections import Counter, OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mcap.reader
import mcap.stream_reader
import numpy as np
import pytest
from fuzz.mutations import Content, Key, messages, others_find, records
from los_testbed.bags.repair import RepairResult, repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from mcap.reader import make_reader
from mcap.records import Chunk, McapRecord
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_MANIFEST
from pointing_analysis.read.run import Run

BAG = Path(__file__).parents[2] / "bags" / "reference"
FLIPS, AT_HEADS, PART = 500, 100, 25
KEPT_CHUNKS = 16
HEAD_BYTES = 60
"""Bytes at the begin of a record that its head and the fields behind it take."""


@pytest.fixture(scope="module")
def good() -> tuple[bytes, dict[Key, Content]]:
    data = (BAG / "reference_0.mcap").read_bytes()
    return data, messages(data)


@pytest.fixture(scope="module", autouse=True)
def chunks_read_once() -> Iterator[None]:
    """The mcap package reads a chunk of the same bytes once: a flip changes one of them, its readers take all."""
    read, kept = mcap.stream_reader.breakup_chunk, OrderedDict[tuple[Any, ...], list[McapRecord]]()

    def breakup_chunk(chunk: Chunk, validate_crc: bool = False) -> list[McapRecord]:
        key = (chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc, chunk.data, validate_crc)
        if key not in kept:
            kept[key] = read(chunk, validate_crc)
            if len(kept) > KEPT_CHUNKS:
                kept.popitem(last=False)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcap.reader, "breakup_chunk", breakup_chunk)
        patch.setattr(mcap.stream_reader, "breakup_chunk", breakup_chunk)
        yield


def flips(data: bytes, part: int) -> list[int]:
    """Positions [bit]: of the first 500 all are equally likely, the others are in the heads of records."""
    rng = np.random.default_rng(15)
    anywhere = rng.integers(8 * len(data), size=FLIPS)
    begins = np.array([begin for begin, _ in records(data)])
    heads = 8 * rng.choice(begins, AT_HEADS) + rng.integers(8 * HEAD_BYTES, size=AT_HEADS)
    chosen = np.append(anywhere, np.minimum(heads, 8 * len(data) - 1))
    return [int(bit) for bit in chosen[part * PART : (part + 1) * PART]]


def flipped(good: Path, bit: int, folder: Path) -> Path:
    """A bag with one bit changed."""
    bag = folder / "damaged"
    shutil.rmtree(bag, ignore_errors=True)
    shutil.copytree(good, bag)
    file = next(bag.glob("*.mcap"))
    changed = bytearray(file.read_bytes())
    changed[bit // 8] ^= 1 << (bit % 8)
    file.write_bytes(changed)
    return bag


def check_loss(result: RepairResult, found: dict[Key, Content], original: dict[Key, Content]) -> None:
    """What repair says of the loss is what is missing, topic by topic, number by number and place by place."""
    missing = sorted(original.keys() - found.keys())
    assert {loss.topic: loss.missing for loss in result.losses} == Counter(topic for topic, _ in missing)
    copied = Counter(topic for topic, _ in found)
    assert {topic: count for topic, count in result.copied.items() if count} == copied
    assert {loss.topic: loss.recovered for loss in result.losses} == {
        loss.topic: copied[loss.topic] for loss in result.losses
    }
    start = min(log for log, _, _ in original.values())
    for loss in result.losses:
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


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range((FLIPS + AT_HEADS) // PART))
def test_a_flipped_bit(good: tuple[bytes, dict[Key, Content]], part: int, tmp_path: Path) -> None:
    data, original = good
    for bit in flips(data, part):
        bag, new = flipped(BAG, bit, tmp_path), tmp_path / "new"
        shutil.rmtree(new, ignore_errors=True)
        seeking, streaming = others_find((bag / "reference_0.mcap").read_bytes(), original)
        result = repair_bag(bag, new)
        repaired = (new / "new_0.mcap").read_bytes()
        found = messages(repaired)
        assert all(original[key] == content for key, content in found.items()), bit
        assert found.keys() >= seeking, bit
        assert found.keys() >= streaming, bit
        check_loss(result, found, original)
        check_beside(result, repaired, data)
        run = Run.open(bag)
        assert run.losses == result.losses, bit
        assert {name: len(run[name]) for name in run.topics} == {
            name: result.copied.get(f"{run.namespace}/{name}", 0) for name in run.topics
        }, bit


def test_bits_of_each_kind_of_record(tmp_path: Path) -> None:
    """Of `make test`: in the first manifest, in head and data of the first chunk, in the summary."""
    config = RunConfig(duration=1.5, mode="inprocess", **write_controllers(tmp_path))
    run_in_process(config, tmp_path / "bag", SimpleTelescope())
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    original = messages(data)
    chunk = next(begin for begin, _ in records(data) if data[begin] == OP_CHUNK)
    manifest = next(begin for begin, _ in records(data) if data[begin] == OP_MANIFEST)
    for place in (manifest + 50, chunk, chunk + 3, chunk + 20_000, len(data) - 100):
        bag, new = flipped(tmp_path / "bag", 8 * place, tmp_path), tmp_path / "new"
        shutil.rmtree(new, ignore_errors=True)
        result = repair_bag(bag, new)
        check_loss(result, messages((new / "new_0.mcap").read_bytes()), original)
