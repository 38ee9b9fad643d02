"""Terminal output: foreign names and paths are printed literally."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from rich import table as rich_table
from rich.console import Console
from rich.text import Text

from pointing_analysis.formatting.tables import Marked, TextTable


def printable(text: str) -> str:
    r"""The text on one line, with characters that would control the terminal or begin a line spelled out.

    Examples
    --------
    >>> print(printable("red" + chr(27) + "[31m" + chr(10) + "bag is whole"))
    red\x1b[31m\nbag is whole
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def printable_lines(text: str) -> str:
    """The same of several lines, which stay lines."""
    return "\n".join(map(printable, text.split("\n")))


class Screen(Console):
    r"""A console for which square brackets are no markup and ``:x:`` is no emoji, in lines, tables and titles.

    Parameters
    ----------
    stderr : bool
        Print to the error output.

    Examples
    --------
    >>> Screen().print("bags/[/red]:x:" + chr(7))
    bags/[/red]:x:\x07
    """

    def __init__(self, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:  # type: ignore[override]
        """A text as it is shown; lines stay lines."""
        return super().render_str(printable_lines(text), **options)


STYLES = {"ok": "green", "within": "green", "bad": "red"}
"""Colours of marked cells."""


def on_screen(table: TextTable, whole: tuple[str, ...] = (), **options: Any) -> rich_table.Table:
    """A table for the terminal; :class:`Screen` spells out what would control it.

    Parameters
    ----------
    table : TextTable
    whole : tuple of str
        Headings of columns whose cells are never broken, for instance because they are to be copied.
    **options
        Of :class:`rich.table.Table`.
    """
    title = Text(printable(table.title), style="table.title") if table.title else None
    shown = rich_table.Table(title=title, title_justify="left", **options)
    for column in table.columns:
        justify: Any = "right" if column.number else "left"
        shown.add_column(column.head, justify=justify, overflow="fold", no_wrap=column.head in whole)
    for row in table.rows:
        shown.add_row(*map(marked, row))
    return shown


def marked(cell: str) -> Text:
    """A cell in the colour of its mark."""
    return Text(printable_lines(cell), style=STYLES.get(cell.mark, "") if isinstance(cell, Marked) else "")


def met(requirement: bool) -> Marked:
    """Cell of a table."""
    return Marked("met", "open") if requirement else Marked("not met", "bad")


def tell(line: str) -> None:
    """Write a line to the error output."""
    sys.stderr.write(f"{printable(line)}\n")


def warn(lines: Iterable[str]) -> None:
    """Write warnings to the error output, one line each."""
    sys.stderr.writelines(f"warning: {printable(line)}\n" for line in lines)


def say(console: Console, text: str, label: str = "") -> None:
    """Print a line as it is: square brackets in names are no markup. A label stands before it, coloured."""
    line = Text(f"{label}: ", style="yellow") if label else Text()
    console.print(line + Text(printable(text)), soft_wrap=True, highlight=False)
