"""What is printed: names and paths of others as they are, whatever they look like."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Column
from rich.text import Text


def printable(text: str) -> str:
    r"""The text on one line, with characters that would control the terminal or begin a line spelled out.

    Examples
    --------
    >>> print(printable("red" + chr(27) + "[31m" + chr(10) + "bag is whole"))
    red\x1b[31m\nbag is whole
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


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
        return super().render_str("\n".join(map(printable, text.split("\n"))), **options)


def numbers(*heads: str, **options: Any) -> list[Column]:
    """Columns of numbers for a table, each with its head; further options are those of :class:`rich.table.Column`."""
    return [Column(head, justify="right", **options) for head in heads]


def met(requirement: bool) -> Text:
    """Cell of a table."""
    return Text("met") if requirement else Text("not met", style="red")


def say(console: Console, text: str, label: str = "") -> None:
    """Print a line as it is: square brackets in names are no markup. A label stands before it, coloured."""
    line = Text(f"{label}: ", style="yellow") if label else Text()
    console.print(line + Text(printable(text)), soft_wrap=True, highlight=False)
