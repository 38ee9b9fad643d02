"""Compiled code whose cache cannot be read is compiled anew."""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("numba", reason="compiled code needs numba")

MODULE = """from titop_plant.simulation.compiled import compiled


@compiled
def double(x):
    return 2.0 * x
"""


def doubled(folder: Path) -> str:
    code = "import sys; sys.path.insert(0, sys.argv[1]); from twice import double; print(double(2.0))"
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_an_index_with_a_type_that_is_gone_is_written_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upgrade in place may leave one behind that names a class of the version before."""
    (tmp_path / "twice.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    assert importlib.import_module("twice").double(2.0) == 4.0
    (index,) = tmp_path.rglob("*.nbi")
    with index.open("rb") as file:
        version = pickle.load(file)
    index.write_bytes(pickle.dumps(version) + b"ctwice\nGone\n.")
    assert doubled(tmp_path) == "4.0"
    assert b"Gone" not in index.read_bytes()
