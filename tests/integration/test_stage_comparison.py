"""The four stages of the real telescope: superposition of the parts, transmissibility against the model, files."""

import json

import numpy as np
import pytest
from los_testbed.cli import app as cli
from los_testbed.config.run_config import RunConfig
from los_testbed.run.stages import Plan, perform, select

from pointing_analysis.read.run import Run
from titop_plant.interface import STAGES

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Scenario imbalance: so small that no command saturates, and the loop is linear."""
    plan = Plan(
        RunConfig(duration=4.0, mode="inprocess"), tmp_path_factory.mktemp("s") / "new", ("imbalance",), 1, keep=True
    )
    return plan, perform(plan)


def test_the_parts_add_up_to_the_whole(compared) -> None:
    _, results = compared
    for loop in STAGES:
        whole, alone, noise = (
            Run.open(select(results, "imbalance", loop, part)["nominal"].bag)["truth/los"].values[:, :2]
            for part in ("all", "disturbance", "noise")
        )
        scale = np.abs(whole).max()
        assert np.abs(whole - alone - noise).max() < 1e-6 * scale, loop


def test_open_stages_have_no_noise_in_the_line_of_sight(compared) -> None:
    _, results = compared
    for loop in ("none", "isolator"):
        assert select(results, "imbalance", loop, "noise")["nominal"].metrics["ape_max_arcsec"] == 0.0


@pytest.mark.parametrize("loop", STAGES)
def test_measured_transmissibility_is_that_of_the_model(compared, loop) -> None:
    """The record of the nodes' cores against matrices of the closed loop: another route to the same motion.

    The run begins in the steady state. Weak tones are left out there: beside them are images of strong ones in the
    camera's frames, which the model does not have.
    """
    tones = select(compared[1], "imbalance", loop, "disturbance")["nominal"].tones
    assert len(tones) > 10
    strongest = max(tone.expected for tone in tones)
    for tone in tones:
        assert tone.measured == pytest.approx(tone.expected, rel=1e-6, abs=1e-9 * strongest)
        if tone.model > 0.1 * strongest:
            assert tone.model == pytest.approx(tone.expected, rel=5e-4)


def test_the_command_writes_tables_and_report(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        cli.main(
            ["stages", "--scenario=imbalance", "--samples=2", "--no-parts", "--duration=2", "--output=out", "--json"]
        )
        == 0
    )
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert json.loads((tmp_path / "out" / "stages.json").read_text()) == content
    runs = {(r["telescope"], r["loop"]): r for r in content["runs"]}
    assert set(runs) == {(name, loop) for name in ("nominal", "sample-1") for loop in STAGES}
    assert all(r["rpe_rms_mas"] > 0 for r in runs.values())
    assert runs["nominal", "fsm"]["rpe_rms_mas"] != runs["sample-1", "fsm"]["rpe_rms_mas"]
    page = (tmp_path / "out" / "report-imbalance.html").read_text()
    assert page.count('<strong class="name">') == 4
    kept = sorted(p.name for p in (tmp_path / "out").iterdir() if p.is_dir())
    assert kept == sorted(f"imbalance-nominal-{loop}" for loop in STAGES)
