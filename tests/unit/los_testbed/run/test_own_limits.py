"""The limits and windows of a user's telescope judge its runs: table, page, JSON, bag, campaign, star and replay."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign.campaign_verdict import model_verdicts, verdicts
from los_testbed.campaign.dataset import Campaign
from los_testbed.campaign.member import MemberEvaluator, metric_columns
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from support.requirement_outputs import page_rows, screen_rows

from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.metrics import radial, windows
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import requirements_of as recorded
from pointing_analysis.requirements.summary import summarise

REFERENCE = MemberParameters.of()

pytestmark = pytest.mark.usefixtures("without_pictures")

MINE = "[weights]\nrpe_limit_fine = 4.848e-8\nape_limit = 4.848e-6\n"  # 10 mas, 1 arcsec
MAS = 4.84813681109536e-09


def test_allowances_of_the_bag_are_no_part_of_other_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Limits that are given to a command: the budget of the RPE says its values, not those of 40 mas beside 10."""
    given = tmp_path / "own.toml"
    given.write_text(
        '[[requirement]]\nname = "fine"\ntext = "prob(rms RPE(20 ms) < 10 mas) >= 0.9 at 95 % confidence"\n'
    )
    bag, page = str(Path(__file__).parents[4] / "bags" / "reference"), tmp_path / "page.html"
    told = {}
    for name, more in (("bag", []), ("own", [f"--requirements={given}"])):
        assert main(["analyse", bag, f"--output={page}", "--json", *more]) == 0
        text = capsys.readouterr()
        line = next(one for one in text.err.splitlines() if one.startswith("budget of the RPE"))
        allowed = json.loads(text.out)["budget_rpe_mas"]["allowances"]
        told[name] = (" of 40" in line, bool(allowed), " of 40" in page.read_text().split("Budget of the RPE")[1][:120])
    assert told == {"bag": (True, True, True), "own": (False, False, False)}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two seconds of a telescope with limits of its own; its bag, page and parameter file."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "mine.toml").write_text('base = "reference"\n' + MINE)
    given = ["--mode=inprocess", "--duration=2", f"--parameters={folder / 'mine.toml'}", f"--output={folder / 'bag'}"]
    with pytest.MonkeyPatch.context() as patch:  # as `without_pictures`, which is made after this
        patch.setattr("pointing_analysis.report.report.PICTURES", ())
        patch.setattr("los_testbed.run.summary.loop_curves.broken_loops", lambda *_: ())
        assert main(["run", *given, "--json"]) == 0
    return folder


def test_the_bag_is_judged_by_its_telescope(
    own: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """27.3 mas are not compliant with 10 mas, wherever it is said; the parameter file is not needed any more."""
    (own / "mine.toml").rename(own / "elsewhere.toml")
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["analyse", str(own / "bag"), f"--output={own / 'again.html'}", "--json"]) == 0
    told = capsys.readouterr()
    (own / "elsewhere.toml").rename(own / "mine.toml")
    (table,) = screen_rows(told.err)
    fine = next(row for row in table if row[2] == "9.99972 mas")
    assert fine[0] == "RPE, finest: rms RPE(20 ms), 99.7 %" and fine[4] == "not compliant"
    assert not any("40 mas" in cell for row in table for cell in row)
    found = {row["name"]: row for row in json.loads(told.out.splitlines()[-1])["requirements"]}
    assert found["RPE, finest"]["status"] == "not compliant" and found["RPE, finest"]["quantile"] > 20
    assert found["RPE, finest"]["limit"] == pytest.approx(4.848e-8 / MAS, rel=1e-5)
    for page in ("bag/report.html", "again.html"):
        shown = {row["Requirement"].partition(":")[0]: row for row in page_rows((own / page).read_text())}
        assert shown["RPE, finest"]["Verdict"] == "not compliant" and shown["RPE, finest"]["Limit"] == "9.99972 mas"
        assert shown["|APE|, 99.7 %"]["Limit"] == "0.999972 arcsec"
    assert [r.limit for r in recorded(Run.open(own / "bag")) or ()] == [4.848e-6, 100 * MAS, 4.848e-8]


def test_a_campaign_is_judged_by_its_telescope(own: Path) -> None:
    base = RunConfig(mode="inprocess", duration=1.0, loop="fsm+pma", parameters=str(own / "mine.toml"))
    requirements = RunParts(base).telescope.requirements
    names = metric_columns("time", requirements)
    assert "rpe_window_above_9.99972_mas" in names and not any("above_40_mas" in name for name in names)
    asked = Campaign.of(base, "uniform", 2, 1, "time", {})
    assert asked.metrics == names
    evaluator = MemberEvaluator.of(base)
    rows = evaluator.rows([member for _, chunk in asked.chunks() for member in chunk], "time")
    assert all(set(names) | set(REFERENCE.columns) <= set(row) and row["status"] == "ok" for row in rows)
    columns = {name: np.array([row[name] for row in rows]) for name in names}
    found = {(v.requirement, v.interpretation): v for v in verdicts(columns, ["ok"] * 2, "fsm+pma", requirements)}
    fine = found["RPE, finest", "temporal"]
    assert fine.limit == pytest.approx(9.99972, rel=1e-5) and fine.status == "not compliant"
    assert (columns["rpe_window_p997_mas"] > 10).any()
    total = model_verdicts(np.array([9.0, 11.0]), ["ok"] * 2, "fsm+pma", requirements)
    assert {v.requirement: v.status for v in total} == {"RPE, fine": "not enough data", "RPE, finest": "not compliant"}


WINDOW = 0.05

MISSION = """replace = ["requirement"]
[[requirement]]
name = "APE"
text = "prob(|APE| < 10 arcsec) >= 0.95 at 95 % confidence"
[[requirement]]
name = "RPE, mirror"
text = "prob(rms RPE(50 ms) < 900 mas) >= 0.9999 at 95 % confidence"
loop = ["fsm"]
[[requirement]]
name = "RPE, all"
text = "prob(rms RPE(50 ms) < 400 mas) >= 0.9999 at 95 % confidence"
loop = ["fsm+pma"]
"""


@pytest.mark.further
def test_run_star_replay_and_campaign_have_the_window_of_the_mission(
    tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    file = tmp_path / "mission.toml"
    file.write_text('base = "reference"\n' + MISSION)
    settings = ("--parameters", file, "--loop", "fsm+pma", "--scenario", "none", "--duration", 3)
    code, out, err = call("run", "--mode", "inprocess", *settings, "--output", "bag", "--no-report")
    assert code == 0, err
    run = Run.open(Path("bag"))
    summary, error = summarise(run), performance_error(run)
    sizes = radial(np.sqrt(windows(error.values, error.dt, WINDOW).variance)) / RAD_PER_MAS
    assert summary.window == WINDOW
    assert summary.rpe_windows_quantile == pytest.approx(np.quantile(sizes, 0.997, method="higher"))
    assert summary.star is not None
    assert summary.star.exposure == WINDOW
    assert "RKE rms, 50 ms windows" in call("replay", "bag")[1]
    code, out, err = call("campaign", *settings, "--samples", 2, "--output", "campaign", "--json")
    assert code == 0, err
    found = json.loads(out.splitlines()[-1])
    assert found["window_s"] == WINDOW
    assert found["metrics"]["rpe_window_p997_mas"]["members"] == 2
    judged = {verdict["requirement"]: verdict["column"] for verdict in found["verdicts"]}
    assert judged["RPE, all"] == "rpe_window_p9999_mas"
