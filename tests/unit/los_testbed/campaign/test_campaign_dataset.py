"""Folder of a campaign: rows whole or not at all, resumed only for the same campaign."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import CHUNK, Campaign, ResultFolder
from los_testbed.campaign.member import finished_row, metric_columns
from los_testbed.campaign.overview import campaign_summary, metric_table
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts

BASE = RunConfig(mode="inprocess")
TIME_METRICS = metric_columns("time", RunParts(BASE).telescope.requirements)


def campaign(**changes: Any) -> Campaign:
    given = {
        "base": BASE,
        "sampling": "uniform",
        "samples": 23,
        "seed": 1,
        "depth": "time",
        "identity": {"version": "1"},
    }
    return Campaign.of(**{**given, **changes})


def rows(asked: Campaign, number: int, status: str = "ok") -> list[dict[str, Any]]:
    chunk = dict(asked.chunks())[number]
    values = dict.fromkeys(TIME_METRICS, 1.0)
    return [finished_row(m["index"], m, {**values, "rpe_window_p997_mas": 1.0 + m["index"]}, status, "") for m in chunk]


def test_chunks_hold_all_members_once() -> None:
    asked = campaign()
    chunks = dict(asked.chunks())
    assert [len(chunks[k]) for k in sorted(chunks)] == [10, 10, 3] and CHUNK["time"] == 10
    assert [m["index"] for k in sorted(chunks) for m in chunks[k]] == list(range(23))
    assert [number for number, _ in asked.chunks(frozenset({0, 2}))] == [1]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"samples": 24}, "samples"),
        ({"seed": 2}, "seed"),
        ({"depth": "model"}, "depth"),
        ({"sampling": "lhs"}, "sampling"),
        ({"identity": {"version": "2"}}, "version"),
        ({"identity": {"version": "1", "telescope": "2"}}, "telescope"),
        ({"base": replace(BASE, loop="fsm")}, "loop"),
    ],
)
def test_folder_of_another_campaign_is_refused(change: dict[str, Any], key: str, tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path / "c")
    assert folder.open(campaign(), False) == frozenset()
    assert folder.open(campaign(), True) == frozenset()
    with pytest.raises(
        ValueError,
        match=f"one of the same campaign, got .*c, which holds another: {key} must be ",
    ):
        folder.open(campaign(**change), True)


def test_folders_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="output must be a new folder, or --resume given"):
        ResultFolder(tmp_path).open(campaign(), False)
    with pytest.raises(ValueError, match=r"must be the folder of a campaign: campaign\.json: No such file"):
        ResultFolder(tmp_path).open(campaign(), True)
    (tmp_path / "campaign.json").write_text("[1]", "utf-8")
    with pytest.raises(ValueError, match=r"campaign\.json must be an object, got list"):
        ResultFolder(tmp_path).open(campaign(), True)
    (tmp_path / "campaign.json").write_text("{", "utf-8")
    with pytest.raises(ValueError, match=r"campaign\.json is not JSON"):
        ResultFolder(tmp_path).open(campaign(), True)
    with pytest.raises(ValueError, match="depth must be one of time, model, got 'deep'"):
        campaign(depth="deep")


def test_rows_come_back_in_order_and_partial_files_are_forgotten(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked, folder = campaign(), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    for number in (2, 0):
        folder.write(number, rows(asked, number))
    (folder.path / "rows" / ".part-0000001.parquet.0123abcd").write_bytes(b"half")
    assert folder.open(asked, True) == {0, 2}
    with folder.alone():
        assert not list((folder.path / "rows").glob(".*"))
    expected = rows(asked, 0) + rows(asked, 2)
    assert folder.table().to_pylist() == expected
    first = folder.rows_hash()
    folder.write(1, rows(asked, 1))
    assert folder.rows_hash() != first and folder.table().num_rows == 23


def test_a_folder_that_another_process_writes_to_is_refused(tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path / "c")
    folder.open(campaign(), False)
    with folder.alone():
        partial = folder.path / "rows" / ".part-0000001.parquet.0123abcd"
        partial.write_bytes(b"half")
        with pytest.raises(ValueError, match="c must not be in use by another process, got one that is"):
            ResultFolder(folder.path).check(True)
        assert partial.exists()
    ResultFolder(folder.path).check(True)


def test_a_part_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    asked, folder = campaign(), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        folder.write(0, rows(asked, 0))
    assert list((folder.path / "rows").iterdir()) == []


def test_parts_with_crashed_members_or_that_cannot_be_read_are_computed_again(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked, folder = campaign(), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    for number, status in enumerate(("failed", "crashed", "ok")):
        folder.write(number, rows(asked, number, status))
    (folder.path / "rows" / "part-0000002.parquet").write_bytes(b"PAR1")
    assert folder.open(asked, True) == {0}


def test_parts_of_another_campaign_are_computed_again_or_refused(tmp_path: Path) -> None:
    """Copied into the folder by hand: of other members, of fewer; beyond the last one."""
    pytest.importorskip("pyarrow")
    asked, folder = campaign(), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    folder.write(0, rows(campaign(seed=2), 0))
    folder.write(1, rows(asked, 1)[:9])
    folder.write(2, rows(asked, 2))
    assert folder.open(asked, True) == {2}
    folder.write(3, rows(asked, 1))
    with pytest.raises(ValueError, match=r"must hold parts 0 to 2 of its campaign, got part-0000003\.parquet"):
        folder.open(asked, True)


def test_summary_ranks_the_members(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked, folder = campaign(), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    for number in range(2):
        folder.write(number, rows(asked, number))
    folder.write(2, [*rows(asked, 2)[:2], *rows(asked, 2, "diverged")[2:]])
    summary = json.loads(json.dumps(campaign_summary(asked, folder, 3)))
    assert summary["status"] == {"diverged": 1, "ok": 22} and summary["members"] == 23
    assert [m["index"] for m in summary["worst"]] == [22, 21, 20]
    assert summary["metrics"]["rpe_window_p997_mas"] == {
        "members": 23,
        "q0.5": 12.0,
        "q0.9": 20.8,
        "q0.99": 22.78,
        "q1": 23.0,
    }
    assert "--duration 10 --loop fsm+pma --scenario worst_case" in summary["worst"][0]["command"]
    assert len(metric_table(summary).rows) == len(summary["metrics"])
