"""A plant of one's own: a broken contract is named before the run, what fails later is in the bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers
from support.command_line import refused

from lftkit.errors import InputError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import scenario_of


class Own(SimpleTelescope):
    """The small telescope with one thing wrong at one tick."""

    def __init__(self, fault: Any = None, tick: int = 0) -> None:
        self.fault, self.at = fault, tick
        super().__init__()

    def step(self, command: np.ndarray, measurement: np.ndarray, truth: np.ndarray) -> None:
        k = self._tick
        super().step(command, measurement, truth)
        if self.fault is not None and k == self.at:
            self.fault(command, measurement, truth)


def nan(name: str, index: int) -> Any:
    return lambda command, measurement, truth: {"measurement": measurement, "truth": truth}[name].__setitem__(
        index, np.nan
    )


def wrong_shape(command: np.ndarray, measurement: np.ndarray, truth: np.ndarray) -> None:
    truth[:] = np.zeros(3)


def raises(command: np.ndarray, measurement: np.ndarray, truth: np.ndarray) -> None:
    raise ZeroDivisionError("own mistake")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (nan("measurement", 8), ["finite", "accel_M1[2]"]),
        (wrong_shape, ["truth (2,)", "ValueError"]),
        (raises, ["ZeroDivisionError", "own mistake"]),
    ],
)
def test_a_broken_contract_is_named_before_the_run(tmp_path: Path, fault: Any, words: list[str]) -> None:
    config = RunConfig(duration=0.5, mode="inprocess", **write_controllers(tmp_path))
    with pytest.raises(InputError) as told:
        run_in_process(config, tmp_path / "bag", Own(fault))
    assert all(word in str(told.value) for word in words)
    assert not (tmp_path / "bag").exists()


MODULE = """
from simple_telescope import SimpleTelescope

class Plain(SimpleTelescope):
    def __init__(self):
        super().__init__()

class Configured(SimpleTelescope):
    def __init__(self, config):
        super().__init__(seed=config.seed)

class Silent(Plain):
    def step(self, command, measurement, truth):
        measurement[:] = 0.0
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the working folder, of a name of its own, with two plants and a broken one."""
    name = f"plants_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return name


@pytest.mark.parametrize("plant", ["Plain", "Configured"])
def test_a_plant_is_named_on_the_command_line(plant: str, module: str) -> None:
    files = write_controllers(Path.cwd())
    line = ["run", "--plant", f"{module}:{plant}", "--mode", "inprocess", "--duration", "0.5", "--loop", "fsm"]
    line += ["--k-fsm", files["k_fsm"], "--k-pma", files["k_pma"], "--no-report", "--output", "bag"]
    assert app.main(line) == 0
    run = Run.open("bag")
    assert run.parameters["plant"] == f"{module}:{plant}"
    assert run.parameters["start"] == "rest"
    direct = SimpleTelescope()
    run_in_process(RunConfig(duration=0.5, loop="fsm", mode="inprocess", **files), Path("direct"), plant=direct)
    np.testing.assert_array_equal(run["truth/los"].values, Run.open("direct")["truth/los"].values)
    assert [scenario_of(r) for r in (run, Run.open("direct"))] == [
        f"{module}:{plant}",
        f"{SimpleTelescope.__module__}:SimpleTelescope",
    ]


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        ("{}:Silent", "must write all of truth"),
        ("no_such_module:Plant", "No module named 'no_such_module'"),
        ("short_name", "entry point of los_testbed.plants, got 'short_name' (LookupError: known are none)"),
    ],
)
def test_a_plant_that_cannot_be_used_is_an_error_of_the_user(
    plant: str, words: str, module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["run", "--plant", plant.format(module), "--mode", "inprocess", "--duration", "1", "--output", "bag"]
    assert words in refused(capsys, *line)
    assert not Path("bag").exists()
