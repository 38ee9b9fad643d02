"""The command line in the process of a test."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest
from los_testbed.cli import app


def call_command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run ``los-testbed`` with these arguments: exit code, output and error output."""
    try:
        code = app.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = int(stop.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line with which a command is refused: exit code 2, and nothing on the standard output."""
    code, out, err = call_command(capsys, *arguments)
    assert code == 2 and out == "" and err.startswith("los-testbed: ") and err.count("\n") == 1, (code, out, err)
    return err


@dataclass
class CommandLine:
    """The command line in an empty folder; a call gives exit code, output and error output.

    Attributes
    ----------
    capsys : fixture of the test
    here : the working directory
    files : a folder for files of the user
    first : words that each command begins with
    controllers : options that name the controllers of the small telescope
    """

    capsys: pytest.CaptureFixture[str]
    here: Path
    files: Path
    first: tuple[str, ...] = ()
    controllers: list[str] = field(default_factory=list)

    @classmethod
    def below(
        cls,
        folder: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        *first: str,
    ) -> CommandLine:
        """In a new folder ``here`` below another one, which becomes the working directory."""
        (folder / "here").mkdir()
        monkeypatch.chdir(folder / "here")
        return cls(capsys, folder / "here", folder, first)

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        return call_command(self.capsys, *self.first, *arguments)
