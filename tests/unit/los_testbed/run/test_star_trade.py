"""Guide stars against pointing: the command, its parameter files, its mistakes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import DESIGN_FILES, of_designs
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.star_trade import TradePoint, measure, parameter_text, table
from support.command_line import call_command

from lftkit import SampledSystem
from los_design import redesign
from los_design.redesign import DesignSummary
from los_design.synthesis.options import DesignOptions
from los_design.verification.verification import ImplementedCheck
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope


def test_a_parameter_file_keeps_what_the_user_wrote(tmp_path: Path) -> None:
    """Nested tables, lists of tables, and a file beside it, whose name becomes the whole path."""
    (tmp_path / "beam.toml").write_text("x = 1\n", "utf-8")
    own = {
        "sensors": {"washout": 0.2},
        "camera": {"read_noise": 5.0, "magnitude": 9.0},
        "requirement": [{"name": "RPE, mine", "text": "prob(|RPE(20 ms)| < 1 arcsec) >= 0.9 at 90 % confidence"}],
        "body": {"damping": 0.004},
    }
    file = tmp_path / "star.toml"
    file.write_text(parameter_text(own, tmp_path, 12.5, 0.04), "utf-8")
    found = load_telescope(file).to_mapping()
    assert found["sensors"]["washout"] == 0.2 and found["sensors"]["camera"] == "image"
    assert (found["camera"]["magnitude"], found["camera"]["exposure"]) == (12.5, 0.04)
    assert found["camera"]["read_noise"] == 5.0 and found["body"]["damping"] == 0.004
    assert "RPE, mine" in [row["name"] for row in found["requirement"]]
    assert str(tmp_path / "beam.toml") in parameter_text({"payload": {"modal_data": "beam.toml"}}, tmp_path, 1.0, 0.02)


SHORT = ["--rates", "50", "--duration", "1", "--scenario", "imbalance"]


class Designs:
    """In place of a design of minutes: the stored controllers, after so many calls that the time limit ended."""

    def __init__(self, ended: int) -> None:
        self.ended, self.calls = ended, list[tuple[Path, float, float]]()

    def __call__(self, telescope: Telescope, folder: Path, options: DesignOptions, **_: Any) -> DesignSummary:
        self.calls.append((folder, options.wall_limit, telescope.camera_noise))
        status = "out_of_time" if len(self.calls) <= self.ended else "converged"
        for name, path in RunParts(RunConfig()).model_files.items():
            system = SampledSystem.from_file(path)
            made = replace(system, provenance={**system.provenance, "status": status})
            made.to_file(folder / DESIGN_FILES[name])
        return DesignSummary(
            folder, ImplementedCheck({}, {}, 0.0, {}, telescope), ["fsm RPE 1.2000, must be at most 1"]
        )


@pytest.mark.further
def test_a_trade_designs_for_each_star_and_goes_on_where_it_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, designs = tmp_path / "trade", Designs(ended=1)
    monkeypatch.setattr(redesign, "design_all", designs)
    command = ["image", "trade", *SHORT, "--magnitudes", "10,13", "--output", str(folder), "--json"]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 1
    told = capsys.readouterr()
    assert json.loads(told.out.splitlines()[-1]) == {"trade": [], "finished": False}
    assert "ended by the time limit after 0 of 2: run again to resume" in told.err
    main(command)
    first = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert first["finished"] and [row["design"] for row in first["trade"]] == ["converged", "converged"]
    assert all(row["not_met"] == ["fsm RPE 1.2000, must be at most 1"] for row in first["trade"])
    places = [place.name for place, _, _ in designs.calls]
    assert places == ["magnitude-10-rate-50", "magnitude-10-rate-50", "magnitude-13-rate-50"]
    noise = [sigma for _, _, sigma in designs.calls]
    assert noise[0] == noise[1] < noise[2]
    assert all(0.0 < limit <= 7200.0 for _, limit, _ in designs.calls)
    assert of_designs(str(folder / places[0]))["parameters"].endswith("telescope.toml")
    main(command)  # nothing is left to do
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == first and len(designs.calls) == 3
    code, _, error = call_command(capsys, *command, "--seed", "7")
    assert code == 2 and "--output must be a new folder or one of the same trade" in error


@pytest.mark.slow
def test_a_design_of_its_own_for_a_star(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two minutes: controllers that name the telescope with this star, and the loop with them."""
    folder = tmp_path / "trade"
    main(["image", "trade", *SHORT, "--magnitudes", "13", "--workers", "1", "--output", str(folder), "--json"])
    (row,) = json.loads(capsys.readouterr().out.splitlines()[-1])["trade"]
    assert row["design"] != "kept" and row["not_met"] == [] and row["rpe_mas"] > 0.0
    config = RunConfig.from_mapping(of_designs(str(folder / "magnitude-13-rate-50")))
    assert RunParts(config).check() == ()


@pytest.mark.further
def test_one_command_makes_table_and_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    folder = tmp_path / "trade"
    arguments = [*SHORT, "--magnitudes", "10,25", "--keep-controllers", "--json"]
    main(["image", "trade", *arguments, "--output", str(folder)])
    told = capsys.readouterr()
    rows = json.loads(told.out.splitlines()[-1])["trade"]
    bright, none = rows
    assert [line.split()[1] for line in told.err.splitlines() if line.startswith("│")] == ["10", "25"]
    assert (bright["magnitude"], none["magnitude"]) == (10.0, 25.0)
    assert bright["frames"] == 50 and bright["without_angles"] == {"before_start": 2}
    assert sum(none["without_angles"].values()) == 50
    assert 0.0 < bright["mtf_nyquist"] < 1.0 and bright["rpe_mas"] > 0.0
    assert json.loads((folder / "trade.json").read_text()) == rows
    assert (folder / "trade.png").read_bytes().startswith(b"\x89PNG")
    assert len((folder / "trade.md").read_text().splitlines()) == 4


def test_an_unstable_loop_has_no_figures(tmp_path: Path) -> None:
    """The observer times -30: a loop that is lost, whether a record of half a second has diverged or not."""
    observer = RunParts(RunConfig(mode="inprocess")).k_fsm
    assert isinstance(observer, SampledSystem)
    replace(observer, C=-30.0 * observer.C, D=-30.0 * observer.D).to_file(tmp_path / "k_fsm.json")
    config = RunConfig(mode="inprocess", duration=0.5, loop="fsm", k_fsm=str(tmp_path / "k_fsm.json"))
    found = measure(TradePoint(12.0, 50.0, config), tmp_path / "bag")
    assert found["failure"] == "the loop is unstable" and found["rpe_mas"] is None
    row = {**found, "design": "kept", "not_met": []}
    assert "unstable" in str(table([row]).rows)
