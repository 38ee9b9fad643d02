"""Rows of requirements as a reader finds them on the screen, on the page, in JSON and in Markdown."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from los_testbed.run.summary.summary import print_summary, summarise_runs
from rich.console import Console

from pointing_analysis.read.series import Series
from pointing_analysis.report import report
from pointing_analysis.requirements.verdict import Requirement


class _Page(HTMLParser):
    """Cells of the table of requirements by their label, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[dict[str, str]] = []
        self.label = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        label = dict(attrs).get("data-label")
        if tag == "tr":
            self.rows.append({})
        if tag == "td":
            self.label = label or ""
        if tag == "br" and self.label:
            self.rows[-1][self.label] += "\n"

    def handle_endtag(self, tag: str) -> None:
        if tag == "td":
            self.label = ""

    def handle_data(self, data: str) -> None:
        if self.label:
            self.rows[-1][self.label] = self.rows[-1].get(self.label, "") + data


def page_rows(page: str) -> list[dict[str, str]]:
    """Rows of the table of requirements of a page, cells by their headings."""
    part = page[page.index('id="requirements"') :]
    part = part[: part.index("</table>") if "<table" in part[: part.index("</section>")] else part.index("</section>")]
    found = _Page()
    found.feed(part)
    return [row for row in found.rows if row]


def screen_rows(text: str) -> list[list[list[str]]]:
    """Cells of each table of the screen: table, row, cell."""
    tables: list[list[list[str]]] = []
    for line in text.splitlines():
        if line.startswith("┏"):
            tables.append([])
        if line.startswith("│"):
            tables[-1].append([cell.strip() for cell in line.strip("│").split("│")])
    return tables


def outputs(
    runs: Sequence[Series], requirements: Sequence[Requirement], page: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[list[list[str]]], list[dict[str, str]], list[dict[str, Any]]]:
    """Tables of the screen, rows of the page (without its pictures), JSON object of each run."""
    monkeypatch.setattr(report, "pictures", lambda *args: ([], []))
    results = summarise_runs(list(runs), page, 0.0, requirements=requirements)
    stream = io.StringIO()
    print_summary(Console(file=stream, width=400), results)
    return screen_rows(stream.getvalue()), page_rows(page.read_text()), list(results.runs)
