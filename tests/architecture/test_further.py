"""The tables of tests that `make test` leaves out and that other machines run name files that exist."""

from __future__ import annotations

import re
from pathlib import Path

from support.anywhere import ANYWHERE
from support.further import FURTHER

TESTS = Path(__file__).parents[1]


def test_every_file_exists_and_so_does_what_looks_at_the_same() -> None:
    assert [name for name in FURTHER if not (TESTS / name).is_file()] == []
    named = [path for reason in FURTHER.values() for path in re.findall(r"\w+/[\w/*]+\.py", reason)]
    assert len(named) > 10 and [path for path in named if not list(TESTS.glob(path))] == []
    assert not set(named) & set(FURTHER), "what looks at the same is in make test"


def test_files_for_other_machines_exist() -> None:
    assert [name for name in ANYWHERE if not (TESTS / name).is_file()] == []
