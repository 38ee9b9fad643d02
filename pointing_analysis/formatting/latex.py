r"""A table as LaTeX: a ``tabular`` to include in a document with ``\usepackage{booktabs,array}``."""

from __future__ import annotations

import re

from pointing_analysis.formatting.tables import Heading, TextTable

LINE, SMALL_LINE = 85, 115
"""Letters of a LaTeX table across a page, and of one whose letters are small."""
LONG, SHORT, MOST = 26, 12, 60
"""Letters from which a column of texts wraps its lines; the same in small letters; those that give it its width."""
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
    '"': "''",
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


def latex_table(table: TextTable) -> str:
    """A ``tabular`` with the rules of booktabs, at most as wide as a page: long texts wrap, wide tables are small.

    Its first lines are comments: the title of the table, and the packages that the document needs.
    """
    letters = [_letters(table, k) for k in range(len(table.columns))]
    small = sum(letters) > LINE
    heads = [_head(column, table, k) for k, column in enumerate(table.columns)]
    lines = [" & ".join(row) + r" \\" for row in (heads, *([_cell(cell) for cell in row] for row in table.rows))]
    lines = [
        f"% {_CONTROL.sub(' ', table.title)}".replace("\n", " ").rstrip(),
        r"% \usepackage{booktabs,array}",
        *([r"{\footnotesize\setlength{\tabcolsep}{3pt}%"] if small else []),
        rf"\begin{{tabular}}{{{_specification(table, letters, small)}}}",
        r"\toprule",
        lines[0],
        r"\midrule",
        *lines[1:],
        r"\bottomrule",
        r"\end{tabular}" + "}" * small,
    ]
    return "\n".join(lines) + "\n"


def _longest(table: TextTable, column: int) -> int:
    """Letters of the longest line of the cells of a column."""
    return max((len(line) for row in table.rows for line in row[column].split("\n")), default=0)


def _letters(table: TextTable, column: int) -> int:
    """Letters that a column is wide; a heading of numbers may have several lines."""
    heading = table.columns[column]
    words = heading.title.split() if heading.number else [heading.title]
    return max(_longest(table, column), *map(len, words), 1)


def _specification(table: TextTable, letters: list[int], small: bool) -> str:
    """Sides of the columns; those that wrap have a part of the width that the others leave."""
    (line, gap), longest = ((SMALL_LINE, 0.014), SHORT) if small else ((LINE, 0.027), LONG)
    broken = [any("\n" in row[k] for row in table.rows) for k in range(len(letters))]
    wrapped = [not c.number and (n > longest or cut) for c, n, cut in zip(table.columns, letters, broken)]
    weights = [min(n, MOST) if wrap else 0 for n, wrap in zip(letters, wrapped)]
    plain = sum(n for n, wrap in zip(letters, wrapped) if not wrap)
    space = max(0.3, 1.0 - gap * len(letters) - plain / line)
    columns = []
    for column, weight in zip(table.columns, weights):
        width = rf">{{\raggedright\arraybackslash}}p{{{space * weight / max(sum(weights), 1):.2f}\linewidth}}"
        columns.append(width if weight else "r" if column.number else "l")
    return "".join(columns)


def _head(heading: Heading, table: TextTable, column: int) -> str:
    """A heading; of numbers in several lines where it is longer than they are."""
    words = [_cell(word) for word in heading.title.split()]
    if heading.number and len(words) > 1 and len(heading.title) > _longest(table, column):
        return r"\shortstack[r]{" + r"\\".join(words) + "}"
    return _cell(heading.title)


def _cell(text: str) -> str:
    r"""A text in which every character of LaTeX's own is itself.

    Examples
    --------
    >>> print(_cell("50 % of a_b & c--d"))
    50 \% of a\_b \& c-{}-d
    """
    shown = "".join(_LATEX.get(c, c) for c in _CONTROL.sub(" ", text).replace("--", "-\0-")).replace("\0", "{}")
    return "{}" + shown if shown[:1] in ("[", "*") else shown  # behind a line's end they would be its options
