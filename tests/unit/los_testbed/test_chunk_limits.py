"""Chunks whose declared size is not true: never unpacked beyond the limit, told by name, and the others are read."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from pathlib import Path

import pytest
import zstandard
from los_testbed.config import RunConfig
from los_testbed.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.mcap_records import OP_CHUNK, OP_DATA_END, RECORD
from pointing_analysis.read import Run

EIGHT_GB = 8 << 30


def zeros(size: int) -> bytes:
    """Compressed zeros: 262 kB for 8 GB."""
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


@pytest.mark.parametrize("declared", [EIGHT_GB, 1000, 1 << 63])
def test_a_chunk_of_262_kb_that_unpacks_to_8_gb_is_left_out(made: Path, tmp_path: Path, declared: int) -> None:
    packed = zeros(EIGHT_GB)
    assert len(packed) < 300_000
    head = struct.pack("<QQQI", 1, 2, declared, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
    good = made.read_bytes()
    end = good.rindex(RECORD.pack(OP_DATA_END, 4))
    bomb = RECORD.pack(OP_CHUNK, len(head) + len(packed)) + head + packed
    (tmp_path / "bomb.mcap").write_bytes(good[:end] + bomb + good[end:])
    code = (
        "import re; from los_testbed.cli.app import main\n"
        f"code = main(['analyse', {str(tmp_path / 'bomb.mcap')!r}])\n"
        "status = open('/proc/self/status').read()\n"  # ru_maxrss holds the memory of the test's own process
        "print(code, int(re.search(r'VmHWM:\\s+(\\d+)', status)[1]) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=280, check=True)
    result, megabytes = done.stdout.splitlines()[-1].split()
    assert result == "0" and float(megabytes) < 400
    told = " ".join(done.stdout.split())
    assert "unpacks to more than the limit of 64 MB (--max-chunk)" in told
    assert len(Run.open(tmp_path / "bomb.mcap")["truth/los"]) == 2000


def test_the_limit_can_be_raised(made: Path) -> None:
    whole = Run.open(made.parent)
    small = Run.open(made.parent, max_chunk=10_000)
    assert len(whole["truth/los"]) == 2000 and not whole.problems
    assert any("--max-chunk" in problem for problem in small.problems)
    assert "truth/los" not in small or not len(small["truth/los"])
