"""The digest of a file: what was altered with new checksums and a new manifest, put in, taken out or moved."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from fuzz.record_mutations import Record, inside, places, put_together, taken_apart, without_summary
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.check import BagCheckRow, check_bag, sign_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata
from simple_telescope import SimpleTelescope, write_controllers
from support.forged_bags import forge_with_manifest, right_places, scaled, without_digest
from support.slow_cases import slow

from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, with_hash
from pointing_analysis.read.mcap.file_digest import SIZE
from pointing_analysis.read.mcap.records import (
    HEAD,
    INDEX_ENTRY,
    MAGIC,
    OP_ATTACHMENT,
    OP_CHANNEL,
    OP_CHUNK,
    OP_CHUNK_INDEX,
    OP_DATA_END,
    OP_INDEX,
    OP_MANIFEST,
    OP_MESSAGE,
    OP_METADATA,
    RECORD,
    BagError,
    table_at,
    text_at,
)
from pointing_analysis.read.run import Run


def changed(bag: Path, found: list[Record]) -> Run:
    (bag / "bag_0.mcap").write_bytes(put_together(found, True))
    return Run.open(bag)


def apart(bag: Path) -> list[Record]:
    return taken_apart((bag / "bag_0.mcap").read_bytes())


ALTERED = "the digest at the end is not that of the file"


def row(bag: Path, name: str = "digest of the file") -> BagCheckRow:
    return next(row for row in check_bag(bag).rows if row.name == name)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_chunk_with_a_new_manifest_is_not_that_of_the_digest(bag: Path, number: int) -> None:
    forge_with_manifest(bag, number)
    assert [text for text in Run.open(bag).contradictions if text.endswith(ALTERED)]
    assert row(bag).state == "contradicts"


@pytest.mark.parametrize("taken", [OP_MANIFEST, OP_METADATA, OP_ATTACHMENT, "chunk with its manifest"])
def test_a_record_that_was_taken_out_is_a_contradiction(bag: Path, taken: int | str) -> None:
    found = apart(bag)
    first = places(found, taken if isinstance(taken, int) else OP_MANIFEST)[0]
    last = places(found, OP_MANIFEST)[1] if taken == "chunk with its manifest" else first + 1
    del found[first:last]
    run = changed(bag, right_places(found))
    assert run.contradictions and bool(run.losses) == (taken in (OP_MANIFEST, "chunk with its manifest"))


def test_a_file_without_its_digest_says_what_is_not_covered(bag: Path) -> None:
    without_digest(bag)
    assert not Run.open(bag).contradictions and row(bag).state == "none"
    assert "what is beside its chunks is not covered" in check_bag(bag).title


@pytest.mark.parametrize("op", [OP_CHUNK, OP_METADATA])
def test_a_record_that_stands_twice_leaves_the_bag_not_whole(bag: Path, op: int) -> None:
    found = apart(bag)
    found.insert(places(found, OP_DATA_END)[0], found[places(found, op)[0]])
    changed(bag, right_places(found))
    assert check_bag(bag).code and row(bag).state != "agrees"


def test_an_index_that_leads_elsewhere_leaves_the_bag_not_whole(bag: Path) -> None:
    """Readers by index take times and places of messages from it; the analysis does not, and reads on."""
    before = values_of(bag)
    found = apart(bag)
    at = places(found, OP_INDEX)[3]
    body = bytearray(found[at][1])
    np.frombuffer(body, INDEX_ENTRY, (len(body) - 6) // 16, 6)["log"][5] += 1
    found[at] = (OP_INDEX, bytes(body))
    run = changed(bag, found)
    assert same_as(run, before) and not run.contradictions
    assert [text for text in run.problems if text.endswith("the index of a chunk is not that of its messages")]
    assert check_bag(bag).code == 1 and row(bag).state == "damaged"


@pytest.mark.parametrize("place", [0, 30, -20])
def test_damage_is_no_contradiction(bag: Path, place: int) -> None:
    """Two wrong bits in a manifest: its checksum says so."""
    found = apart(bag)
    at = places(found, OP_MANIFEST)[1]
    body = bytearray(found[at][1])
    body[place] ^= 1
    body[place + 7] ^= 4
    found[at] = (OP_MANIFEST, bytes(body))
    run = changed(bag, found)
    assert not run.contradictions and any("manifest of a chunk is damaged" in text for text in run.problems)


def test_a_cut_bag_has_no_digest(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert not Run.open(bag).contradictions and row(bag).state == "none"


@pytest.mark.parametrize("hashed", [False, True])
def test_a_changed_setting_with_a_new_hash_is_a_contradiction(bag: Path, hashed: bool) -> None:
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


# -- what no manifest binds -------------------------------------------------------------------------------------------


def of_first_chunk(found: list[Record], op: int) -> list[bytes]:
    """Records of a type in the first chunk."""
    return [body for kind, body in inside(found[places(found, OP_CHUNK)[0]][1]) if kind == op]


def forged_messages(found: list[Record], count: int = 50) -> list[Record]:
    """Messages of all topics with other stamps, as a recorder without chunks writes them."""
    own = [bytearray(body) for body in of_first_chunk(found, OP_MESSAGE)[::7][:count]]
    for body in own:
        body[HEAD - RECORD.size + 8 : HEAD - RECORD.size + 12] = struct.pack("<I", 77_777)
    return [(OP_MESSAGE, bytes(body)) for body in own]


def values_of(bag: Path) -> dict[str, np.ndarray]:
    run = Run.open(bag)
    return {name: run[name].values for name in run.topics}


def same_as(run: Run, before: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(run[name].values, before[name]) for name in before)


@pytest.mark.parametrize("summary", [True, slow(False)])
@pytest.mark.parametrize("place", ["first", "manifest", "chunk", "index", "end"])
def test_messages_outside_of_the_chunks_are_not_used(bag: Path, place: str, summary: bool) -> None:
    """99 015 of them in front of the first chunk halved the RPE of a signed bag, which verified as whole."""
    before = values_of(bag)
    found = apart(bag)
    where = {
        "first": places(found, OP_MANIFEST)[0],
        "manifest": places(found, OP_MANIFEST)[1],
        "chunk": places(found, OP_CHUNK)[1],
        "index": places(found, OP_INDEX)[1],
        "end": places(found, OP_DATA_END)[0],
    }[place]
    found[where:where] = forged_messages(found)
    run = changed(bag, found if summary else without_summary(found))
    assert [text for text in run.contradictions if "50 messages are outside the chunks" in text]
    assert same_as(run, before)


@pytest.mark.parametrize("number", [0, 2])
def test_a_chunk_put_in_without_a_manifest_is_not_used(bag: Path, number: int) -> None:
    """In front of the first manifest, too."""
    before = values_of(bag)
    found = apart(bag)
    found.insert(places(found, OP_MANIFEST)[number], (OP_CHUNK, scaled(found[places(found, OP_CHUNK)[0]][1])[0]))
    run = changed(bag, found)
    assert [text for text in run.contradictions if "no manifest lists" in text] and same_as(run, before)


def test_index_records_do_not_say_where_messages_are(bag: Path) -> None:
    """Each index names its first message alone, a byte further: what lies between was searched, and not all of it."""
    before = values_of(bag)
    found = apart(bag)
    for at in places(found, OP_INDEX):
        body = bytearray(found[at][1])
        rows = np.frombuffer(body, INDEX_ENTRY, (len(body) - 6) // 16, 6)
        rows["offset"] += np.arange(rows.size, dtype=np.uint64)
        found[at] = (OP_INDEX, bytes(body))
    run = changed(bag, found)
    assert same_as(run, before) and not run.contradictions


@pytest.mark.parametrize("in_summary", [False, True])
def test_a_channel_may_not_be_named_otherwise_than_in_the_chunks(bag: Path, in_summary: bool) -> None:
    found = apart(bag)
    renamed = next(body for body in of_first_chunk(found, OP_CHANNEL) if b"truth/los" in body).replace(
        b"truth", b"other"
    )
    if in_summary:
        at = next(at for at, (op, body) in enumerate(found) if op == OP_CHANNEL and b"truth/los" in body)
        found[at] = (OP_CHANNEL, renamed)
    else:
        found.insert(places(found, OP_MANIFEST)[2], (OP_CHANNEL, renamed))
    run = changed(bag, found)
    assert run.contradictions and len(run["truth/los"]) == 3000


@pytest.mark.parametrize("op", [OP_MESSAGE, OP_CHUNK, OP_MANIFEST, OP_METADATA])
def test_no_data_stand_behind_the_end_of_the_data(bag: Path, op: int) -> None:
    """Readers that look for chunks by the summary, or read on, would find them."""
    found = apart(bag)
    record = forged_messages(found, 1)[0] if op == OP_MESSAGE else found[places(found, op)[0]]
    found.insert(places(found, OP_DATA_END)[0] + 1, record)
    assert any("follows the end-of-data record" in text for text in changed(bag, found).contradictions)


def test_a_summary_that_names_a_chunk_twice_or_has_a_wrong_checksum_is_told(bag: Path) -> None:
    found = apart(bag)
    at = places(found, OP_CHUNK_INDEX)[0]
    run = changed(bag, [*found[:at], found[at], *found[at:]])
    assert any("does not list each chunk once" in text for text in run.contradictions)
    (bag / "bag_0.mcap").write_bytes(put_together([*found[:at], found[at], *found[at:]], False))
    run = Run.open(bag)
    assert any("the summary is damaged or missing" in text for text in run.problems) and not run.contradictions


def test_a_chunk_that_is_missing_behind_its_manifest_leaves_the_bag_not_whole(bag: Path) -> None:
    """The digests agreed, of two chunks, though three were signed."""
    found = apart(bag)
    del found[places(found, OP_CHUNK)[2]]
    (bag / "bag_0.mcap").write_bytes(put_together(found, True))
    rows = {row.name: row for row in check_bag(bag).rows}
    assert rows["digests of chunks"].state == "damaged" and "2 of 3" in rows["digests of chunks"].found


def test_a_bag_without_settings_and_manifests_says_that_it_had_them(bag: Path) -> None:
    """With all of both taken out nothing in the file contradicts it, but for the library that its header names."""
    before = Run.open(bag)
    assert not before.problems and before.parameters["mode"] == "inprocess"
    run = changed(bag, [record for record in apart(bag) if record[0] not in (OP_METADATA, OP_MANIFEST)])
    assert any("was recorded with a metadata record" in text for text in run.problems), run.problems


# -- single bytes -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A small bag with its signature, and the public key."""
    folder = tmp_path_factory.mktemp("signed")
    config = RunConfig(duration=0.05, mode="inprocess", **write_controllers(folder))
    run_in_process(config, folder / "bag", SimpleTelescope())
    key = Ed25519PrivateKey.generate()
    sign_bag(folder / "bag", key)
    return folder / "bag", key.public_key()


def stays_whole(signed: tuple[Path, Any], name: str, place: int, change: int) -> bool:
    """Whether a bag is whole and signed with another value of a byte."""
    bag, key = signed
    file = bag / name
    good = file.read_bytes()
    altered = bytearray(good)
    altered[place % len(good)] ^= change
    try:
        file.write_bytes(altered)
        found = check_bag(bag, key=key)
    except BagError:
        return False
    finally:
        file.write_bytes(good)
    return found.title == "whole" and any(row.name == "signature" and row.state == "agrees" for row in found.rows)


FILES = ("bag_0.mcap", "metadata.yaml", "bag_0.mcap.sig")


@given(st.sampled_from(FILES), st.integers(0, 10**9), st.integers(1, 255))
def test_no_byte_of_a_signed_bag_can_be_changed(signed: tuple[Path, Any], name: str, place: int, change: int) -> None:
    assert not stays_whole(signed, name, place, change)


@pytest.mark.parametrize("change", [0x01, 0x20, slow(0x80)])
def test_nor_one_of_its_footer_or_its_signature(signed: tuple[Path, Any], change: int) -> None:
    """Of all bytes in turn: no digest covers these."""
    assert check_bag(signed[0], key=signed[1]).title == "whole"
    tail = [(FILES[0], -place) for place in range(1, 1 + len(MAGIC) + 29 + RECORD.size + SIZE)]
    sign = [(FILES[2], place) for place in range((signed[0] / FILES[2]).stat().st_size)]
    assert not [(name, place) for name, place in (*tail, *sign) if stays_whole(signed, name, place, change)]


def test_nothing_can_be_put_behind_the_end(signed: tuple[Path, Any]) -> None:
    bag, key = signed
    file = bag / "bag_0.mcap"
    good = file.read_bytes()
    for more in (b"\0", MAGIC, RECORD.pack(OP_METADATA, 0), good[-37:]):
        file.write_bytes(good + more)
        assert check_bag(bag, key=key).code, more
    file.write_bytes(good)
