"""What is given twice counts once: a recording as several runs, a column as both axes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main


@pytest.fixture
def table(tmp_path: Path) -> Path:
    t = np.arange(2048) / 512.0
    rows = np.column_stack([t, *np.random.default_rng(0).standard_normal((2, t.size))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,x_mas,y_mas", comments="")
    return tmp_path / "a.csv"


def refused(capsys: pytest.CaptureFixture[str], *command: object) -> str:
    with pytest.raises(SystemExit) as stop:
        main([*map(str, command)])
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_a_recording_or_its_copy_is_no_further_run(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = table.with_name("b.csv")
    shutil.copy(table, copy)
    for second in (table, copy):
        assert "recordings must be different ones, got" in refused(capsys, "analyse", table, second)


def test_a_column_is_not_both_axes(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "los must be two different columns" in refused(capsys, "analyse", table, "--los", "x_mas,x_mas")
