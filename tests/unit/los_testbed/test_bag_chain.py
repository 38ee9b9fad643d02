"""The chain of manifests: what was altered with new checksums and a new manifest, put in, taken out or moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz.record_mutations import Record, put_together, taken_apart
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata
from support.forged_bags import forge, forge_with_manifest, places, without_chain

from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, with_hash
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.chain import SEAL
from pointing_analysis.read.mcap.records import (
    OP_ATTACHMENT,
    OP_CHUNK,
    OP_INDEX,
    OP_MANIFEST,
    OP_METADATA,
    table_at,
    text_at,
)
from pointing_analysis.read.run import Run


def changed(bag: Path, found: list[Record]) -> Run:
    (bag / "bag_0.mcap").write_bytes(put_together(found, True))
    return Run.open(bag)


def apart(bag: Path) -> list[Record]:
    return taken_apart((bag / "bag_0.mcap").read_bytes())


def end_of(bag: Path) -> int:
    """Where the seal stands."""
    return next(at for at, (op, body) in enumerate(apart(bag)) if op == OP_METADATA and SEAL.encode() in body[:30])


def test_a_whole_bag_is_sealed_and_nothing_contradicts_it(bag: Path) -> None:
    reading = BagPass(bag, bag_files(bag))
    for _ in reading.blocks():
        pass
    [info] = reading.infos
    assert (info.chain.manifests, info.chain.linked, info.chain.sealed, info.chain.broken) == (3, True, True, [])
    assert info.chunks == info.digests == 3 and not reading.contradictions and not reading.problems()


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_chunk_with_a_new_manifest_breaks_the_chain_behind_it(bag: Path, number: int) -> None:
    """The next manifest does not continue the chain; behind the last one its end does not."""
    forge_with_manifest(bag, number)
    run = Run.open(bag)
    expected = "the end of the chain is not what stands before it" if number == 2 else "does not continue the chain"
    assert [text for text in run.contradictions if expected in text], run.contradictions


def test_a_chain_made_anew_agrees_until_it_is_signed(bag: Path) -> None:
    """What the chain does not prove: whoever writes the whole file writes the chain as well."""
    before = Run.open(bag)["truth/los"].values
    forge_with_manifest(bag, 1, chained=True)
    run = Run.open(bag)
    assert not run.problems and np.array_equal(run["truth/los"].values[1000:2000], 0.01 * before[1000:2000])


@pytest.mark.parametrize("op", [OP_MANIFEST, OP_METADATA, OP_ATTACHMENT])
def test_a_record_that_was_taken_out_breaks_the_chain(bag: Path, op: int) -> None:
    found = apart(bag)
    del found[places(found, op)[0]]
    assert changed(bag, found).contradictions


def test_a_chunk_taken_out_with_its_manifest_breaks_the_chain(bag: Path) -> None:
    found = apart(bag)
    first, second = places(found, OP_MANIFEST)[1:3]
    del found[first:second]
    run = changed(bag, found)
    assert run.contradictions and run.losses


def test_a_chunk_put_in_without_a_manifest_is_a_stranger(bag: Path) -> None:
    found, other = apart(bag), bag.with_name("other")
    other.mkdir()
    (other / "bag_0.mcap").write_bytes((bag / "bag_0.mcap").read_bytes())
    forge(other)
    altered = apart(other)
    found.insert(places(found, OP_MANIFEST)[2], altered[places(altered, OP_CHUNK)[1]])
    assert any("no manifest names" in text for text in changed(bag, found).contradictions)


@pytest.mark.parametrize("op", [OP_CHUNK, OP_METADATA])
def test_nothing_may_stand_behind_the_end(bag: Path, op: int) -> None:
    found = apart(bag)
    found.insert(end_of(bag) + 1, found[places(found, op)[0]])
    assert any("behind the end of the chain" in text for text in changed(bag, found).contradictions)


def test_the_end_may_not_be_missing(bag: Path) -> None:
    found = apart(bag)
    del found[end_of(bag)]
    assert any("end of the chain is missing" in text for text in changed(bag, found).contradictions)


@pytest.mark.parametrize("place", [0, 30, -20])
def test_damage_is_no_contradiction(bag: Path, place: int) -> None:
    """Two wrong bits in a manifest: its checksum says so, and the chain goes on behind it."""
    found = apart(bag)
    at = places(found, OP_MANIFEST)[1]
    body = bytearray(found[at][1])
    body[place] ^= 1
    body[place + 7] ^= 4
    found[at] = (OP_MANIFEST, bytes(body))
    run = changed(bag, found)
    assert not run.contradictions and any("manifest of a chunk is damaged" in text for text in run.problems)


def test_indexes_are_not_in_the_chain_and_a_cut_bag_has_no_end(bag: Path) -> None:
    found = [record for record in apart(bag) if record[0] != OP_INDEX]
    assert not changed(bag, found).contradictions
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert not Run.open(bag).contradictions


def test_bags_of_older_versions_have_no_chain(bag: Path) -> None:
    without_chain(bag)
    reading = BagPass(bag, bag_files(bag))
    for _ in reading.blocks():
        pass
    [info] = reading.infos
    assert not info.chain.linked and info.chain.manifests == info.digests == info.chunks > 1
    assert not reading.problems()


@pytest.mark.parametrize("hashed", [False, True])
def test_a_changed_setting_with_a_new_hash_breaks_the_chain(bag: Path, hashed: bool) -> None:
    """Without one its own hash tells the damage."""
    found = apart(bag)
    for at in (at for at in places(found, OP_METADATA) if text_at(found[at][1], 0)[0] == METADATA_NAME):
        table = table_at(found[at][1], 4 + len(METADATA_NAME))
        table["seed"] = "2"
        builder = RecordBuilder()
        Metadata(name=METADATA_NAME, metadata=with_hash(table) if hashed else table).write(builder)
        found[at] = (OP_METADATA, builder.end()[9:])
    run = changed(bag, found)
    assert bool(run.contradictions) == hashed and run.problems
