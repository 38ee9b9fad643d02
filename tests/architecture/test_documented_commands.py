"""Every command line that a page prints is read by the program as it stands: command, options and their values."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.documented_commands import PAGES, Printed, parse, printed

EVERY = [one for page in PAGES for one in printed(page)]


def misunderstood(command: Printed) -> str:
    """What the program says of a command that it does not understand."""
    try:
        parse(command.words)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def test_the_program_understands_each() -> None:
    assert {str(one): error for one in EVERY if (error := misunderstood(one))} == {}


def test_commands_of_all_kinds_of_blocks_are_found(tmp_path: Path) -> None:
    """Fenced and indented, continued lines as one; Python and prose are none."""
    page = tmp_path / "page.md"
    page.write_text(
        "See\nlos-testbed no\n\n    los-testbed plant   # comment\n\n```sh\nA=1\nlos-testbed run --seed 1 \\\n"
        "    --loop fsm\n```\n\n```python\nlos-testbed no\n```\n"
    )
    found = printed(page)
    assert [(one.line, one.words) for one in found] == [(4, ["plant"]), (8, ["run", "--seed", "1", "--loop", "fsm"])]
    assert len(EVERY) > 100


@pytest.mark.parametrize(
    "line", ["run --k-fms x.json", "desing verify", "design verfy", "campaign --samples one", "bag sign"]
)
def test_mistakes_are_found(line: str) -> None:
    with pytest.raises(Exception, match=r"No such|invalid|valid integer|[Mm]issing|required"):
        parse(line.split())
