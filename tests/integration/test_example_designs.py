"""The example spacecraft have controllers of their own: of that telescope, stable, within their limits."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import tomli_w
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs, of_scenario
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

from lftkit import SampledSystem
from los_design.search.worst_points import load_worst_points
from los_design.verification.verification import ARCSEC, MAS, check_implemented
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

EXAMPLES = Path(__file__).parents[2] / "examples" / "spacecraft"
NAMES = ("earth_observer", "small_telescope")


@pytest.mark.parametrize("name", NAMES)
def test_the_designs_are_of_that_telescope(name: str) -> None:
    folder, example = EXAMPLES / name, EXAMPLES / f"{name}.toml"
    assert (folder / "telescope.toml").read_bytes() == example.read_bytes()
    known = load_telescope(example).parameters_hash
    for law in ("k_fsm", "k_pma"):
        assert SampledSystem.from_file(folder / f"{law}.json").provenance["design_all"]["parameters_hash"] == known
    assert json.loads((folder / "worst_points.json").read_text())["parameters_hash"] == known
    parts = RunParts(RunConfig.from_mapping({**of_designs(str(folder)), "loop": telescope_of(name).mirror_stages[-1]}))
    assert parts.check() == (), "no warning"


def telescope_of(name: str) -> Telescope:
    return load_telescope(EXAMPLES / f"{name}.toml")


@pytest.mark.parametrize("name", NAMES)
def test_the_verification_met_the_requirements(name: str) -> None:
    content = json.loads((EXAMPLES / name / "verification.json").read_text())
    found, stages = content["implemented"], telescope_of(name).stages
    assert content["not_met"] == [] and found["stable_samples"] == found["samples"] >= 200
    assert ("pma" in found) == ("fsm+pma" in stages) == (name == "earth_observer")
    assert max(found["pma"] if "pma" in found else found["fsm"]) <= 1.0
    weights = load_telescope(EXAMPLES / f"{name}.toml").weights
    for short, limit in (("fsm", "rpe_limit"), ("pma", "rpe_limit_fine")):
        assert found["total_mas"].get(short, 0.0) <= getattr(weights, limit) / MAS
        assert found["total_ape_arcsec"].get(short, 0.0) <= weights.ape_limit / ARCSEC
    assert set(load_worst_points(EXAMPLES / name)) == set(stages)


@pytest.mark.parametrize("name", ["small_telescope", pytest.param("earth_observer", marks=pytest.mark.slow)])
def test_the_worst_points_are_stable_and_within_the_limits(name: str) -> None:
    """Computed anew at the worst points of each stage: what the verification file says."""
    folder, telescope = EXAMPLES / name, load_telescope(EXAMPLES / f"{name}.toml")
    worst, stages = load_worst_points(folder), telescope.mirror_stages
    points = [dict(worst[stage][figure].parameters) for stage in stages for figure in ("APE", "fast")]
    pair = [SampledSystem.from_file(folder / f"{law}.json") for law in ("k_fsm", "k_pma")]
    system = control_loop_plant(telescope)
    check = check_implemented(system, telescope, pair[0], pair[1], points, changes=False)
    assert check.all_stable and check.stages == stages
    stored = json.loads((folder / "verification.json").read_text())["implemented"]
    for short, stage in zip(("fsm", "pma"), stages):
        tones = check.gamma(stage, "APE"), check.gamma(stage, "RPE")
        assert tones == pytest.approx(stored[short][:2], rel=0.01)
        assert stage != stages[-1] or max(tones) <= 1.0


@pytest.mark.parametrize("name", NAMES)
def test_a_run_of_the_worst_tone_keeps_the_limits(name: str, tmp_path: Path) -> None:
    folder = str(EXAMPLES / name)
    stage = telescope_of(name).mirror_stages[-1]
    given = {**of_designs(folder), "mode": "inprocess", "duration": 3.0, "loop": stage, "start": "steady"}
    config = RunConfig.from_mapping({**given, **of_scenario(given, folder)})
    run_in_process(config, tmp_path / "bag")
    summary = summarise(Run.open(tmp_path / "bag"))
    assert len(summary.rows) >= 2
    for verdict in summary.verdicts:
        assert verdict.quantile.value <= verdict.requirement.limit, verdict.requirement.name


def test_the_budget_over_members_is_the_largest_of_theirs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The member that is named has that total in a budget of its own, and no other has more."""
    folder = EXAMPLES / "small_telescope"
    controllers = [shutil.copy(folder / name, tmp_path) for name in ("k_fsm.json", "k_pma.json")]
    apart = ["--designs", str(Path(controllers[0]).parent), "--parameters", str(folder / "telescope.toml")]
    assert main(["budget", "--designs", str(folder), "--members", "1", "--json"]) == 0
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    for row, at in zip(content["over_members"], content["requirements"], strict=True):
        assert row["members"] == 4 and row["at_the_point"] == at["total"] <= row["worst"]
        assert row["worst"] + row["margin"] == pytest.approx(at["limit"], rel=1e-12)
        own = tmp_path / "own.toml"
        source = {"type": "testbed", "scenario": "imbalance", "loop": "fsm", "settings": row["settings"]}
        own.write_text(tomli_w.dumps({"unit": "mas", "sources": {"loop": source}}), "utf-8")
        assert main(["budget", str(own), *apart, "--json"]) == 0
        alone = json.loads(capsys.readouterr().out.splitlines()[-1])["requirements"]
        assert [r["total"] for r in alone if r["text"] == row["requirement"]] == pytest.approx([row["worst"]], rel=1e-6)
