"""Lines on the screen that say names and paths of others as they are."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


def say(console: Console, text: str, label: str = "") -> None:
    """Print a line as it is: square brackets in names are no markup. A label stands before it, coloured."""
    line = Text(f"{label}: ", style="yellow") if label else Text()
    console.print(line + Text(text), soft_wrap=True, highlight=False)
