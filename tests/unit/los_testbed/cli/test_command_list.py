"""The list of commands is made without them, and says what they say of themselves."""

from __future__ import annotations

import subprocess
import sys

import pytest
from los_testbed.cli.command_group import ENTRIES
from support.command_line import call_command


def test_the_help_imports_no_command() -> None:
    code = (
        "import sys; from los_testbed.cli.app import main; main(['--help']);"
        "print('imported', sorted({'numpy', 'scipy', 'pydantic', 'los_testbed.cli.run'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600)
    assert done.stdout.splitlines()[-1] == "imported []"
    assert all(f" {name} " in done.stdout for name in ENTRIES)


@pytest.mark.parametrize(
    ("words", "expected"),
    [("los-testbed ca", {"campaign"}), ("los-testbed bag ve", {"verify"}), ("los-testbed run --mo", {"--mode"})],
)
def test_bash_completes_commands_and_options(
    words: str, expected: set[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = {"_LOS_TESTBED_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    code, out, err = call_command(capsys)
    assert code == 0 and set(out.split()) == expected, err
