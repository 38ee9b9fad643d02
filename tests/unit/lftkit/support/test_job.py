"""Jobs and results that are kept: what makes two the same, what is left of an interrupted one, what is loaded."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lftkit.support.atomic_output import atomic_file
from lftkit.support.job import Job
from lftkit.support.kept_workers import _HEAD, MAGIC, KeptWorkers
from lftkit.support.workers import Workers


def job(folder: Path, **depends: object) -> Job:
    return Job("sum", depends, folder / "job.json")


def test_a_job_continues_in_its_folder_and_in_no_other(tmp_path: Path) -> None:
    asked = job(tmp_path / "new" / "sum", terms=[1, 2], run={"seed": 1, "noise": True})
    assert not asked.begin() and asked.begin()
    for other, text in (
        ({"terms": [1, 3], "run": {"seed": 1, "noise": True}}, "terms must be [1, 2] as there, got [1, 3]"),
        ({"terms": [1, 2], "run": {"seed": 2, "noise": True}}, "seed must be 1 as there, got 2"),
        ({"terms": [1, 2]}, 'run must be {"seed": 1, "noise": true} as there, got null'),
    ):
        with pytest.raises(ValueError, match="which holds another") as refused:
            job(asked.record.parent, **other).begin()
        assert text in str(refused.value)
    with pytest.raises(ValueError, match='kind must be "sum" as there, got "product"'):
        Job("product", asked.depends, asked.record).begin()


@pytest.mark.parametrize("content", ["", "{", "[]", "7"])
def test_a_folder_of_something_else_is_refused_and_left_as_it_is(content: str, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ValueError, match="--output must be a new folder or one of the same sum"):
        job(tmp_path).begin()
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "job.json").write_text(content)
    with pytest.raises(ValueError, match=r"job\.json must be"):
        job(tmp_path).begin()
    assert job(tmp_path).state() is None
    assert (tmp_path / "job.json").read_text() == content


def test_every_value_of_an_array_counts() -> None:
    values = np.arange(6.0)
    same, others = {"a": values.copy()}, [values + 1e-16 * (values == 0), values.reshape(2, 3), values.astype(int)]
    first = Job("sum", {"a": values})
    assert Job("sum", same).digest == first.digest
    assert len({first.digest, *(Job("sum", {"a": other}).digest for other in others)}) == 4


def test_a_state_belongs_to_its_job(tmp_path: Path) -> None:
    one, other = job(tmp_path, terms=1), job(tmp_path, terms=2)
    assert one.state() is None
    one.save({"at": 0.1 + 0.2})
    assert one.state() == {"at": 0.1 + 0.2} and other.state() is None
    one.finish()
    assert one.state() is None and not one.record.exists()


def test_one_process_at_a_time_and_nothing_half_written_is_left(tmp_path: Path) -> None:
    """Killed while it writes a part: the part is not there, and the next process removes what was begun."""
    asked = job(tmp_path, terms=3)
    asked.begin()
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from lftkit.support.atomic_output import atomic_file\n"
        "with atomic_file(Path(sys.argv[1])) as half:\n"
        "    half.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "part-1")], check=False)
    left = {path.name for path in tmp_path.iterdir()} - {"job.json"}
    assert len(left) == 1 and "part-1" not in left
    with asked.alone():
        assert [path.name for path in tmp_path.iterdir()] == ["job.json"]
        with atomic_file(tmp_path / "part-1") as part:
            part.write_text("whole")
            with pytest.raises(ValueError, match="must not be in use by another process"), asked.alone():
                pass
            assert part.exists()
    assert json.loads((tmp_path / "job.json").read_text())["terms"] == 3 and os.listdir(tmp_path).count("part-1") == 1


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


def kept(path: Path, name: str = "one") -> KeptWorkers:
    COUNTED.clear()
    return KeptWorkers(Workers(), Job("sums", {"name": name}, path), (Found,))


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
    name = Job("sums", {"name": "one"}).digest.encode()
    with (tmp_path / "parts").open("wb") as file:
        file.write(MAGIC)
        for one in (name, record):
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
