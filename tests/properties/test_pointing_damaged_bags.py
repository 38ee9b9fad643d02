"""Whatever happens to the bytes of a bag: values that were recorded, or one clear error; never another exception."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pointing_analysis.indices.synthetic import McapStorage, write_bag
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run

N = 400
OPTIONS: dict[str, dict[str, Any]] = {"zstd": {}, "unchunked": {"chunks": False}}
OPTIONS |= {"lz4": {"compression": "lz4"}, "plain": {"compression": "none"}}


class Files(dict[str, tuple[Path, bytes]]):
    """A dictionary that does not print its bytes."""

    def __repr__(self) -> str:
        return f"Files({list(self)})"


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Files:
    folder = tmp_path_factory.mktemp("bags")
    rng = np.random.default_rng(0)
    signals = {"truth/los": rng.standard_normal((N, 2)), "pma/command": rng.standard_normal((N, 6))}
    found = Files()
    for name, options in OPTIONS.items():
        bag = write_bag(folder / name, signals, parameters={"seed": 1}, storage=McapStorage(chunk_size=5000, **options))
        file = bag / f"{name}_0.mcap"
        found[name] = (file, file.read_bytes())
    return found


KINDS = st.sampled_from(list(OPTIONS))
QUICK = settings(max_examples=26, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def look(file: Path, data: bytes) -> Run | None:
    file.write_bytes(data)
    try:
        run = Run.open(file)
        for name in run.topics:
            topic = run[name]
            assert len(topic) <= N
            assert np.all(np.diff(topic.stamp) > 0)
    except BagError:
        return None
    return run


@given(kind=KINDS, where=st.floats(0, 1), mask=st.integers(1, 255))
@QUICK
def test_one_changed_byte(files: Files, kind: str, where: float, mask: int) -> None:
    file, good = files[kind]
    data = bytearray(good)
    data[min(int(where * len(data)), len(data) - 1)] ^= mask
    look(file, bytes(data))


@given(kind=KINDS, where=st.floats(0, 1), length=st.integers(1, 400), seed=st.integers(0, 1000))
@QUICK
def test_a_stretch_of_garbage(files: Files, kind: str, where: float, length: int, seed: int) -> None:
    file, good = files[kind]
    at = int(where * len(good))
    garbage = np.random.default_rng(seed).bytes(length)
    look(file, good[:at] + garbage + good[at + length :])


@given(kind=KINDS, where=st.floats(0, 1))
@example(kind="zstd", where=0.04196260463037694)  # four bytes behind the head of the last record: as in an end of data
@QUICK
def test_cut_off_anywhere(files: Files, kind: str, where: float) -> None:
    """What is read of a cut file are the first samples, exactly."""
    file, good = files[kind]
    whole = look(file, good)
    assert whole is not None
    cut = look(file, good[: int(where * len(good))])
    if cut is not None and "truth/los" in cut:
        part = cut["truth/los"].values
        assert np.array_equal(part, whole["truth/los"].values[: len(part)])
        assert cut.problems or len(part) == N
