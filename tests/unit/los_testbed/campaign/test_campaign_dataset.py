"""Folder of a campaign: rows whole or not at all, resumed only for the same campaign."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import finished_row, metric_columns
from los_testbed.campaign.overview import campaign_summary
from los_testbed.campaign.page import write_page
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from support import axe, headless_browser

BASE = RunConfig(mode="inprocess")
TIME_METRICS = metric_columns("time", RunParts(BASE).telescope.requirements)


def campaign(**changes: Any) -> Campaign:
    given = {"base": BASE, "sampling": "uniform", "samples": 23, "seed": 1, "depth": "time"}
    return Campaign.of(**{**given, "identity": {"version": "1"}, **changes})


def rows(asked: Campaign, number: int, status: str = "ok") -> list[dict[str, Any]]:
    chunk = dict(asked.chunks())[number]
    values = dict.fromkeys(TIME_METRICS, 1.0)
    errors = {m["index"]: 20.0 + 5.0 * m["tau"] + 1e-3 * m["wheel_speed_2"] for m in chunk}
    return [
        finished_row(k, m, {**values, "rpe_window_p997_mas": errors[k]}, status, "")
        for k, m in zip(errors, chunk, strict=True)
    ]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"samples": 24}, "samples"),
        ({"seed": 2}, "seed"),
        ({"identity": {"version": "2"}}, "version"),
        ({"base": replace(BASE, loop="fsm")}, "loop"),
    ],
)
def test_folder_of_another_campaign_is_refused(change: dict[str, Any], key: str, tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path / "c")
    assert folder.open(campaign(), False) == frozenset()
    assert folder.open(campaign(), True) == frozenset()
    with pytest.raises(ValueError, match=f"one of the same campaign, got .*c, which holds another: {key} must be "):
        folder.open(campaign(**change), True)


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


def test_members_that_are_no_random_draws_have_no_probability(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked, folder = (
        campaign(base=replace(BASE, loop="fsm"), sampling="corners", samples=0),
        ResultFolder(tmp_path / "c"),
    )
    folder.open(asked, False)
    for number, _ in asked.chunks():
        folder.write(number, rows(asked, number))
    assert {v["interpretation"] for v in campaign_summary(asked, folder)["verdicts"]} == {"temporal"}


@pytest.mark.further
def test_the_page_shows_what_the_error_depends_on_and_axe_finds_nothing(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    asked, folder = campaign(samples=400), ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    for number, _ in asked.chunks():
        folder.write(number, rows(asked, number))
    page = write_page(asked, folder, campaign_summary(asked, folder), tmp_path / "report.html")
    text = page.read_text("utf-8")
    assert "Influence of the parameters on" in text and "Main effects of the most influential" in text
    if headless_browser.browser() is None:
        pytest.skip("no chromium on this machine")
    pytest.importorskip("axe_core_python")
    with headless_browser.Page() as browser:
        for scheme, width in (("light", 390), ("dark", 1280)):
            assert axe.findings(browser, page, width, scheme) == []
