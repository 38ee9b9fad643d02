"""A report as a PDF with text, vector figures and tables: set by typst (``pip install 'los-testbed[pdf]'``).

The layout is in ``report.typ``. It reads the content as data, so that no text of a recording is markup.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

from lftkit.support.atomic_output import atomic_file
from pointing_analysis.formatting.tables import Marked, TextTable
from pointing_analysis.report.content import ReportContent, ReportPart, ReportSection
from pointing_analysis.report.figures import Picture
from pointing_analysis.report.paper import PAPERS, Paper, require_pdf

TITLE = 0.4
"""Height of the title of a picture [inch], where the picture has its own width."""
LETTERS, SHORT, LONG = 100, 14, 60
"""Letters across a page; of a column of texts that is never broken; of one that has a larger share of the page than
others. In tables, where a letter is half as wide as it is high."""
TEMPLATE = Path(__file__).with_name("report.typ")


def write_pdf(content: ReportContent, path: Path, paper: Paper = "a4") -> None:
    """Write a report as PDF; an existing file is replaced, and nothing is left half-written.

    Parameters
    ----------
    content : of the report
    path : of the file
    paper : size of its pages

    Raises
    ------
    ValueError
        typst is not installed.
    """
    require_pdf()
    import typst

    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
    with tempfile.TemporaryDirectory() as name, atomic_file(path) as temporary:
        folder = Path(name)
        (folder / TEMPLATE.name).write_bytes(TEMPLATE.read_bytes())
        for picture in content.pictures:
            (folder / f"{picture.name}.svg").write_bytes(picture.svg)
        data = {
            "paper": PAPERS[paper],
            "title": content.title,
            "subtitle": content.subtitle,
            "overall": [{"label": label, **_cell(verdict)} for label, verdict in content.overall],
            "several": content.several,
            "verdict": _table(content.verdict),
            "warnings": [_part(part) for part in content.warnings],
            "leading": _columns(content.leading),
            "further": _columns(content.further),
            "missing": content.missing,
            "tables": _sections(content.tables),
            "notes": _sections(content.notes),
        }
        (folder / "report.json").write_text(json.dumps(data), "utf-8")
        made = typst.compile(
            str(folder / TEMPLATE.name), font_paths=[str(fonts)], ignore_system_fonts=True, format="pdf"
        )
        temporary.write_bytes(made)


def _columns(pictures: Sequence[Picture]) -> list[list[dict[str, str]]]:
    """Two columns of pictures: each one goes to the shorter column."""
    columns: list[list[dict[str, str]]] = [[], []]
    heights = [0.0, 0.0]
    for picture in pictures:
        k = heights.index(min(heights))
        columns[k].append({"file": f"{picture.name}.svg", "title": picture.title, "alt": picture.alt})
        heights[k] += picture.height + TITLE
    return columns if pictures else []


def _sections(sections: Sequence[ReportSection]) -> list[dict[str, Any]]:
    return [{"title": s.title, "note": s.note, "parts": [_part(part) for part in s.parts]} for s in sections]


def _part(part: ReportPart) -> dict[str, Any]:
    return {"title": part.title, "lines": part.lines, "table": None if part.table is None else _table(part.table)}


def _table(table: TextTable) -> dict[str, Any]:
    return {
        "heads": [column.title for column in table.columns],
        "number": [column.number for column in table.columns],
        "rows": [[_cell(cell) for cell in row] for row in table.rows],
        "widths": _widths(table),
    }


def _widths(table: TextTable) -> list[dict[str, Any]]:
    """Widths of the columns in letters: what their cells need, or a share of what is left; 0 for as they come."""
    longest, widths = [], []
    for k, column in enumerate(table.columns):
        cells = [row[k] for row in table.rows]
        longest.append(max(len(line) for cell in (column.title, *cells) for line in cell.split("\n")))
        word = max(map(len, column.title.split()), default=1)
        need = max(word, *(len(part) for cell in cells for part in cell.split(" ("))) if cells else word
        share = not column.number and need > SHORT
        widths.append({"share": share, "letters": max(word, min(need, LONG)) if share else need})
    return widths if sum(longest) + 3 * len(longest) > LETTERS else [{"share": False, "letters": 0}] * len(widths)


def _cell(text: str) -> dict[str, str]:
    return {"text": str(text), "mark": text.mark if isinstance(text, Marked) else ""}
