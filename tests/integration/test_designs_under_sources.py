"""Verdicts of `design all` and `design verify` include the sources of the telescope's file, which no tuning sees."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.api import designs
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.run import mission
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.mission import verify_mission
from support.command_line import refused

import fsm_pma_controller
import los_estimator
from los_design.search import worst_points
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

SOURCES = """
replace = ["requirement"]

[[requirement]]
name = "APE"
text = "prob(|APE| < 100 arcsec) >= 0.95 at 95 % confidence"

[[requirement]]
name = "RPE"
text = "prob(rms RPE(20 ms) < 30 mas) >= 0.95 at 95 % confidence"

[[disturbance]]
name = "cryocooler"
kind = "cooler"
place = "payload"
frequency = 47.0
harmonics = [{order = 1, force = [0.03, 0.03, 0.06]}]
"""

SECONDS = 1.1


class Check:
    """In the place of the check of the loop's figures, which takes minutes."""

    def to_mapping(self) -> dict[str, int]:
        return {"points": 1}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The stored designs for the reference telescope with a cryocooler; short runs at the nominal member."""
    monkeypatch.setattr(mission, "SECONDS", SECONDS)
    made = tmp_path / "designs"
    made.mkdir()
    for package, name in ((los_estimator, "k_fsm"), (fsm_pma_controller, "k_pma")):
        shutil.copy(Path(str(package.__file__)).parent / "designs" / f"{name}.json", made)
    (made / "telescope.toml").write_text('base = "reference"\n' + SOURCES)
    return made


@pytest.mark.further
def test_the_verdicts_are_those_of_runs_under_the_sources(folder: Path, tmp_path: Path) -> None:
    found = verify_mission(folder)
    assert found.sources == ("cryocooler",)
    rows = [verdict for verdict in found.verdicts if verdict.requirement and verdict.requirement.name == "RPE"]
    assert [(row.stage, row.member) for row in rows] == [("fsm", "nominal"), ("fsm+pma", "nominal")]
    designs = {name: str(folder / f"{name}.json") for name in ("k_fsm", "k_pma")}
    base = RunConfig(mode="inprocess", duration=SECONDS, parameters=str(folder / "telescope.toml"), **designs)
    for loop in ("isolator", "fsm", "fsm+pma"):
        run_in_process(replace(base, loop=loop), tmp_path / loop)
    opened = summarise(Run.open(tmp_path / "isolator"))
    said = " ".join(found.statements)
    for verdict in rows:
        closed, row = summarise(Run.open(tmp_path / verdict.stage)), verdict.requirement
        assert row is not None and row.value == closed.rows[1].value and verdict.without == opened.rows[1].value
        assert found.rpe is not None and found.rpe[verdict.stage, "nominal"] == (closed.rpe_rms, opened.rpe_rms)
        assert verdict.met == (row.value < 30.0)
        assert f"RPE {closed.rpe_rms:.3g} mas rms under them, {opened.rpe_rms:.3g} without fine control" in said


@pytest.mark.further
def test_the_worst_member_is_judged_as_well(folder: Path) -> None:
    stored = Path(str(worst_points.__file__)).parent / "worst_points.json"
    shutil.copy(stored, folder)
    (folder / "telescope.toml").write_text(
        'base = "reference"\n' + SOURCES[SOURCES.index("[[disturbance]]") :]
    )  # limits are part of the hash
    found = verify_mission(folder)
    assert {verdict.member for verdict in found.verdicts} == {"nominal", "worst for the RPE"}


@pytest.mark.further
def test_verify_is_not_met_where_the_sources_break_a_limit(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code of a strong source is 1, with the number; of a weak one the sources change nothing."""
    monkeypatch.setattr(mission, "SECONDS", 2.0)  # long enough for a verdict
    monkeypatch.setattr(designs, "verification_points", lambda *given, **more: [{}])
    monkeypatch.setattr(designs, "check_implemented", lambda *given, **more: Check())
    monkeypatch.setattr(designs, "broken_requirements", lambda check: [])
    codes, told = {}, {}
    for scale in ("0.001", "300.0"):
        scaled = SOURCES.replace("frequency = 47.0", f"frequency = 47.0\nscale = {scale}")
        (folder / "telescope.toml").write_text('base = "reference"\n' + scaled)
        try:
            codes[scale] = app.main(["design", "verify", "--designs", str(folder), "--json"])
        except SystemExit as ended:
            codes[scale] = int(ended.code or 0)
        told[scale] = capsys.readouterr()
    weak, strong = (json.loads(told[scale].out) for scale in told)
    assert weak["not_met"] == [] and codes["0.001"] == 0
    broken, words = strong["not_met"], "under the sources of the telescope: rms RPE(20 ms), 95 %"
    assert len(broken) == 2 and all(words in line and "without fine control)" in line for line in broken)
    assert codes["300.0"] == 7
    assert "the tuning does not consider cryocooler: fsm, nominal, RPE " in told["300.0"].err
    assert strong["mission"]["seen_by_the_tuning"] is False
    rpe = {row["stage"]: row for row in strong["mission"]["relative_error"]}
    assert np.isfinite([rpe["fsm"]["rpe_rms_mas"], rpe["fsm"]["without_fine_control"]]).all()


def test_a_source_that_no_run_can_have_is_refused_before_the_design(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savetxt("a.csv", np.c_[np.arange(100) / 100, np.ones(100)], delimiter=",", header="time,Fx", comments="")
    Path("t.toml").write_text('base = "reference"\n[[disturbance]]\nname = "a"\nkind = "series"\nfile = "a.csv"\n')
    error = refused(capsys, "design", "all", "--parameters", "t.toml", "--output", "made")
    assert "must be as long as the run, 20 s, got 1 s (repeat = true repeats it)" in error
