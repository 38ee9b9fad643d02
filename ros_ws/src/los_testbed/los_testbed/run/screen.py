"""Lines on the screen that say names and paths of others as they are."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


def printable(text: str) -> str:
    r"""The text with characters that would control the terminal spelled out; lines stay lines.

    Examples
    --------
    >>> print(printable("red" + chr(27) + "[31m"))
    red\x1b[31m
    """
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def say(console: Console, text: str, label: str = "") -> None:
    """Print a line as it is: square brackets in names are no markup. A label stands before it, coloured."""
    line = Text(f"{label}: ", style="yellow") if label else Text()
    console.print(line + Text(printable(text)), soft_wrap=True, highlight=False)
