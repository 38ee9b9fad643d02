"""A table of texts, and the same cells as Markdown, HTML, LaTeX, CSV and JSON.

Whoever has something to tabulate makes a :class:`TextTable`; each output is a method of it, so that none can say what
another does not. The terminal's is :func:`los_testbed.run.summary.screen.on_screen`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

LONG = 26
"""Characters of a cell from which a column of a LaTeX table wraps its lines."""
TEXT_WIDTH = 0.9
"""Of a page, for the columns of a LaTeX table whose lines wrap."""
_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "–": "--",
    "−": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "≤": r"$\le$",
    "≥": r"$\ge$",
    "µ": r"\textmu{}",
    "μ": r"\textmu{}",
    "²": r"\textsuperscript{2}",
    "…": r"\ldots{}",
    "\n": r"\newline ",
}
_CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f]")


class Marked(str):
    """Text of a cell with a mark: ``ok``, ``kept``, ``bad`` or ``open``; a colour, a sign where an output has them."""

    __slots__ = ("mark",)
    mark: str

    def __new__(cls, text: str, mark: str) -> Marked:
        """A text with its mark."""
        made = super().__new__(cls, text)
        made.mark = mark
        return made


@dataclass(frozen=True)
class Heading:
    """Heading of a column; `number`: its cells are numbers, aligned on the right."""

    head: str
    number: bool = False

    @property
    def title(self) -> str:
        """The heading with a capital, unless it is a symbol or a unit.

        Examples
        --------
        >>> [Heading(head).title for head in ("verdict", "rms RPE", "rad/s", "x [mas]")]
        ['Verdict', 'rms RPE', 'rad/s', 'x [mas]']
        """
        return self.head[:1].upper() + self.head[1:] if re.match(r"(?!rms)[a-z]{3,}(?![\w/])", self.head) else self.head


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
                raise ValueError(f"a row must have {len(self.columns)} cells, got {len(row)}: {row}")

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
        body = [[_markdown_cell(cell) for cell in row] for row in (self.heads, *self.rows)]
        return "\n".join(f"| {' | '.join(line)} |" for line in (body[0], rule, *body[1:]))

    def csv(self) -> str:
        """Comma-separated values with a line of headings (RFC 4180, lines end with a line feed)."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows((self.heads, *self.rows))
        return stream.getvalue()

    def as_dicts(self) -> list[dict[str, str]]:
        """The rows for JSON, cells by their headings."""
        return [{head: str(cell) for head, cell in zip(self.heads, row)} for row in self.rows]

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

    def latex(self) -> str:
        r"""A ``tabular`` with the rules of booktabs; columns with long texts wrap their lines.

        The document needs ``\usepackage{booktabs,array}``.
        """
        long = [max((len(row[k]) for row in self.rows), default=0) for k in range(len(self.columns))]
        wrapped = [n > LONG or any("\n" in row[k] for row in self.rows) for k, n in enumerate(long)]
        weights = [min(n, 3 * LONG) for n, wrap in zip(long, wrapped) if wrap]
        plain = sum(n for n, wrap in zip(long, wrapped) if not wrap)
        space = TEXT_WIDTH * sum(weights) / max(sum(weights) + plain, 1)
        shares = iter([space * weight / sum(weights) for weight in weights])
        spec = "".join(
            rf">{{\raggedright\arraybackslash}}p{{{next(shares):.2f}\linewidth}}" if wrap else "r" if c.number else "l"
            for c, wrap in zip(self.columns, wrapped)
        )
        lines = [" & ".join(_latex_cell(cell) for cell in row) + r" \\" for row in self.rows]
        heads = " & ".join(_latex_cell(c.title) for c in self.columns) + r" \\"
        first = [f"% {_CONTROL.sub(' ', self.title)}".replace("\n", " ")] if self.title else []
        return "\n".join(
            [*first, r"% \usepackage{booktabs,array}", rf"\begin{{tabular}}{{{spec}}}", r"\toprule", heads, r"\midrule"]
            + [*lines, r"\bottomrule", r"\end{tabular}", ""]
        )


def _markdown_cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", "<br>")


def _html(column: Heading, text: str) -> str:
    shown = escape(text).replace("\n", "<br>")
    if isinstance(text, Marked):
        shown = f'<span class="mark {escape(text.mark)}">{shown}</span>'
    return f'<td data-label="{escape(column.title)}"{_css(column)}>{shown}</td>'


def _css(column: Heading) -> str:
    return ' class="n"' if column.number else ""


def _latex_cell(text: str) -> str:
    r"""A text in which every character of LaTeX's own is itself.

    Examples
    --------
    >>> print(_latex_cell("50 % of a_b & c--d"))
    50 \% of a\_b \& c-{}-d
    """
    shown = "".join(_LATEX.get(c, c) for c in _CONTROL.sub(" ", text).replace("--", "-\0-")).replace("\0", "{}")
    return "{}" + shown if shown[:1] in ("[", "*") else shown  # behind a line's end they would be its options
