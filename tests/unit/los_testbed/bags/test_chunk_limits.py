"""Chunks whose declared size is not true: never unpacked beyond the limit, told by name, and the others are read."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import zstandard
from fuzz.record_mutations import put_together, taken_apart
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.mcap import chunks as mcap_chunks
from pointing_analysis.read.mcap import walk as mcap_walk
from pointing_analysis.read.mcap.chunks import take_apart
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_DATA_END, OP_MANIFEST, OP_SCHEMA, RECORD, BagError
from pointing_analysis.read.run import Run

TWO_GB = 2 << 30


def noting(results: list[Any], inner: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with what each call returns put into `results`."""

    def call(*given: Any) -> Any:
        results.append(inner(*given))
        return results[-1]

    return call


@cache
def zeros(size: int) -> bytes:
    """Compressed zeros: 66 kB for 2 GB."""
    packed, block = io.BytesIO(), bytes(1 << 22)
    with zstandard.ZstdCompressor(level=1).stream_writer(packed, closefd=False) as stream:
        for _ in range(size // len(block)):
            stream.write(block)
    return packed.getvalue()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bomb")
    run_in_process(
        RunConfig(duration=2.0, mode="inprocess", **write_controllers(folder)), folder / "bag", SimpleTelescope()
    )
    return folder / "bag" / "bag_0.mcap"


@pytest.mark.further
def test_a_chunk_of_66_kb_that_unpacks_to_2_gb_is_left_out(made: Path, tmp_path: Path) -> None:
    """Whatever size it declares: the true one, a small one, one that no memory has."""
    packed = zeros(TWO_GB)
    assert len(packed) < 80_000
    good, files = made.read_bytes(), []
    for declared in (TWO_GB, 1000, 1 << 63):
        head = struct.pack("<QQQI", 1, 2, declared, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
        end = good.rindex(RECORD.pack(OP_DATA_END, 4))
        bomb = RECORD.pack(OP_CHUNK, len(head) + len(packed)) + head + packed
        files.append(tmp_path / f"{declared}.mcap")
        files[-1].write_bytes(good[:end] + bomb + good[end:])
    code = (
        "import re; from los_testbed.cli.app import main\n"
        f"for file in {[str(file) for file in files]}:\n"
        "    print('===', main(['analyse', file]))\n"
        "status = open('/proc/self/status').read()\n"  # ru_maxrss holds the memory of the test's own process
        "print(int(re.search(r'VmHWM:\\s+(\\d+)', status)[1]) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=280, check=True)
    *shown, megabytes = done.stdout.split("=== ")
    assert float(megabytes.split()[1]) < 400
    assert [text.split()[0] for text in (*shown[1:], megabytes)] == ["0"] * 3
    for told, file in zip(shown, files):
        assert "unpacks to more than the limit of 64 MB (--max-chunk)" in " ".join(told.split()), file
        assert len(Run.open(file)["truth/los"]) == 2000, file


def test_the_limit_can_be_raised(made: Path) -> None:
    whole = Run.open(made.parent)
    small = Run.open(made.parent, max_chunk=10_000)
    assert len(whole["truth/los"]) == 2000 and not whole.problems
    assert any("--max-chunk" in problem for problem in small.problems)
    assert "truth/los" not in small or not len(small["truth/los"])


def chunk(content: bytes) -> bytes:
    """A chunk record of this content, with right size and checksum."""
    packed = zstandard.ZstdCompressor().compress(content)
    head = struct.pack("<QQQI", 1, 2, len(content), zlib.crc32(content)) + struct.pack("<I", 4) + b"zstd"
    return RECORD.pack(OP_CHUNK, len(head) + 8 + len(packed)) + head + struct.pack("<Q", len(packed)) + packed


def with_chunks(made: Path, target: Path, *chunks: bytes) -> Path:
    good = made.read_bytes()
    end = good.rindex(RECORD.pack(OP_DATA_END, 4))
    target.write_bytes(good[:end] + b"".join(chunks) + good[end:])
    return target


@pytest.mark.parametrize("op", [0, OP_SCHEMA, OP_CHUNK, 0x90])
def test_a_few_bytes_do_not_stand_for_millions_of_records(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, op: int
) -> None:
    """Two kilobytes held seven million records, each of which was looked at, and a damaged one was told.

    Without manifests: in a file with them such a chunk is not looked into, since none names it.
    """
    record = chunk(RECORD.pack(op, 0) * 1_000_000)
    read: list[Any] = []
    assert len(record) < 3000
    side_record = mcap_chunks.read_side_record
    monkeypatch.setattr(mcap_chunks, "read_side_record", noting(read, side_record))
    many = with_chunks(made, tmp_path / "many.mcap", record)
    many.write_bytes(put_together([r for r in taken_apart(many.read_bytes()) if r[0] != OP_MANIFEST], True))
    run = Run.open(many)
    assert len(run["truth/los"]) == 2000
    assert len(read) < 5000
    assert sum("invalid records: the rest of it is excluded" in problem for problem in run.problems) == 1
    assert len(run.problems) < 5


def test_many_chunks_do_not_unpack_to_more_than_a_multiple_of_the_file(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_walk, "MAX_SPARE", 30_000_000)
    monkeypatch.setattr(mcap_walk, "MAX_RATIO", 10)
    file = with_chunks(made, tmp_path / "many.mcap", *[chunk(bytes(20_000_000))] * 10)
    size = file.stat().st_size
    unpacked: list[Any] = []
    expand = mcap_chunks._expand
    monkeypatch.setattr(mcap_chunks, "_expand", noting(unpacked, expand))
    run = Run.open(file)
    assert len(run["truth/los"]) == 2000
    assert sum(len(content) for content, _ in unpacked) < 10 * size + 35_000_000
    assert any("the chunks of the file unpack to more than 10 times its size" in problem for problem in run.problems)


def test_an_unknown_compression_is_refused_unless_its_checksum_says_that_there_is_none() -> None:
    content = b"records of a chunk" * 20
    for data, refused in ((content, False), (content[:-1] + b"?", True)):
        name = b"brotli"
        head = struct.pack("<QQQI", 0, 1, len(content), zlib.crc32(content))
        body = head + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data)) + data
        if refused:
            with pytest.raises(BagError, match="must be zstd, lz4 or none, got 'brotli'"):
                take_apart(body, cut=False)
        else:
            found = take_apart(body, cut=False)
            assert found is not None and (found.kind, found.data) == ("", content)
