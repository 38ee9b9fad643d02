"""The small telescope of tests/support stands in for the plant; a bag that it has made; the command line."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "support"))

from command_line import call_command
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the bag of a run of 3 s and the files of its controllers; it is left as it is."""
    folder = tmp_path_factory.mktemp("made")
    config = RunConfig(duration=3.0, mode="inprocess", **write_controllers(folder))
    run_in_process(config, folder / "bag", SimpleTelescope())
    return folder


@pytest.fixture
def bag(made: Path, tmp_path: Path) -> Path:
    """A copy of the bag, to be damaged."""
    return Path(shutil.copytree(made / "bag", tmp_path / "bag"))


@pytest.fixture
def call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """The command line in a folder of its own: exit code, output and error output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object) -> tuple[int, str, str]:
        return call_command(capsys, *arguments)

    return run
