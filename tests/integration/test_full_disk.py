"""A disk that is full: one line that names the output, and nothing but what can be repaired is left."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from los_testbed.bags.repair import repair_bag
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from support.simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture
def small(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    folder = tmp_path / "small"
    folder.mkdir()
    size = f"size={request.param}k"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small file system is not permitted")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def recorded(folder: Path, bag: Path, duration: float) -> Path:
    config = RunConfig(duration=duration, mode="inprocess", **write_controllers(folder))
    run_in_process(config, bag, SimpleTelescope())
    return bag


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    return recorded(folder, folder / "bag", 3.0)


@pytest.mark.parametrize("small", [500], indirect=True)
def test_a_run_keeps_what_was_written_and_tells_how_to_get_it(tmp_path: Path, small: Path) -> None:
    with pytest.raises(OSError, match="No space left") as told:
        recorded(tmp_path, small / "bag", 5.0)
    assert f"los-testbed bag repair {small / 'bag'}" in str(told.value)
    repair_bag(small / "bag", tmp_path / "saved")
    assert len(Run.open(tmp_path / "saved")["truth/los"]) >= 1000


@pytest.mark.parametrize("small", [100], indirect=True)
def test_a_run_whose_first_second_does_not_fit_leaves_nothing(tmp_path: Path, small: Path) -> None:
    with pytest.raises(OSError, match="No space left") as told:
        recorded(tmp_path, small / "bag", 5.0)
    assert str(small / "bag") in str(told.value) and "repair" not in str(told.value)
    assert not list(small.iterdir())


@pytest.mark.parametrize("small", [12], indirect=True)
@pytest.mark.parametrize(
    "command",
    ["analyse {bag} --output={output}.html", "report {bag} --output={output}.html", "replay {bag} --output={output}"],
)
def test_an_output_that_does_not_fit_is_named_and_not_left(
    bag: Path, small: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        app.main([part.format(bag=bag, output=small / "output") for part in command.split()])
    err = capsys.readouterr().err
    assert stop.value.code == 1 and err.count("\n") == 1
    assert "No space left on device" in err and str(small / "output") in err
    assert not list(small.iterdir())
