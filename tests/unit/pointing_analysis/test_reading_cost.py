"""Work and memory of reading; times are in benchmarks/bag_reading.py."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.call_count import calls

ROOT = Path(__file__).parents[3]


def last_line(*command: str) -> str:
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=280, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    """The benchmark of reading, whose readers are compared here for what they deliver."""
    spec = importlib.util.spec_from_file_location("bag_reading", ROOT / "benchmarks" / "bag_reading.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("reader", "package"), [("rosbags", "rosbags"), ("mcap_ros2", "mcap_ros2")])
def test_other_readers_deliver_the_same(benchmark: ModuleType, tmp_path: Path, reader: str, package: str) -> None:
    pytest.importorskip(package)
    bag = benchmark.synthetic(tmp_path, 1.0)
    assert benchmark.equal(benchmark.ours(bag), getattr(benchmark, reader)(bag))


def test_messages_are_decoded_in_blocks(benchmark: ModuleType, tmp_path: Path) -> None:
    """Work per message, counted in calls: other readers make dozens for each message, this one some for each chunk."""
    counts, messages = [], []
    for seconds in (2, 6):
        bag = benchmark.synthetic(tmp_path / str(seconds), seconds)
        benchmark.ours(bag)  # imports
        counts.append(calls(lambda bag=bag: benchmark.ours(bag)))
        messages.append(sum(len(stamps) for stamps, _ in benchmark.ours(bag).values()))
    assert counts[1] - counts[0] < 0.5 * (messages[1] - messages[0])


@pytest.mark.slow
def test_ten_minutes_fit_into_500_megabytes(tmp_path: Path) -> None:
    """Nine topics at 1 kHz for 600 s, opened, judged and reported in a process of its own."""
    write = (
        f"import sys; sys.path.insert(0, 'benchmarks'); import pathlib, bag_reading as b; "
        f"print(b.synthetic(pathlib.Path({str(tmp_path)!r}), 600))"
    )
    bag = last_line("-c", write)
    measure = (
        "import resource; from pointing_analysis.read import Run; from pointing_analysis.report import write_report; "
        f"run = Run.open({bag!r}); write_report([run], {str(tmp_path / 'report.html')!r}); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    assert float(last_line("-c", measure)) < 500
