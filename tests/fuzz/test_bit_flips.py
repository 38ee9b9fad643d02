"""500 random single-bit flips of the reference bag: what is recovered, and what is said of the loss.

The oracle is the mcap package: its seeking and its streaming reader on the damaged file, and its seeking reader on the
original and on the repaired bag.
"""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fuzz.mutations import Content, Key, messages, others_get, records
from los_testbed.bags.repair import RepairResult, repair_bag
from los_testbed.config import RunConfig
from los_testbed.loop.simulate import run_in_process
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.mcap_records import OP_CHUNK, OP_MANIFEST
from pointing_analysis.read import Run

BAG = Path(__file__).parents[2] / "bags" / "reference"
FLIPS, AT_HEADS, PART = 500, 100, 25
HEAD_BYTES = 60
"""Bytes at the begin of a record that its head and the fields behind it take."""


@pytest.fixture(scope="module")
def good() -> tuple[bytes, dict[Key, Content]]:
    data = (BAG / "reference_0.mcap").read_bytes()
    return data, messages(data)


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
    """What repair says of the loss is what is missing, topic by topic and number by number."""
    missing = sorted(original.keys() - found.keys())
    assert {loss.topic: loss.missing for loss in result.losses} == Counter(topic for topic, _ in missing)
    copied = Counter(topic for topic, _ in found)
    assert {topic: count for topic, count in result.copied.items() if count} == copied
    start = min(log for log, _, _ in original.values())
    for topic, number in missing:
        seconds = (original[topic, number][0] - start) * 1e-9
        spans = next(loss.spans for loss in result.losses if loss.topic == topic)
        assert any(span.start < seconds + 1e-9 and seconds < span.stop + 1e-9 for span in spans), (topic, number)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range((FLIPS + AT_HEADS) // PART))
def test_a_flipped_bit(good: tuple[bytes, dict[Key, Content]], part: int, tmp_path: Path) -> None:
    data, original = good
    for bit in flips(data, part):
        bag, new = flipped(BAG, bit, tmp_path), tmp_path / "new"
        shutil.rmtree(new, ignore_errors=True)
        others = others_get((bag / "reference_0.mcap").read_bytes(), original)
        result = repair_bag(bag, new)
        found = messages((new / "new_0.mcap").read_bytes())
        assert all(original[key] == content for key, content in found.items()), bit
        assert len(found) >= others, bit
        check_loss(result, found, original)
        assert {loss.topic: loss.missing for loss in Run.open(bag).losses} == {
            loss.topic: loss.missing for loss in result.losses
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
