"""A table of texts, and the same cells as Markdown, HTML, CSV and JSON.

Whoever has something to tabulate makes a :class:`TextTable`. LaTeX is made of it by
:mod:`pointing_analysis.formatting.latex`, the terminal's table by :func:`pointing_analysis.command.screen.on_screen`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

from lftkit.errors import InputError


class Marked(str):
    """Text of a cell with a mark: ``ok``, ``within``, ``bad`` or ``open``: its colour or sign."""

    __slots__ = ("mark",)
    mark: str

    def __new__(cls, text: str, mark: str) -> Marked:
        """A text with its mark."""
        made = super().__new__(cls, text)
        made.mark = mark
        return made


@dataclass(frozen=True)
class Heading:
    """Heading of a column; `number`: of numbers, aligned on the right; `name`: a name, which keeps its letters."""

    head: str
    number: bool = False
    name: bool = False

    @property
    def title(self) -> str:
        """The heading with a capital, unless it is a symbol, a unit or a name.

        Examples
        --------
        >>> [Heading(head).title for head in ("verdict", "rms RPE", "rad/s", "x [mas]")]
        ['Verdict', 'rms RPE', 'rad/s', 'x [mas]']
        """
        word = not self.name and re.match(r"(?!rms)[a-z]{3,}(?![\w/])", self.head)
        return self.head[:1].upper() + self.head[1:] if word else self.head


def texts(*heads: str) -> tuple[Heading, ...]:
    """Columns of texts."""
    return tuple(Heading(head) for head in heads)


def numbers(*heads: str) -> tuple[Heading, ...]:
    """Columns of numbers."""
    return tuple(Heading(head, number=True) for head in heads)


@dataclass(frozen=True)
class TextTable:
    """Texts in rows.

    Parameters
    ----------
    columns : (n,) headings
    rows : (m, n) texts, some of them :class:`Marked`; a line break stays one
    title : what the table is of
    name : of its file
    classes : (m,) classes of the rows in HTML, or none

    Raises
    ------
    ValueError
        A row has not one cell for each column.
    """

    columns: tuple[Heading, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    name: str = ""
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(f"a row must have {len(self.columns)} cells, got {len(row)}: {row}")

    @classmethod
    def of(
        cls, heads: Iterable[str | Heading], rows: Iterable[Sequence[str]], title: str = "", **options: Any
    ) -> TextTable:
        """A table with these headings, plain ones of texts; `options` are further attributes."""
        columns = tuple(head if isinstance(head, Heading) else Heading(head) for head in heads)
        return cls(columns, tuple(tuple(row) for row in rows), title, **options)

    @property
    def heads(self) -> tuple[str, ...]:
        """Headings."""
        return tuple(column.head for column in self.columns)

    def only(self, *heads: str) -> TextTable:
        """Some of the columns, in this order."""
        places = [self.heads.index(head) for head in heads]
        rows = tuple(tuple(row[k] for k in places) for row in self.rows)
        return replace(self, columns=tuple(self.columns[k] for k in places), rows=rows)

    def markdown(self) -> str:
        r"""Lines of Markdown, without the title.

        Examples
        --------
        >>> print(TextTable.of((*texts("index"), *numbers("limit")), [("|APE|", "10 arcsec")]).markdown())
        | index | limit |
        | --- | ---: |
        | \|APE\| | 10 arcsec |
        """
        rule = ["---:" if column.number else "---" for column in self.columns]
        body = [[cell.replace("|", "\\|").replace("\n", "<br>") for cell in row] for row in (self.heads, *self.rows)]
        return "\n".join(f"| {' | '.join(line)} |" for line in (body[0], rule, *body[1:]))

    def csv(self) -> str:
        """Comma-separated values with a line of headings (RFC 4180, lines end with a line feed)."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows((self.heads, *self.rows))
        return stream.getvalue()

    def html(self, css: str = "", caption: bool = False) -> str:
        """A table element, with its title as `caption` or not; cells have their headings as ``data-label``."""
        heads = "".join(f'<th scope="col"{_css(c)}>{escape(c.title)}</th>' for c in self.columns)
        body = []
        for k, row in enumerate(self.rows):
            cells = [_html(column, cell) for column, cell in zip(self.columns, row)]
            start = f'<tr class="{escape(self.classes[k])}">' if self.classes else "<tr>"
            body.append(f"{start}{''.join(cells)}</tr>\n")
        start = f'<table class="{escape(css)}">' if css else "<table>"
        start += f"<caption>{escape(self.title)}</caption>" if caption else ""
        return f"{start}<thead><tr>{heads}</tr></thead>\n<tbody>{''.join(body)}</tbody></table>"


def _html(column: Heading, text: str) -> str:
    shown = escape(text).replace("\n", "<br>")
    if isinstance(text, Marked):
        shown = f'<span class="mark {escape(text.mark)}">{shown}</span>'
    return f'<td data-label="{escape(column.title)}"{_css(column)}>{shown}</td>'


def _css(column: Heading) -> str:
    return ' class="n"' if column.number else ""
