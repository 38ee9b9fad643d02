"""The list of commands is made without them, and says what they say of themselves."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import typer
from los_testbed.cli.app import app
from los_testbed.cli.command_group import ENTRIES, loaded


@pytest.mark.parametrize("name", ENTRIES)
def test_the_list_says_the_first_paragraph_of_a_command(name: str) -> None:
    command = loaded(name)
    about = (command.help or "").split("\n\n")[0]
    assert " ".join(about.split()) == ENTRIES[name].about and command.name == name


def test_the_help_imports_no_command() -> None:
    code = (
        "import sys; from los_testbed.cli.app import main; main(['--help']);"
        "print('imported', sorted({'numpy', 'scipy', 'pydantic', 'los_testbed.cli.run'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "imported []"
    assert all(f" {name} " in done.stdout for name in ENTRIES)


def test_commands_are_those_of_the_entries() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert list(commands) == list(ENTRIES) and commands.get("nothing") is None
    assert commands["design"].commands.keys() >= {"all", "verify", "certify", "check-proof"}
    assert commands["bag"].commands.keys() >= {"repair", "topics", "info", "verify", "sign"}
    assert [command.name for command in commands.values()] == [name for name, _ in commands.items()]


@pytest.mark.parametrize(
    ("words", "expected"),
    [("los-testbed ca", {"campaign"}), ("los-testbed bag ve", {"verify"}), ("los-testbed run --mo", {"--mode"})],
)
def test_bash_completes_commands_and_options(words: str, expected: set[str]) -> None:
    asked = {"_LOS_TESTBED_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    code = "from los_testbed.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **asked}, timeout=60
    )
    assert set(done.stdout.split()) == expected, done.stderr
