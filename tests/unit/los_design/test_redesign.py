"""Designs in a folder: steps, files, what is kept and made again; three other telescopes with short settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lftkit import SampledSystem
from lftkit.support.job import Job
from los_design import redesign
from los_design.redesign import design_all
from los_design.search.worst_case_search import Search
from los_design.search.worst_points import load_adversarial, load_worst_points
from los_design.synthesis.design_folder import DesignFolder
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.round_state import RoundState
from los_design.synthesis.starts import zero_controller
from los_design.synthesis.store import load_designs
from los_design.verification.verification import check_implemented, verification_points
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.telescope import Telescope

SHORT = DesignOptions(short=True)


@pytest.fixture
def stand_ins(monkeypatch) -> list[str]:
    """Design functions that return the stored controllers, a search of one point, a check with one line."""
    made: list[str] = []
    k_fsm, k_pma = load_designs("implemented")

    def pair(telescope, options, report, job, workers):
        made.append(f"pair, seed {options.seed}, {'short' if options.short else 'full'}")
        made.append("goes on" if job.record.exists() else "begins")
        report("round 1: fine")
        job.record.write_text("{}")
        return k_fsm, k_pma

    def points(telescope, k_fsm, k_pma, options, workers):
        system = control_loop_plant(telescope)
        search = Search(
            ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), k_fsm, k_pma, "fsm")
        )
        found = [search.confirmed(search.metrics["slow"], 5.0, np.full(7, share)) for share in (0.6, 0.3, 0.6)]
        return {"fsm": {"slow": found}, "fsm+pma": {"slow": []}}

    def check(system, telescope, k_fsm, k_pma, at, workers):
        made.append(f"check at {len(at)}")
        return SimpleNamespace(to_mapping=lambda: {"samples": len(at)}, gammas={"fsm": [0.5], "pma": [0.6]})

    monkeypatch.setattr(redesign, "design_pair", pair)
    monkeypatch.setattr(redesign, "search_stages", points)
    monkeypatch.setattr(redesign, "check_implemented", check)
    monkeypatch.setattr(redesign, "broken_requirements", lambda check: ["fsm: APE 1.200 of its limit"])
    return made


def test_the_folder_holds_designs_worst_points_and_verification(stand_ins, telescope, tmp_path) -> None:
    lines: list[str] = []
    found = design_all(telescope, tmp_path / "new" / "soft", SHORT, report=lines.append)
    folder = tmp_path / "new" / "soft"
    assert {p.name for p in folder.iterdir()} == {"k_fsm.json", "k_pma.json", "worst_points.json", "verification.json"}
    tuned_at = len({tuple(v.values()) for k in load_designs("implemented") for v in k.provenance["active_models"] if v})
    assert stand_ins == ["pair, seed 0, short", "begins", f"check at {1 + 16 + 20 + tuned_at + 2}"]
    assert not found.met and found.not_met == ["fsm: APE 1.200 of its limit"]
    assert found.gammas == {"fsm": [0.5], "pma": [0.6]}
    assert "round 1: fine" in lines
    content = json.loads((folder / "verification.json").read_text())
    assert content == {"implemented": {"samples": 39 + tuned_at}, "not_met": found.not_met}
    assert json.loads((folder / "worst_points.json").read_text())["parameters_hash"] == telescope.parameters_hash
    assert load_worst_points(folder)["fsm"]["slow"].omega == 5.0
    adversarial = load_adversarial(folder)
    assert len(adversarial) == tuned_at + 2, "two different points of the search, and those of the design"
    assert all(set(values) == set(adversarial[0]) for values in adversarial)


@pytest.mark.further
def test_a_pair_that_is_there_is_kept_until_something_changes(stand_ins, telescope, tmp_path) -> None:
    design_all(telescope, tmp_path, SHORT)
    stand_ins.clear()
    lines: list[str] = []
    design_all(telescope, tmp_path, SHORT, report=lines.append)
    assert not any(s.startswith("pair") for s in stand_ins) and "k_fsm.json, k_pma.json: kept" in lines
    for options, resume in ((replace(SHORT, seed=1), True), (DesignOptions(seed=1), True), (SHORT, False)):
        stand_ins.clear()
        design_all(telescope, tmp_path, options, resume=resume)
        assert sum(s.startswith("pair") for s in stand_ins) == 1
    stand_ins.clear()
    other = telescope.changed({"isolator": {"damping": [1000.0] * 6}})
    design_all(other, tmp_path, SHORT)
    assert sum(s.startswith("pair") for s in stand_ins) == 1


def test_an_interrupted_design_goes_on_unless_it_is_made_anew(stand_ins, telescope, tmp_path) -> None:
    (tmp_path / "rounds.json").write_text("{}")
    design_all(telescope, tmp_path, SHORT)
    assert "goes on" in stand_ins and not (tmp_path / "rounds.json").exists()
    stand_ins.clear()
    (tmp_path / "rounds.json").write_text("{}")
    design_all(telescope, tmp_path, SHORT, resume=False)
    assert "begins" in stand_ins


def test_the_output_is_checked_before_the_work(stand_ins, telescope, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="output must be a folder that can be written to, got"):
        design_all(telescope, tmp_path / "file" / "soft")
    with pytest.raises(ValueError, match=r"^loop_delay must be that of the testbed, 0\.0015 s, got 0$"):
        design_all(telescope, tmp_path, DesignOptions(loop_delay=0.0))
    assert stand_ins == []


def soft_isolator(table: dict[str, Any]) -> None:
    table["isolator"]["stiffness"] = [0.25 * k for k in table["isolator"]["stiffness"]]


def heavy_payload(table: dict[str, Any]) -> None:
    table["payload"]["equipment"][-1]["mass"] += 40.0


def long_arrays(table: dict[str, Any]) -> None:
    """30 % longer at the same mass: frequencies over 1.3^2, inertia times it, participation of rotations times 1.3."""
    array, s = table["solar_array"], 1.3
    array["center_of_mass"][1] *= s
    for i in (0, 2):
        array["inertia_at_cg"][i][i] *= s**2
    array["frequencies"] = [w / s**2 for w in array["frequencies"]]
    for row in array["participation"]:
        row[3], row[5] = s * row[3], s * row[5]
    for mode in array["further_modes"]:
        mode["frequency"] /= s**2


@pytest.mark.slow
@pytest.mark.parametrize("change", [soft_isolator, heavy_payload, long_arrays])
def test_another_telescope_is_redesigned(change, telescope, tmp_path) -> None:
    """Every requirement is met or listed with its value; the worst excess is below that of the stored pair."""
    tables: dict[str, Any] = telescope.to_mapping()
    change(tables)
    table = Telescope(tables)
    found = design_all(table, tmp_path, SHORT, report=print)
    assert found.check.all_stable
    assert found.met or all(any(digit.isdigit() for digit in line) for line in found.not_met)
    system = control_loop_plant(table)
    at = verification_points(table, system, 10)[::8]
    made_pair = [SampledSystem.from_file(tmp_path / f"{name}.json") for name in ("k_fsm", "k_pma")]
    own, stored = (
        check_implemented(system, table, *pair, at, changes=False) for pair in (made_pair, load_designs("implemented"))
    )
    assert excess(own, table) < excess(stored, table) or (excess(own, table) <= 1.0)


def excess(check, table: Mapping[str, Any]) -> float:
    """Largest ratio of a requirement of both stages to its limit."""
    gammas = [check.gamma("fsm", name) for name in ("APE", "RPE", "mirror", "sensitivity, mirror")]
    gammas += [check.gamma("fsm+pma", name) for name in ("APE", "RPE", "sensitivity, forces")]
    return max(*gammas, check.total("fsm+pma") / 40.0)


PAIR = zero_controller("k-fsm"), zero_controller("k-pma")
OPTIONS = DesignOptions(loop_delay=0.0)


class Maker:
    """Stand-in for a design of the pair in rounds, of which each call makes one."""

    def __init__(self, *ends: str) -> None:
        self.ends, self.rounds = list(ends), list[int]()

    def __call__(self, job: Job) -> list[SampledSystem]:
        state = RoundState.load(job) or RoundState(np.zeros(2))
        RoundState(state.x, state.number + 1).save(job)
        self.rounds.append(state.number + 1)
        provenance = {"status": self.ends.pop(0), "command": "another"}
        return [replace(system, provenance=provenance) for system in PAIR]


def made(folder: Path, maker: Maker, options: DesignOptions = OPTIONS, telescope: str = "a", **given) -> list[str]:
    systems = DesignFolder(folder, telescope, "make it", print).made(["one", "two"], maker, options, given)
    assert all(system.provenance["command"] == "make it" for system in systems)
    return [system.provenance["status"] for system in systems]


def test_a_design_is_made_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    maker = Maker("converged")
    assert made(tmp_path, maker) == ["converged"] * 2
    assert capsys.readouterr().out == "one.json: converged\ntwo.json: converged\n"
    before = [(tmp_path / name).read_bytes() for name in ("one.json", "two.json")]
    assert made(tmp_path, maker, replace(OPTIONS, wall_limit=1.0, progress=True)) == ["converged"] * 2
    assert before == [(tmp_path / name).read_bytes() for name in ("one.json", "two.json")]
    assert maker.rounds == [1] and [path.name for path in (tmp_path / "build").iterdir()] == ["two.json"]


@pytest.mark.parametrize("change", ["telescope", "options", "given", "file"])
def test_another_design_is_made_anew(tmp_path: Path, change: str) -> None:
    maker = Maker("converged", "rounds")
    made(tmp_path, maker, k_fsm=PAIR[0])
    if change == "file":
        (tmp_path / "one.json").unlink()
    options = replace(OPTIONS, seed=1) if change == "options" else OPTIONS
    given = replace(PAIR[0], D=PAIR[0].D + 1.0) if change == "given" else PAIR[0]
    assert made(tmp_path, maker, options, "b" if change == "telescope" else "a", k_fsm=given) == ["rounds"] * 2
    assert maker.rounds == [1, 1]


def test_a_design_that_its_wall_limit_ended_goes_on(tmp_path: Path) -> None:
    maker = Maker("out_of_time", "converged")
    assert made(tmp_path, maker) == ["out_of_time"] * 2
    assert made(tmp_path, maker) == made(tmp_path, maker) == ["converged"] * 2
    assert maker.rounds == [1, 2]
