"""Which checksums a file of another program has, whether they agree, and what is said where there are none."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from los_testbed.bags.check import BagCheck, BagCheckRow, check_bag
from mcap.writer import CompressionType, Writer

MESSAGES = 3000
DEFINITION = b"std_msgs/Header header\ngeometry_msgs/Vector3 vector"


def written(file: Path, *, chunks: bool, checksums: bool, of_data: bool) -> Path:
    """A file with values on one topic, as the package mcap writes it."""
    with file.open("wb") as stream:
        writer = Writer(
            stream,
            compression=CompressionType.NONE,
            use_chunking=chunks,
            enable_crcs=checksums,
            enable_data_crcs=of_data,
        )
        writer.start("ros2", "test")
        schema = writer.register_schema("geometry_msgs/msg/Vector3Stamped", "ros2msg", DEFINITION)
        channel = writer.register_channel("/los", "cdr", schema)
        for k in range(MESSAGES):
            time = 10**9 + k * 10**6
            head = b"\0\1\0\0" + struct.pack("<iII", time // 10**9, time % 10**9, 1) + b"\0\0\0\0"
            writer.add_message(channel, time, head + struct.pack("<ddd", 1e-8 * k, 2e-8, 0.0), time, k + 1)
        writer.finish()
    return file


def damaged(file: Path) -> None:
    """Change a value in the middle of the file."""
    content = bytearray(file.read_bytes())
    at = content.index(struct.pack("<d", 1e-8 * (MESSAGES // 2)))
    content[at : at + 8] = struct.pack("<d", 5.0)
    file.write_bytes(content)


def checksums(found: BagCheck) -> BagCheckRow:
    return next(row for row in found.rows if row.name == "checksums")


@pytest.mark.parametrize("chunks", [True, False])
def test_the_checksum_of_all_data_is_compared(tmp_path: Path, chunks: bool) -> None:
    file = written(tmp_path / "los.mcap", chunks=chunks, checksums=False, of_data=True)
    whole = check_bag(file)
    assert (whole.code, whole.title, checksums(whole).state) == (0, "whole", "agrees")
    damaged(file)
    found = check_bag(file)
    assert found.code == 1
    assert found.title == "not whole"
    assert checksums(found).found.endswith("the checksum of the data does not match")


@pytest.mark.parametrize("chunks", [True, False])
def test_a_file_without_checksums_is_not_called_whole(tmp_path: Path, chunks: bool) -> None:
    file = written(tmp_path / "los.mcap", chunks=chunks, checksums=False, of_data=False)
    for change in (lambda _: None, damaged):
        change(file)
        found = check_bag(file)
        assert checksums(found).state == "none"
        assert "no checksum of any of the 3000 messages" in found.title
        assert not found.title.startswith("whole")


def test_checksums_of_chunks_prove_their_messages(tmp_path: Path) -> None:
    file = written(tmp_path / "los.mcap", chunks=True, checksums=True, of_data=False)
    assert (check_bag(file).title, checksums(check_bag(file)).state) == ("whole", "agrees")
    damaged(file)
    assert checksums(check_bag(file)).state == "damaged"
