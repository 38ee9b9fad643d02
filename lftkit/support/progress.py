"""One progress bar for every long computation."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any


class Progress:
    """Context with a progress bar on the error output: done, total, elapsed and remaining time.

    Without the package rich, which is optional, there is no bar, and lines are printed plainly.

    Parameters
    ----------
    what : str
        What is computed, before the bar.
    shown : bool
        Whether the bar is asked for; it is drawn on a terminal only.

    Examples
    --------
    >>> with Progress("tuning", shown=False) as bar:
    ...     bar.report(1, 3, best=0.97)
    """

    def __init__(self, what: str, shown: bool = True) -> None:
        self._what, self._shown = what, shown
        self._bar = _bar() if shown else None
        if self._bar is not None:
            self._task = self._bar.add_task(what, total=1.0)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def report(self, done: float, total: float, *, what: str = "", best: float | None = None) -> None:
        """Show `done` of `total`, with a part's name `what` and the best value so far where they are given."""
        text = (what or self._what) + ("" if best is None else f", best {best:.6g}")
        if self._bar is not None:
            self._bar.update(self._task, description=text, completed=done, total=total)

    def print(self, line: str) -> None:
        """Print a line that stays above the bar."""
        if self._bar is not None:
            self._bar.console.print(line, highlight=False, soft_wrap=True)
        elif self._shown:
            sys.stderr.write(line + "\n")


def _bar() -> Any:
    """The bar, drawn on a terminal only; None without rich."""
    try:
        from rich import progress
        from rich.console import Console
    except ImportError:
        return None
    console = Console(stderr=True)
    return progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
