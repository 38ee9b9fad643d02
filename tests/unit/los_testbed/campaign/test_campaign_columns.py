"""Columns that a member of a campaign has for any requirement on single runs, and what is made of them."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.meanings import RequirementColumns, meaning
from los_testbed.campaign.member import COMMON_METRICS, MemberEvaluator, _Record, finished_row
from los_testbed.campaign.overview import campaign_summary
from los_testbed.campaign.page import write_page
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.cli.app import main
from los_testbed.cli.campaign import _show
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import identity
from rich.console import Console

from pointing_analysis.image.optics import optics_of
from pointing_analysis.indices.errors import knowledge_error, performance_error
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.requirement import Requirement, parse
from pointing_analysis.requirements.verdict import index_samples

REFERENCE = MemberParameters.of()

pytestmark = pytest.mark.usefixtures("without_pictures")

TAIL = ">= 0.9 at 95 % confidence"
JUDGED = {
    "time": "prob(|APE| < 1 arcsec) >= 0.95 at 95 % confidence",
    "axis": "prob(|APE_y| < 0.05 arcsec) >= 0.9 at 95 % confidence",
    "long": "prob(rms RPE(250 ms) < 20 mas) >= 0.7 at 95 % confidence",
    "drift": "prob(|PDE(100 ms, 0.5 s)| < 5 mas) >= 0.8 at 95 % confidence",
    "image": "prob(MTF(20 ms, Nyquist) > 0.7) >= 0.9 at 95 % confidence",
    "energy": "prob(EE80(20 ms) < 100 mas) >= 0.95 at 95 % confidence",
    "knowledge": "prob(|AKE_x| < 0.04 arcsec) >= 0.9 at 95 % confidence",
    "instants": "prob(|RKE(40 ms)| < 10 mas) >= 0.9 at 95 % confidence",
}
"""Of another telescope, with limits within the range of its members."""
LONG = 0.25
"""Window of its strictest requirement on the relative error [s]: that of its columns without a window."""

OTHERS = {
    "longest": "prob(rms RPE(30 s) < 40 mas) >= 0.9 at 95 % confidence",
    "exposure": "prob(Strehl(2 s) > 0.5) >= 0.9 at 95 % confidence",
    "again": "prob(|PRE(1 s)| < 40 mas) >= 0.9 at 95 % confidence",
}
"""That runs of two seconds cannot be judged by: an exposure of 2 s has one sample more."""


def telescope(path: Path, requirements: dict[str, str], text: str = "") -> str:
    """Parameter file of a telescope with more requirements than the reference."""
    entries = "".join(f'[[requirement]]\nname = "{name}"\ntext = "{r}"\n' for name, r in requirements.items())
    path.write_text('base = "reference"\n' + entries + text, "utf-8")
    return str(path)


def base_of(parameters: str, **changes: Any) -> RunConfig:
    return replace(
        RunConfig(mode="inprocess", loop="fsm+pma", scenario="design", duration=2.0, parameters=parameters), **changes
    )


def drawn(rng: np.random.Generator) -> Requirement:
    """Any requirement on single runs."""
    times = [
        f"{rng.choice([2, 20, 20.001, 250, 33.3333, 33.3333337])} ms",
        f"{rng.choice([1, 10, 1234.567, 1234.568])} s",
    ]
    first, limit = str(rng.choice(times)), float(rng.choice([0.1, 0.25, 0.30000001, 0.3]))
    unit, axis = str(rng.choice(["mas", "arcsec"])), str(rng.choice(["", "_x", "_y"]))
    frequency = str(rng.choice(["Nyquist", "0.5 Nyquist", "8 cycles/arcsec", "8 cycles/mas", "8.5 cycles/mas"]))
    texts = [f"|{index}{axis}| < {limit} {unit}" for index in ("APE", "AKE")]
    texts += [f"|{index}{axis}({first})| < {limit} {unit}" for index in ("MPE", "RPE", "MKE", "RKE")]
    texts += [f"rms {index}{axis}({first}) < {limit} {unit}" for index in ("RPE", "RKE")]
    texts += [f"|PDE{axis}({', '.join(times)})| < {limit} {unit}", f"ellipticity({first}) < {limit}"]
    texts += [f"MTF({first}, {frequency}) > {limit}", f"Strehl({first}) > {limit}"]
    texts += [f"{index}({first}) < {limit} {unit}" for index in ("EE50", "EE80")]
    return parse(f"prob({rng.choice(texts)}) >= {rng.choice([0.1, 0.5, 0.95, 0.997, 0.9973])} at 95 % confidence")


def test_names_tell_requirements_apart_and_have_a_meaning() -> None:
    """What differs between two of them is in their names; limits of the present columns have six digits."""
    rng = np.random.default_rng(28)
    values: dict[str, Any] = {}
    shares: dict[str, Any] = {}
    for r in (drawn(rng) for _ in range(4000)):
        columns = RequirementColumns.of(r)
        index = r.index, r.axis, r.times, r.of_windows, r.frequency
        assert values.setdefault(columns.worst, index) == index
        assert values.setdefault(columns.quantile, (index, r.probability)) == (index, r.probability)
        six = columns.worst in ("ape_max_arcsec", "rpe_window_max_mas")
        limit = f"{r.limit / columns.scale:{'.6g' if six else '.12g'}}"
        for name in (columns.share, columns.effective):
            assert shares.setdefault(name, (name == columns.share, index, limit))[1:] == (index, limit)
    assert len(values) > 500
    for name in (*values, *shares):
        assert re.fullmatch(r"[a-z0-9_.+-]+", name)
        assert meaning(name) != name.replace("_", " "), name
    assert len({meaning(name) for name in (*values, *shares)}) == len({*values, *shares})


SHARES = ("ape_above_10_arcsec", "rpe_window_above_100_mas", "rpe_window_above_40_mas")
"""Of the reference telescope."""


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Telescope with requirements of many kinds, a member's row, and the bag of that member's recorded run."""
    folder = tmp_path_factory.mktemp("columns")
    file = telescope(folder / "mine.toml", {**JUDGED, **OTHERS})
    base = base_of(file)
    row = {**dict(zip(REFERENCE.columns, map(float, members("uniform", 1, 7)[0]))), "seed": int(member_seeds(1, 7)[0])}
    found = MemberEvaluator.of(base).row(0, row, "time")
    paths = f"--parameters {shlex.quote(file)} --output {shlex.quote(str(folder / 'bag'))}"
    line = REFERENCE.command(row, f" --duration 2 --loop fsm+pma --scenario design {paths}")
    assert main([*shlex.split(line)[1:], "--no-report", "--json"]) == 0
    return {"base": base, "row": found, "bag": folder / "bag"}


def test_columns_are_what_analyse_says_of_the_recorded_run(
    evaluated: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Same member, same seed: quantile, share and effective samples to all printed digits; the worst to the bit."""
    capsys.readouterr()
    assert main(["analyse", str(evaluated["bag"]), "--json"]) == 0
    told = {r["name"]: r for r in json.loads(capsys.readouterr().out.splitlines()[-1])["requirements"]}
    row, run = evaluated["row"], Run.open(evaluated["bag"])
    assert row["status"] == "ok" and set(JUDGED) <= set(told)
    for name, text in JUDGED.items():
        r = parse(text)
        columns, said = RequirementColumns.of(r, LONG), told[name]
        assert columns.unit == said["unit"]
        printed = [float(f"{row[c]:.6g}") for c in (columns.quantile, columns.share, columns.effective)]
        assert printed == [said["quantile"], said["exceeding"], said["effective_samples"]], name
        error = (knowledge_error if r.index in ("AKE", "RKE") else performance_error)(run)
        values = index_samples(error, r, optics_of(run)).values
        worst = values.min() if r.lower else values.max()
        assert row[columns.worst] == worst / columns.scale
    exceeding = [told[name]["exceeding"] for name in JUDGED]
    assert sum(0 < share < 1 for share in exceeding) >= 4, "limits within the range of the samples"


def test_what_a_campaign_cannot_judge_is_named_with_the_reason(
    evaluated: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    asked = Campaign.of(evaluated["base"], "uniform", 1, 7, "time", identity(evaluated["base"]))
    told = {**JUDGED, **OTHERS}
    assert {r.name for r in asked.judged} == {*told, "APE", "RPE, fine", "RPE, finest"} - set(OTHERS)
    row = evaluated["row"]
    assert not any(RequirementColumns.of(parse(text), LONG).worst in row for text in OTHERS.values())
    folder = ResultFolder(tmp_path / "c")
    folder.open(asked, False)
    folder.write(0, [row])
    summary = campaign_summary(asked, folder)
    assert summary["not_judged"] == [
        f"{OTHERS['longest']}: the run must be at least as long as the window of 30 s, got 2 s",
        f"{OTHERS['exposure']}: the run must last for one exposure of 2 s and a sample, got 2000 samples of 0.001 s",
        f"{OTHERS['again']}: the PRE compares several runs, a campaign has one per member",
    ]
    assert {v["requirement"] for v in summary["verdicts"]} == {*JUDGED, "APE", "RPE, fine", "RPE, finest"}
    _show(Console(width=300), {**summary, "report": "r.html"}, folder)
    shown = capsys.readouterr().out
    assert all(f"no campaign verdict on {text}" in shown for text in summary["not_judged"])
    page = write_page(asked, folder, summary, tmp_path / "r.html").read_text("utf-8")
    assert "got 2000 samples of 0.001 s; prob(|PRE(1 s)|" in page


@pytest.mark.parametrize(
    ("text", "share"),
    [
        ("rms RPE(250 ms) < 1 arcsec", 1 / 4),
        ("|APE_x| < 1 arcsec", 1 / 1000),
        ("Strehl(20 ms) > 0.001", 2 / 49),
        ("|MKE(250 ms)| < 1 arcsec", 0.0),
    ],
)
def test_missing_windows_count_in_the_share(text: str, share: float) -> None:
    """The line of sight of tick 300 is missing: the end of one exposure and the start of the next."""
    values = 1e-9 * np.random.default_rng(1).standard_normal((1000, 4))
    values[300, :2] = np.nan
    requirement = parse(f"prob({text}) {TAIL}")
    found = _Record(values, 1.0).metrics(0, [requirement], 0.02, RunParts(RunConfig()).optics)
    columns = RequirementColumns.of(requirement)
    assert found[columns.share] == pytest.approx(share, rel=1e-12) and np.isfinite(found[columns.worst])


def test_rows_from_before_a_requirement_had_columns_are_computed_again(tmp_path: Path) -> None:
    """A folder of the same campaign with other columns is resumed, not refused."""
    pytest.importorskip("pyarrow")
    now = tuple(f"{share}_{of_it}" for share in SHARES for of_it in ("effective", "unseen"))
    mine = telescope(tmp_path / "mine.toml", JUDGED)
    for file, own, kept in ((None, now, {0, 1}), (None, (), set()), (mine, now, set())):
        asked = Campaign.of(replace(base_of(file or ""), parameters=file), "uniform", 20, 1, "time", {"version": "1"})
        before = (*COMMON_METRICS, *SHARES, *own)
        folder = ResultFolder(tmp_path / f"old-{bool(file)}-{len(own)}")
        folder.open(asked, False)
        for number, chunk in asked.chunks():
            folder.write(number, [finished_row(m["index"], m, dict.fromkeys(before, 1.0), "ok", "") for m in chunk])
        assert folder.open(asked, True) == kept
        for number, chunk in asked.chunks(frozenset(kept)):
            metrics = dict.fromkeys(asked.metrics, 1.0)
            folder.write(number, [finished_row(m["index"], m, metrics, "ok", "") for m in chunk])
        assert folder.open(asked, True) == {0, 1}
        assert campaign_summary(asked, folder)["members"] == 20
