"""Work and memory of reading; times are in benchmarks/bag_reading.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from support.call_count import calls
from support.scripts import script

ROOT = Path(__file__).parents[3]


def last_line(*command: str, timeout: float = 280.0) -> str:
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=timeout, cwd=ROOT, check=False
    )
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


@pytest.mark.slow
@pytest.mark.timeout(30_000)
def test_two_hours_fit_into_400_megabytes(tmp_path: Path) -> None:
    """Nine topics at 1 kHz for 7200 s: simulated and recorded, judged and reported, replayed."""
    bag = str(tmp_path / "bag")
    run = ["run", "--mode=inprocess", "--duration=7200", "--no-report", f"--output={bag}"]
    commands = (run, ["report", bag], ["replay", bag, f"--output={tmp_path / 'replayed'}"])
    used = {command[0]: largest_memory(*command) for command in commands}
    assert max(used.values()) < MEGABYTES, used
