"""How every long computation shows that it goes on: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

import math
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

FIRST_S = 1.5
"""Time until the first line, where there is no terminal: what is over sooner says nothing. Of a program that has chosen
its output it counts from there, so that its imports are in it."""


@dataclass
class ProgressOutput:
    """Where progress goes; one for a process (:func:`choose_output`).

    Parameters
    ----------
    quiet : bool
        No bar and no lines on the error output.
    interval : float
        Time between two lines [s].
    log : Path, optional
        File that gets the lines, with the time of day, at its end; also when quiet.
    due : float
        When the next line is due at the latest, by the monotonic clock [s], whichever context is shown then.
    """

    quiet: bool = False
    interval: float = 10.0
    log: Path | None = None
    due: float = math.inf


_output = ProgressOutput()
_active: list[Progress] = []


def choose_output(*, quiet: bool = False, interval: float = 10.0, log: Path | None = None) -> None:
    """Choose where progress goes from now on, in this process; fields of :class:`ProgressOutput`.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    if log is not None:
        with log.open("a"):
            pass
    _output.quiet, _output.interval, _output.log = quiet, interval, log
    _output.due = time.monotonic() + FIRST_S


def write_log(line: str) -> None:
    """A line with the time of day at the end of the log, if one was chosen."""
    if _output.log is not None:
        with _output.log.open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {line}\n")


class Progress:
    """Context that shows done, total and elapsed time of a computation on the error output.

    On a terminal it is a bar (without the package rich, which is optional, lines as elsewhere); elsewhere a line after
    :data:`FIRST_S` and then one every ten seconds (:func:`choose_output`), also where contexts follow each other sooner
    than that. A context inside another one is shown in its place.

    Parameters
    ----------
    what : str
        What is computed, before the numbers.
    shown : bool
        Whether anything is shown.
    equal : bool
        Whether its parts take equal times. Only then is the remaining time shown: of others it is not known.

    Examples
    --------
    >>> with Progress("tuning", shown=False) as bar:
    ...     bar.report(1, 3, best=0.97)
    """

    def __init__(self, what: str, shown: bool = True, equal: bool = False) -> None:
        self._what, self._text, self._shown, self._equal = what, what, shown, equal
        self._done, self._total = 0.0, 0.0
        self._first = (0.0, 0.0)  # time and amount from which the rate is counted
        self._bar: Any = None
        self._said = False  # whether it has written a line
        self._ended = threading.Event()
        self._lines: threading.Thread | None = None
        self._start = time.monotonic()

    def __enter__(self) -> Progress:
        self._start, self._said = time.monotonic(), False
        if self._shown:
            if _active:
                _active[-1]._hide()
            _active.append(self)
            self._show()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._shown:
            self._hide()
            _active.remove(self)
            if _active:
                _active[-1]._show()
            else:
                _output.due = math.inf  # until another computation begins nothing is due

    def report(self, done: float, total: float, *, what: str = "", best: float | None = None) -> None:
        """Show `done` of `total`, with a part's name `what` and the best value so far where they are given."""
        self._text = (what or self._what) + ("" if best is None else f", best {best:.6g}")
        if float(total) != self._total:
            self._first = (time.monotonic(), float(done))
        self._done, self._total = float(done), float(total)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], description=self._text, completed=done, total=total)

    def print(self, line: str) -> None:
        """Print a line that stays above the bar."""
        if not self._shown:
            return
        write_log(line)
        if self._bar is not None:
            self._bar.console.print(line, highlight=False, soft_wrap=True, markup=False)
        elif not _output.quiet:
            sys.stderr.write(line + "\n")
            sys.stderr.flush()

    def _show(self) -> None:
        drawn = None if _output.quiet else _bar(sys.stderr, self._equal)
        if drawn is not None:
            drawn.add_task(self._text, total=self._total or None, completed=self._done)
            drawn.start()
        self._bar = drawn
        if (drawn is None and not _output.quiet) or _output.log is not None:
            self._ended = threading.Event()
            self._lines = threading.Thread(target=self._write_lines, args=(self._ended,), daemon=True)
            self._lines.start()

    def _hide(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        if self._lines is not None:
            self._ended.set()
            self._lines.join()
            self._lines = None

    def _write_lines(self, ended: threading.Event) -> None:
        first = math.inf if self._said else self._start + FIRST_S
        while not ended.wait(max(min(first, _output.due) - time.monotonic(), 0.0)):
            first, self._said = math.inf, True
            _output.due = time.monotonic() + _output.interval
            line = self._line(time.monotonic() - self._start)
            write_log(line)
            if self._bar is None and not _output.quiet:
                sys.stderr.write(line + "\n")
                sys.stderr.flush()

    def _line(self, elapsed: float) -> str:
        """The numbers in words."""
        if not self._total:
            return f"{self._text}: {elapsed:.0f} s"
        since, before = self._first
        passed, left = time.monotonic() - since, ""
        if self._equal and self._done > before:
            left = f", about {passed * (self._total - self._done) / (self._done - before):.0f} s left"
        return f"{self._text}: {self._done:.0f} of {self._total:.0f}, {elapsed:.0f} s{left}"


def _bar(stream: TextIO, equal: bool) -> Any:
    """The bar, with the remaining time of `equal` parts; None without rich or where there is no terminal."""
    try:
        from rich import progress
        from rich.console import Console
    except ImportError:
        return None
    console = Console(file=stream)
    if not console.is_terminal:
        return None
    return progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        *([progress.TimeRemainingColumn()] if equal else []),
        console=console,
        transient=True,
    )
