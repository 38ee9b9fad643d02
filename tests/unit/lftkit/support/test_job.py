"""Jobs: what makes two the same, what a folder may hold, and what is left of an interrupted one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lftkit.support.atomic_output import atomic_file
from lftkit.support.job import Job


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
