"""Several processes: the results of one, in order; no process outlives its parent."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lftkit.support.workers import Workers


def spectrum(seed: int) -> list[float]:
    """Eigenvalues of a random matrix: the last bits depend on the threads of the linear algebra."""
    return np.linalg.eigvals(np.random.default_rng(seed).standard_normal((120, 120))).real.tolist()


def fail_at_three(item: int) -> int:
    if item == 3:
        raise ValueError("item must not be 3, got 3")
    return item


def pages_taken(count: int) -> int:
    """Pages that the system hands out while so many arrays of 1 MB are made and dropped, a hundred times."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(100):
        arrays = [np.ones(1 << 17) for _ in range(count)]
        arrays.clear()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def interrupts_wait(item: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.fixture(scope="module")
def two() -> Iterator[Workers]:
    with Workers(2) as workers:
        yield workers


def test_the_results_are_those_of_one_process_in_order(two: Workers) -> None:
    with Workers(1) as one:
        assert two.map(spectrum, range(5)) == one.map(spectrum, range(5))
    assert list(two.each(abs, [-3, 2, -1])) == [3, 2, 1]
    assert two.map(abs, []) == [] and two.map(abs, [-1]) == [1]
    assert two.map(interrupts_wait, range(2)) == [True, True], "from their first instruction on"
    assert not interrupts_wait(0)


@pytest.mark.further
@pytest.mark.parametrize("variables", [{}, {"MALLOC_TRIM_THRESHOLD_": "65536"}])
def test_arrays_reuse_the_memory_of_those_before(variables: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """20 arrays have 5120 pages of 4 kB; a new process takes them anew every time. Dask leaves its bound behind."""
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with Workers(2) as workers:
        assert max(workers.map(pages_taken, [20, 20])) < 10 * 5120


def test_an_error_comes_from_the_item(two: Workers) -> None:
    with pytest.raises(ValueError, match="got 3"):
        two.map(fail_at_three, range(6))
    assert two.map(abs, [-1, -2]) == [1, 2], "and the others go on"
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        Workers(0)


def test_an_exception_ends_the_processes_in_the_midst_of_their_items() -> None:
    pids: list[int] = []

    def interrupted() -> None:
        with Workers(2) as workers:
            pids.extend(workers.map(identity_of_process, range(8)))
            workers.each(time.sleep, [3600.0] * 8)  # begun; nobody waits for them
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert pids and not any(alive(pid) for pid in pids)


def identity_of_process(item: int) -> int:
    return os.getpid()


SCRIPT = """
import os, sys, time
from lftkit.support.workers import Workers

def note(folder):
    open(os.path.join(folder, str(os.getpid())), "w").close()
    time.sleep(60)

if __name__ == "__main__":
    with Workers(2) as workers:
        workers.map(note, [sys.argv[1]] * 2)
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_no_process_outlives_its_parent(end: signal.Signals, tmp_path: Path) -> None:
    script, noted = tmp_path / "script.py", tmp_path / "noted"
    script.write_text(SCRIPT)
    noted.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), str(noted)], stderr=subprocess.DEVNULL)
    until = time.monotonic() + 60.0
    while len(list(noted.iterdir())) < 2 and time.monotonic() < until:
        time.sleep(0.05)
    children = [int(p.name) for p in noted.iterdir()]
    assert len(children) == 2
    parent.send_signal(end)
    parent.wait(60)
    while any(alive(pid) for pid in children) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(alive(pid) for pid in children)


LEFT = """
import time
from concurrent.futures import ProcessPoolExecutor
from lftkit.support.workers import Workers

class Late(ProcessPoolExecutor):  # on a busy machine the pool sees first that its processes ended

    def shutdown(self, **options):
        time.sleep(1.0)
        super().shutdown(**options)

def slow(item):
    time.sleep(0.1)
    return len(item)

if __name__ == "__main__":
    import lftkit.support.workers as module
    module.ProcessPoolExecutor = Late
    with Workers(2) as workers:
        results = workers.each(slow, [bytes(3 << 20)] * 40)  # more than a pipe holds
        next(results)
        results.close()
        raise KeyboardInterrupt
"""


def test_a_program_ends_that_leaves_large_items_behind(tmp_path: Path) -> None:
    """A pipe to ended processes must not keep it, nor a result that nobody asks for any more."""
    script = tmp_path / "script.py"
    script.write_text(LEFT)
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=False)
    assert ended.stderr.splitlines()[-1] == "KeyboardInterrupt"
    assert "InvalidStateError" not in ended.stderr


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
