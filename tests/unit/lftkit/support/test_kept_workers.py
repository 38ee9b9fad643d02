"""Results of workers that are kept in a file: what is there is not computed again, and nothing else is loaded."""

from __future__ import annotations

import pickle
import subprocess
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lftkit.support.job import Job
from lftkit.support.kept_workers import _HEAD, MAGIC, KeptWorkers
from lftkit.support.workers import Workers


@dataclass(frozen=True)
class Found:
    """A result as those of a verification: arrays and numbers by name."""

    values: dict[str, np.ndarray[Any, Any]]
    largest: np.float64
    stable: bool


COUNTED: list[int] = []


def find(item: int) -> Found:
    COUNTED.append(item)
    if item < 0:
        raise KeyboardInterrupt
    values = np.arange(item, dtype=float)
    return Found({"a": values, "b": np.array([True, False])}, np.float64(item) / 3, item > 1)


def kept(path: Path, job: str = "one") -> KeptWorkers:
    COUNTED.clear()
    return KeptWorkers(Workers(), Job("sums", {"name": job}, path), (Found,))


def same(one: Found, other: Found) -> bool:
    return type(one.largest) is np.float64 and repr(one) == repr(other)


def interrupted(path: Path) -> None:
    workers = kept(path)
    workers.map(find, [1, 2])
    with pytest.raises(KeyboardInterrupt):
        workers.map(find, [3, 4, -1])
    workers.close(done=False)


def test_an_interrupted_job_computes_only_the_rest(tmp_path: Path) -> None:
    interrupted(tmp_path / "parts")
    workers = kept(tmp_path / "parts")
    assert workers.known == 4
    found = [*workers.map(find, [1, 2]), *workers.each(find, [3, 4, 5])]
    assert COUNTED == [5]
    assert all(same(one, find(k)) for one, k in zip(found, range(1, 6)))
    workers.close(done=True)
    assert not (tmp_path / "parts").exists()


def test_results_of_another_job_are_not_taken(tmp_path: Path) -> None:
    interrupted(tmp_path / "parts")
    other = kept(tmp_path / "parts", "two")
    assert other.known == 0
    other.map(find, [1])
    other.close(done=False)
    assert kept(tmp_path / "parts", "two").known == 1


@pytest.mark.parametrize("lost", [1, 7, 60])
def test_what_was_cut_off_is_computed_again(tmp_path: Path, lost: int) -> None:
    path = tmp_path / "parts"
    interrupted(path)
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "damaged").write_bytes(damaged)
    assert kept(tmp_path / "damaged").known < 4
    path.write_bytes(path.read_bytes()[:-lost])
    workers = kept(path)
    workers.map(find, [1, 2])
    workers.map(find, [3, 4])
    assert COUNTED == [4]
    workers.close(done=False)
    assert kept(path).known == 4


class Evil:
    """Runs a function where it is loaded."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return print, ("loaded",)


@pytest.mark.parametrize("result", [Evil(), Path("here"), subprocess.Popen])
def test_no_other_class_is_loaded(tmp_path: Path, result: object, capsys: pytest.CaptureFixture[str]) -> None:
    record = pickle.dumps((1, 0, result))
    job = Job("sums", {"name": "one"}).digest.encode()
    with (tmp_path / "parts").open("wb") as file:
        file.write(MAGIC)
        for one in (job, record):
            file.write(_HEAD.pack(len(one), zlib.crc32(one)) + one)
    with pytest.raises(ValueError, match="must consist of arrays and known classes"):
        kept(tmp_path / "parts")
    assert capsys.readouterr().out == ""


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("of the user")
    with pytest.raises(ValueError, match="must be a file of kept results"):
        kept(tmp_path / "notes")
    assert (tmp_path / "notes").read_text() == "of the user"
    with pytest.raises(ValueError, match="must be a file that can be written"):
        kept(tmp_path / "no" / "parts")


def test_a_file_in_use_is_refused(tmp_path: Path) -> None:
    workers = kept(tmp_path / "parts")
    code = (
        "from pathlib import Path; from lftkit.support.job import Job; from lftkit.support.kept_workers import *\n"
        f"KeptWorkers(Workers(), Job('x', {{}}, Path({str(tmp_path / 'parts')!r})), ())"
    )
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "must not be in use by another process" in there.stderr
    workers.close(done=False)
