"""The command lines of `los-testbed` that the pages print, as a reader would paste them."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from los_testbed.cli.app import command_line, with_common_options_first
from los_testbed.cli.run import with_lone_options

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
SHELL = ("sh", "bash", "text")
"""Languages of blocks whose lines may be commands."""


@dataclass(frozen=True)
class Printed:
    """A command line of a page.

    Parameters
    ----------
    page : str
        Name of the file.
    line : int
        Where it begins.
    text : str
        Without the lines' continuation signs.
    """

    page: str
    line: int
    text: str

    @property
    def words(self) -> list[str]:
        """Arguments behind the program, without a comment."""
        return shlex.split(self.text, comments=True)[1:]

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(text: str, language: str) -> list[str]:
    """Contents of the fenced blocks of a language in a text."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def printed(page: Path) -> list[Printed]:
    """Commands in the blocks of a page, fenced or indented, with their continued lines."""
    found: list[Printed] = []
    fence: str | None = None
    open_line, begin = "", 0
    for number, line in enumerate(page.read_text("utf-8").splitlines(), start=1):
        if match := re.match(r"\s*```(\w*)", line):
            fence = match[1] if fence is None else None
            continue
        if not (line.startswith("    ") if fence is None else fence in SHELL):
            open_line = ""
            continue
        begin = begin if open_line else number
        whole = open_line + line.strip()
        open_line = whole[:-1] + " " if whole.endswith("\\") else ""
        if not open_line and (command := re.match(r"(?:\.venv/bin/)?(los-testbed\s.*)", whole)):
            found.append(Printed(page.name, begin, command[1]))
    return found


def parse(words: list[str]) -> None:
    """Read a command line as the program does, down to the types of its values; nothing is run.

    Raises
    ------
    Exception
        Of click or typer: an unknown command or option, a value that does not fit.
    """
    command: Any = command_line()
    name, context = "los-testbed", None
    rest = list(with_common_options_first(with_lone_options(words)))
    while True:
        context = command.make_context(name, rest, parent=context)
        if not hasattr(command, "commands"):
            return
        further = [*context._protected_args, *context.args]
        if not further:
            return
        name, command, rest = command.resolve_command(context, further)
