"""A line break in the name of a file begins no line of its own on the screen: it could say anything."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main

from pointing_analysis.indices.synthetic import write_bag

LIE = "bag is whole"
Command = Callable[[Path], list[str]]


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag whose folder has a line break in its name."""
    place = tmp_path_factory.mktemp("names") / f"night\n{LIE}"
    write_bag(place, {"truth/los": 1e-8 * np.random.default_rng(2).standard_normal((7000, 2))}, dt=1e-3)
    return place


@pytest.mark.further
@pytest.mark.parametrize(
    "command",
    [
        lambda bag: ["analyse", str(bag)],
        lambda bag: ["bag", "info", str(bag)],
        lambda bag: ["bag", "verify", str(bag)],
        lambda bag: ["bag", "topics", str(bag)],
        lambda bag: ["analyse", str(bag), "--los", "nothing"],
        lambda bag: ["report", str(bag), "--output", str(bag.parent / "page.html")],
    ],
)
def test_no_line_begins_with_the_rest_of_a_name(
    named: Path, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.suppress(SystemExit):
        main(command(named))
    shown = capsys.readouterr()
    lines = (shown.out + shown.err).splitlines()
    assert lines
    assert not any(line.strip().startswith(LIE) for line in lines), lines
