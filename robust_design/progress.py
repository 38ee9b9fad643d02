"""A progress line that costs nothing when it is off."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.status import Status


class Progress:
    """Context that shows ``what: done/total, best value`` on the terminal while `shown`."""

    def __init__(self, shown: bool, what: str) -> None:
        self._what = what
        self._console = Console(stderr=True)
        self._status: Status | None = self._console.status(what) if shown else None

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._status is not None:
            self._status.stop()

    def report(self, done: int, total: int, best: float) -> None:
        """Show that `done` of `total` parts are finished with this best value."""
        if self._status is not None:
            self._status.update(f"{self._what}: {done}/{total}, best {best:.6g}")

    def say(self, line: str) -> None:
        """Print a line that stays."""
        if self._status is not None:
            self._console.print(line, highlight=False, soft_wrap=True)
