"""Every command takes other telescopes than the reference: small, one or no array, eight wheels, a plant from a file.

Slow: some minutes for all of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from support.command_line import CommandLine

from lftkit import write_mat
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_pictures")]

SPACECRAFT = Path(__file__).parents[2] / "examples" / "spacecraft"
AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (0, 1, 1), (0, 1, -1), (1, 0, 1)]


def wheels(count: int) -> str:
    return "".join(
        f'[[reaction_wheel]]\nname = "w{i}"\naxis = {[float(x) for x in AXES[i]]}\nposition = [0.1, 0.0, 0.0]\n'
        f"default_speed = {100.0 + 20 * i}\n\n"
        for i in range(count)
    )


def array(name: str, driven: bool) -> str:
    return f'[[solar_array]]\nname = "{name}"\npoint = "A1"\nlike = "reference"\ndriven = {str(driven).lower()}\n\n'


def small(folder: Path) -> str:
    return (SPACECRAFT / "small_telescope.toml").read_text()


def plant_from_a_file(folder: Path) -> str:
    """One driven array, three wheels, no proof-mass actuators, as a .mat file."""
    text = "[pma]\nazimuths_deg = []\n\n" + array("wing", True) + wheels(3)
    (folder / "whole.toml").write_text('base = "reference"\n' + text)
    write_mat(folder / "plant.mat", P=build_telescope(load_telescope(folder / "whole.toml")).system)
    return '[plant]\nfile = "plant.mat"\n\n' + text


TELESCOPES: dict[str, Callable[[Path], str]] = {
    "small": small,
    "one array": lambda folder: array("wing", True),
    "no arrays": lambda folder: "solar_array = []\n",
    "eight wheels": lambda folder: wheels(8),
    "plant from a file": plant_from_a_file,
}


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine.below(tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize("name", TELESCOPES)
def test_commands_without_controllers(command: CommandLine, name: str) -> None:
    (command.here / "mine.toml").write_text('base = "reference"\n' + TELESCOPES[name](command.here))
    for line in (
        "plant check mine.toml",
        "plant export --output whole.json --parameters mine.toml",
        "run --mode inprocess --duration 6 --loop isolator --parameters mine.toml --output bag",
        "analyse bag",
        "replay bag",
        "campaign --samples 2 --duration 6 --loop isolator --parameters mine.toml --output rows",
        "campaign --samples 2 --depth model --loop isolator --parameters mine.toml --output gains",
        "stages --mode inprocess --duration 6 --scenario imbalance --parameters mine.toml --output stages",
    ):
        code, _, err = command(*line.split())
        assert code == 0, f"{line}: {err}"


@pytest.mark.parametrize("name", ["small", "plant from a file"])
def test_designs_of_other_telescopes(command: CommandLine, name: str) -> None:
    """Designed, verified, proven, budgeted, run: all by the same folder."""
    (command.here / "mine.toml").write_text('base = "reference"\n' + TELESCOPES[name](command.here))
    for line, codes in (
        ("design all --effort short --parameters mine.toml --output designs --workers 1", {0, 7}),
        ("design verify --designs designs --samples 5 --workers 1", {0, 7}),
        ("design certify --designs designs --output proofs --stage fsm --figure slow --gap 0.2 --workers 1", {0}),
        ("design check-proof proofs/bundle.zip", {0}),
        ("budget --designs designs", {0}),
        ("campaign --designs designs --samples 2 --duration 6 --output rows", {0}),
        ("run --designs designs --mode inprocess --duration 6 --output bag --json", {0}),
    ):
        code, out, err = command(*line.split())
        assert code in codes, f"{line}: {err}"
    assert json.loads(out.splitlines()[-1])["loop"] == "fsm"
