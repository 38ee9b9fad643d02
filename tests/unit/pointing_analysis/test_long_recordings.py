"""Long recordings: the same numbers as arrays in memory, whatever the parts; work and memory of reading."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.call_count import calls
from support.scripts import script

from pointing_analysis.indices import confidence
from pointing_analysis.indices.held_rows import hold_of
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read import mapped_arrays
from pointing_analysis.read.arrivals import arrivals
from pointing_analysis.read.mapped_arrays import (
    GrowingArray,
    SortedValues,
    by_parts,
    common_rows,
    empty,
    parts,
    present,
)
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import render
from pointing_analysis.requirements.summary import summarise


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts so short that a few hundred samples are long."""
    monkeypatch.setattr(mapped_arrays, "PART", 97)
    monkeypatch.setattr(mapped_arrays, "RUN", 50)
    monkeypatch.setattr(mapped_arrays, "IN_MEMORY", 800)
    monkeypatch.setattr(confidence, "LAGS", 64)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("rows", [0, 1, 96, 97, 98, 1000])
def test_arrays_that_grow_and_functions_by_parts(rows: int) -> None:
    rng = np.random.default_rng(rows)
    values, grown = rng.standard_normal((rows, 3)), GrowingArray(3)
    for begin in range(0, rows, 13):
        grown.append(values[begin : begin + 13])
    found = grown.array()
    assert np.array_equal(found, values) and found.shape == (rows, 3)
    assert np.array_equal(by_parts(lambda e: 2 * e[:, 1], values), 2 * values[:, 1])
    assert sum(part.stop - part.start for part in parts(rows)) == rows
    made = empty((rows, 3))
    made[:] = values
    mapped_arrays.release()
    assert np.array_equal(made, values), "what is given back is in the file"


def test_long_arrays_are_mapped_and_leave_no_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(mapped_arrays.tempfile, "tempdir", None)
    made = empty(mapped_arrays.IN_MEMORY)
    assert made.base is not None and not list(tmp_path.iterdir())
    assert empty(3).base is None


@settings(deadline=None, max_examples=20)
@given(
    values=st.lists(st.floats(allow_infinity=False, width=32) | st.just(0.0) | st.just(-0.0), min_size=1, max_size=60),
    run=st.integers(1, 20),
    probability=st.floats(0, 1),
)
def test_ranks_and_quantiles_are_those_of_the_sorted_values(values: list[float], run: int, probability: float) -> None:
    array = np.array(values)
    known = np.sort(array[~np.isnan(array)])
    before, mapped_arrays.RUN = mapped_arrays.RUN, run
    try:
        found = SortedValues(array)
    finally:
        mapped_arrays.RUN = before
    assert found.size == known.size
    if known.size:
        assert np.array_equal(found.at(np.arange(known.size)), known)
        value, share = found.quantile(probability), probability * known.size
        assert np.sum(known <= value) >= share - 1e-6, "so many do not exceed it"
        assert value == known[0] or np.sum(known < value) < share, "and it is the smallest such value"
    else:
        assert np.isnan(found.quantile(probability))


@pytest.mark.usefixtures("short")
def test_common_rows_and_present_values() -> None:
    rng = np.random.default_rng(3)
    first, second = (np.unique(rng.integers(0, 2000, 1200)) for _ in range(2))
    pairs = [(i, j) for rows, columns in common_rows(first, second) for i, j in zip(rows, columns)]
    _, i, j = np.intersect1d(first, second, return_indices=True)
    assert pairs == list(zip(i, j))
    values = np.where(rng.random(1000) < 0.1, np.nan, rng.standard_normal(1000))
    assert np.array_equal(present(values), values[~np.isnan(values)])


@pytest.mark.parametrize("lags", [1, 7, 64, 5000])
def test_autocorrelation_by_blocks(monkeypatch: pytest.MonkeyPatch, lags: int) -> None:
    x = np.random.default_rng(4).standard_normal(100).cumsum()
    monkeypatch.setattr(confidence, "LAGS", lags)
    found = np.concatenate([products for _, products in confidence._autocorrelation(x)])
    assert np.allclose(found, np.correlate(x, x, "full")[len(x) - 1 :], rtol=0, atol=1e-9 * (x @ x))


def damaged(folder: Path) -> Path:
    """Gaps, repeated and late stamps, NaN, a camera at another rate."""
    rng, n = np.random.default_rng(5), 6000
    stamps = 10**9 + 10**6 * np.arange(n)
    keep = np.sort(rng.choice(n, n - 60, replace=False))
    keep[700], keep[900:902] = keep[699], keep[900:902][::-1]
    los = 1e-8 * rng.standard_normal((n, 2))
    los[1234] = np.nan
    signals = {"truth/los": los[keep], "los_estimate": los, "fsm/strain_gauge": los, "fsm/command": los}
    given = {"truth/los": stamps[keep]}
    return write_bag(folder / "bag", signals, stamps=given, start=10**9, parameters={"loop": "fsm"})


@pytest.mark.further
@pytest.mark.usefixtures("without_pictures")
def test_figures_and_report_do_not_depend_on_the_length_of_the_parts(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    bag = damaged(tmp_path)
    whole = Run.open(bag)
    before, page = summarise(whole, transient=1.0), render([whole], transient=1.0)
    request.getfixturevalue("short")
    split = Run.open(bag)
    assert split["truth/los"].integrity == whole["truth/los"].integrity
    assert split["truth/los"].integrity.duplicates and split["truth/los"].integrity.out_of_order
    after = summarise(split, transient=1.0)
    assert {**after.as_dict(), "requirements": 0} == {**before.as_dict(), "requirements": 0}
    for one, other in zip(before.verdicts, after.verdicts):
        for name in ("status", "exceeding", "samples", "missing"):
            assert getattr(one, name) == getattr(other, name), name
        assert other.effective == pytest.approx(one.effective, rel=1e-9)
    assert len(render([split], transient=1.0)) == pytest.approx(len(page), rel=1e-3)


ROOT = Path(__file__).parents[3]


def last_line(*command: str, timeout: float = 280.0) -> str:
    command = (sys.executable, *command)
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    """The benchmark of reading, whose readers are compared here for what they deliver."""
    return script(ROOT / "benchmarks" / "bag_reading.py")


def test_messages_are_decoded_in_blocks(benchmark: ModuleType, tmp_path: Path) -> None:
    """Work per message, counted in calls: other readers make dozens for each message, this one some for each chunk."""
    counts, messages = [], []
    for seconds in (2, 6):
        bag = benchmark.synthetic(tmp_path / str(seconds), seconds)
        benchmark.ours(bag)  # imports
        counts.append(calls(lambda bag=bag: benchmark.ours(bag)))
        messages.append(sum(len(stamps) for stamps, _ in benchmark.ours(bag).values()))
    assert counts[1] - counts[0] < 0.5 * (messages[1] - messages[0])


T = TypeVar("T")
MEGABYTES = 400
"""Most memory that a command may take, whatever the length of the run."""


def largest_memory(*arguments: str) -> float:
    """Largest resident memory of a command in a process of its own [MB]; `getrusage` begins with its parent's."""
    code = (
        "from pathlib import Path; from los_testbed.cli.app import main; "
        f"main({list(arguments)!r}); print(*Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[:2])"
    )
    size, unit = last_line("-c", code, timeout=7000).split()
    assert unit == "kB"
    return int(size) / 1024


def with_peak(function: Callable[[], T]) -> tuple[T, int]:
    """What a function returns, and the largest size of its arrays that are not mapped [byte]."""
    tracemalloc.start()
    try:
        return function(), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_held_samples_are_looked_for_in_bounded_memory() -> None:
    """Of noise each row is a sample: the rows at which one begins are as many as the rows."""
    noise = GrowingArray(2)
    for seed in range(30):
        noise.append(np.random.default_rng(seed).standard_normal((100_000, 2)))
    e = noise.array()
    held, peak = with_peak(lambda: hold_of(e))
    assert held is None and peak < 0.8 * e.nbytes, "a mark or two for each row, and parts"


def test_the_times_of_messages_are_judged_in_bounded_memory() -> None:
    """Nine topics of two hours had 1 GB of times in a replay and in `bag verify`."""
    grown = [GrowingArray(None, np.int64) for _ in range(2)]
    for first in range(0, 3_000_000, 100_000):
        sent = 1_000_000 * np.arange(first, first + 100_000)
        for one, late in zip(grown, (300_000, 0)):
            one.append(np.delete(sent + late, [5000, 5001]))
    logged, stamps = (one.array() for one in grown)
    found, peak = with_peak(lambda: arrivals(logged, stamps))
    assert found.lost == 60 and len(found.of("gap")) == 30
    assert peak < 0.7 * stamps.nbytes, "less than a copy of the times of one topic"


@pytest.mark.slow
@pytest.mark.timeout(30_000)
def test_two_hours_fit_into_400_megabytes(tmp_path: Path) -> None:
    """Nine topics at 1 kHz for 7200 s: simulated and recorded, judged and reported, replayed."""
    bag = str(tmp_path / "bag")
    run = ["run", "--mode=inprocess", "--duration=7200", "--no-report", f"--output={bag}"]
    commands = (run, ["report", bag], ["replay", bag, f"--output={tmp_path / 'replayed'}"])
    used = {command[0]: largest_memory(*command) for command in commands}
    assert max(used.values()) < MEGABYTES, used
