"""Repair of bags whose records are laid out here byte by byte, as the MCAP specification says."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
import zstandard
from los_testbed.bags.repair import RepairResult, repair_bag
from los_testbed.config.topics import DIAGNOSTICS_TOPIC, TOPICS
from mcap.reader import make_reader

MAGIC = b"\x89MCAP0\r\n"
FIRST, SECOND = TOPICS[0].path, TOPICS[1].path


def record(code: int, body: bytes) -> bytes:
    return struct.pack("<BQ", code, len(body)) + body


def text(content: str) -> bytes:
    return struct.pack("<I", len(content.encode())) + content.encode()


HEADER = record(1, text("ros2") + text("test"))
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def channel(number: int, topic: str) -> bytes:
    return record(4, struct.pack("<HH", number, 1) + text(topic) + text("cdr") + struct.pack("<I", 0))


def message(number: int, log: int, data: bytes, publish: int | None = None) -> bytes:
    return record(5, struct.pack("<HIQQ", number, 7, log, log if publish is None else publish) + data)


def chunk(content: bytes, compression: str = "zstd", checksum: int | None = None) -> bytes:
    packed = zstandard.compress(content) if compression == "zstd" else content
    checksum = zlib.crc32(content) if checksum is None else checksum
    head = struct.pack("<QQQI", 1, 2, len(content), checksum)
    return record(6, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def metadata(name: str, table: dict[str, str]) -> bytes:
    pairs = b"".join(text(key) + text(value) for key, value in table.items())
    return record(12, text(name) + struct.pack("<I", len(pairs)) + pairs)


def attachment(name: str, media_type: str, data: bytes) -> bytes:
    head = struct.pack("<QQ", 3, 4) + text(name) + text(media_type) + struct.pack("<Q", len(data))
    return record(9, head + data + bytes(4))


def repaired(tmp_path: Path, *records: bytes, end: bytes = END) -> tuple[RepairResult, Path]:
    source = tmp_path / "old.mcap"
    source.write_bytes(MAGIC + HEADER + b"".join(records) + end)
    return repair_bag(source, tmp_path / "new"), tmp_path / "new" / "new_0.mcap"


def messages(file: Path) -> list[tuple[str, int, int, bytes]]:
    """Topic, log time, publish time and bytes of all messages, topic by topic in their order in the file."""
    with file.open("rb") as stream:
        found = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    return sorted(((c.topic, m.log_time, m.publish_time, m.data) for _, c, m in found), key=lambda row: row[0])


def tables(file: Path) -> dict[str, dict[str, str]]:
    with file.open("rb") as stream:
        return {m.name: m.metadata for m in make_reader(stream).iter_metadata()}


def test_tables_and_files_are_copied_and_the_description_is_written_anew(tmp_path: Path) -> None:
    parameters = {"seed": "1", "empty": "", "": "no key", "unit": "µrad"}
    result, file = repaired(
        tmp_path,
        metadata("parameters", parameters),
        metadata("nothing", {}),
        metadata("rosbag2", {"serialized_metadata": "old"}),
        attachment("a.toml", "text/plain", b"abc"),
        attachment("empty", "", b""),
    )
    found = tables(file)
    assert found["parameters"] == parameters and found["nothing"] == {}
    assert found["rosbag2"]["serialized_metadata"].startswith("version: 9")
    assert set(found) == {"parameters", "nothing", "rosbag2", "los_testbed_repair"}
    with file.open("rb") as stream:
        files = {a.name: (a.media_type, a.data) for a in make_reader(stream).iter_attachments()}
    assert files == {"a.toml": ("text/plain", b"abc"), "empty": ("", b"")}
    assert (result.messages, result.damage, result.finished, result.last_stamp) == (0, (), True, 0)


def test_messages_keep_times_bytes_and_order_whatever_their_lengths(tmp_path: Path) -> None:
    """Three lengths in runs of one, two and three, of two topics, interleaved."""
    rows = [
        (10, 12, b"a"),
        (20, 19, b"bb"),
        (30, 31, b"cc"),
        (40, 40, b"ddd"),
        (45, 46, b"eee"),
        (50, 52, b"fff"),
        (60, 61, b"g"),
    ]
    content = channel(3, FIRST) + channel(300, SECOND)
    for log, publish, data in rows:
        content += message(3, log, data, publish) + message(300, log + 1, data * 2, publish)
    result, file = repaired(tmp_path, chunk(content))
    expected = [(FIRST, *row) for row in rows] + [(SECOND, log + 1, publish, data * 2) for log, publish, data in rows]
    assert messages(file) == sorted(expected, key=lambda row: row[0])
    assert result == RepairResult(messages=14, copied={FIRST: 7, SECOND: 7}, last_stamp=61)


def test_channels_of_an_earlier_chunk_hold_for_later_ones_and_unknown_ones_are_left_out(tmp_path: Path) -> None:
    result, file = repaired(
        tmp_path,
        chunk(channel(1, FIRST) + channel(2, "/other") + channel(258, DIAGNOSTICS_TOPIC) + message(1, 5, b"a")),
        chunk(message(1, 6, b"b") + message(2, 7, b"no topic of ours") + message(9, 8, b"no channel")),
        chunk(message(258, 9, b"diagnosis")),
    )
    expected = [(DIAGNOSTICS_TOPIC, 9, 9, b"diagnosis"), (FIRST, 5, 5, b"a"), (FIRST, 6, 6, b"b")]
    assert sorted(messages(file)) == sorted(expected)
    assert (result.messages, result.last_stamp) == (3, 9)


def test_chunks_without_compression_and_without_checksum_are_read(tmp_path: Path) -> None:
    content = channel(1, FIRST)
    result, file = repaired(
        tmp_path,
        chunk(content + message(1, 5, b"a"), compression=""),
        chunk(message(1, 6, b"b"), checksum=0),
        chunk(message(1, 7, b"c"), compression="", checksum=0),
    )
    assert [m[1:] for m in messages(file)] == [(5, 5, b"a"), (6, 6, b"b"), (7, 7, b"c")]
    assert result.damage == () and result.problems == ()


def test_damaged_chunks_are_named_by_offset_and_kind_and_the_next_is_copied(tmp_path: Path) -> None:
    good = chunk(channel(1, FIRST) + message(1, 5, b"a"))
    torn = bytearray(chunk(message(1, 6, b"b")))
    torn[9 + 28 + 4 + 4 + 8] ^= 0xFF  # magic number of zstd
    wrong = chunk(message(1, 7, b"c"), checksum=12345)
    result, file = repaired(tmp_path, good, bytes(torn), wrong, chunk(message(1, 8, b"d")))
    start = len(MAGIC + HEADER + good)
    assert [offset for offset, _ in result.damage] == [start, start + len(torn)]
    assert all("damaged" in what for _, what in result.damage)
    assert [m[1] for m in messages(file)] == [5, 8]
    assert (result.messages, result.last_stamp) == (2, 8)


CUT = chunk(message(1, 6, b"b"))
ENDS = [(CUT[:1], False), (CUT[:10], False), (CUT[:-1], False), (b"", False), (MAGIC, False), (MAGIC + b"more", False)]


@pytest.mark.parametrize(("end", "finished"), [*ENDS, (END, True)])
def test_a_file_is_finished_if_it_has_the_end_of_its_data(tmp_path: Path, end: bytes, finished: bool) -> None:
    result, file = repaired(tmp_path, chunk(channel(1, FIRST) + message(1, 5, b"a")), end=end)
    assert result.finished == finished and [m[1] for m in messages(file)][:1] == [5]
    assert finished or any("truncated" in text for text in result.sentences()) or end[:8] == MAGIC


def test_a_file_without_anything_to_read_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must have readable records, got none"):
        repaired(tmp_path, end=record(15, b""))
    assert [file.name for file in tmp_path.iterdir()] == ["old.mcap"]


@pytest.mark.parametrize("length", [(1 << 31) + 1, 1 << 62, (1 << 64) - 1])
def test_behind_an_absurd_length_the_records_are_found_again(tmp_path: Path, length: int) -> None:
    good, later = (chunk(channel(1, FIRST) + message(1, log, b"a")) for log in (5, 6))
    result, file = repaired(tmp_path, good, struct.pack("<BQ", 6, length), end=later + END)
    assert [m[1] for m in messages(file)] == [5, 6] and result.finished
    assert result.damage[0][0] == len(MAGIC + HEADER + good)


@pytest.mark.parametrize("bit", range(3, 72, 8))
def test_a_wrong_bit_in_the_head_of_a_chunk_loses_nothing(tmp_path: Path, bit: int) -> None:
    parts = [chunk(channel(1, FIRST) + message(1, log, bytes(200))) for log in (5, 6, 7)]
    torn = bytearray(parts[1])
    torn[bit // 8] ^= 1 << (bit % 8)
    result, file = repaired(tmp_path, parts[0], bytes(torn), parts[2])
    assert [m[1] for m in messages(file)] == [5, 6, 7]
    assert [offset for offset, _ in result.damage] == [len(MAGIC + HEADER + parts[0])]


def test_other_records_are_passed_over(tmp_path: Path) -> None:
    """Schema, index and unknown records carry nothing that is copied, within a chunk and outside."""
    others = [record(code, bytes(40)) for code in (3, 7, 8, 10, 11, 13, 14, 200)]
    content = channel(1, FIRST) + b"".join(others) + message(1, 5, b"a")
    result, file = repaired(tmp_path, *others, chunk(content), *others)
    assert messages(file) == [(FIRST, 5, 5, b"a")] and result.finished
    assert set(tables(file)) == {"rosbag2", "los_testbed_repair"}


@pytest.mark.parametrize("tail", [b"", bytes(4), bytes(200), b"\xa5\x3c" * 100], ids=["none", "few", "zeros", "junk"])
@pytest.mark.parametrize("chunked", [True, False])
def test_the_message_in_which_power_was_lost_is_left_out(tmp_path: Path, chunked: bool, tail: bytes) -> None:
    """Its head is right, its end is zeros or junk, and no checksum says so; those before it are counted apart."""
    data = [struct.pack("<3d", *row) for row in ((1, 2, 3), (4, 5, 6), (7, 8, 9))]
    content = channel(1, FIRST) + b"".join(message(1, 5 + i, part) for i, part in enumerate(data))
    rest = message(1, 9, bytes(400))  # of the chunk, and never written
    written = chunk(content + rest, "")[: -len(rest)] if chunked else content
    written = written[:-24] + (bytes(24) if tail[:1] == b"\0" else tail[:24].ljust(24, b"\x5a"))
    result, file = repaired(tmp_path, written, end=tail)
    assert [row[1] for row in messages(file)] == [5, 6] and not result.finished
    told = " ".join(result.problems)
    assert ("file is truncated: 2 of a chunk are used, 1 excluded" in told) == chunked
    assert chunked or "truncated" in told


def test_a_chunk_without_a_checksum_needs_a_record_behind_it(tmp_path: Path) -> None:
    content = channel(1, FIRST) + message(1, 5, b"abcd") + message(1, 6, bytes(4))
    result, file = repaired(tmp_path, chunk(content, "", checksum=0), end=bytes(100))
    assert [row[1] for row in messages(file)] == [5]
    assert any("no checksum covers" in text for text in result.problems)
