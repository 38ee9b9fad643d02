"""The line of an interrupted command is a command line that goes on."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from los_testbed.cli.interrupts import remember_command, resume_hint


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bags" / "a b").mkdir(parents=True)
    (tmp_path / "bags" / "a b" / "rows").touch()
    (tmp_path / "bags" / "empty").mkdir()
    monkeypatch.chdir(tmp_path)


def told(
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    error: type[BaseException],
    folder: str = "bags/a b",
    **options: tuple[str],
) -> str:
    remember_command(words)
    with pytest.raises(error), resume_hint("rows", Path(folder), **options):
        raise error
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--samples", "3"], ["--samples", "3", "--output", "bags/a b", "--resume"]),
        (["--output", "mine", "--resume"], ["--output", "mine", "--resume"]),
        (["--output=mine", "--anew"], ["--output=mine", "--resume"]),
    ],
)
def test_it_names_the_folder_and_the_options_that_go_on(
    given: list[str], expected: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    line = told(capsys, ["campaign", *given], KeyboardInterrupt, further=("--resume",), without=("--anew",))
    said, command = line.split(": ", 1)
    assert said == "rows are stored; resume with"
    assert shlex.split(command) == ["los-testbed", "campaign", *expected]


def test_a_failure_says_nothing_of_it_and_nothing_is_kept_without_a_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, ["campaign"], ValueError) == ""
    assert told(capsys, ["campaign"], KeyboardInterrupt, "none yet") == ""
    assert told(capsys, ["campaign"], KeyboardInterrupt, "bags/empty") == ""
