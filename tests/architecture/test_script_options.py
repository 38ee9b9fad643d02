"""Scripts as they are called in the Makefile, in the pages and in their own texts have the options named there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
CALL = re.compile(r"\b((?:benchmarks|docs|tests/fuzz)/[a-z_]+\.py)((?:[^\n|;`]|\\\n)*)")
TEXTS = [
    ROOT / "Makefile",
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "benchmarks").glob("*.py")),
]


def calls() -> list[tuple[str, str, str]]:
    """(text, script, option) of every option that a call of a script names."""
    return [
        (text.name, script, option)
        for text in TEXTS
        for script, words in CALL.findall(text.read_text("utf-8"))
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", words)
    ]


def test_every_option_exists() -> None:
    named = sorted(set(calls()))
    assert [call for call in named if f'"{call[2]}"' not in (ROOT / call[1]).read_text("utf-8")] == []


def test_calls_of_the_makefile_are_among_them() -> None:
    assert ("Makefile", "benchmarks/campaign.py", "--members") in calls()
