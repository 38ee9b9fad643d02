"""Tables and budgets of the pages are those of runs and of the files beside them."""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import paper_numbers
import pytest
from los_testbed.cli.app import main
from los_testbed.run.summary.pointing_budget_sources import testbed_requirements as requirements_of_the_testbed
from los_testbed.run.summary.pointing_budget_sources import testbed_sources as sources_of_the_testbed
from paper_case import PaperCase
from support.scripts import script

import pointing_analysis
from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import Summary, summarise
from pointing_analysis.requirements.verdict import judge, parse

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/your_spacecraft.md"
NO_QUANTISATION = {"acceleration_step": 0.0, "camera_step": 0.0, "gauge_step": 0.0}
NO_RATES = {"mirror_rate": 0.0, "force_rate": 0.0, "stroke": 0.0}
LIMITS: dict[str, dict[str, float] | None] = {
    "linear": None,
    "`nonlinear=true`": {},
}
ALONE = {
    "filters": ({**NO_QUANTISATION, **NO_RATES}, 35.0),
    "rates and stroke": ({**NO_QUANTISATION, "cut_off": 0.0}, 33.4),
    "quantisation": ({**NO_RATES, "cut_off": 0.0}, 34.0),
}
"""Limits of one kind, and the RPE with them [mas]: 33.4 without any."""


def rows() -> list[tuple[str, str, float, float, str]]:
    found = re.findall(
        r"^\| `([\w+]+)`, (.*?) \| (.*?) arcsec \| (.*?) mas \| (.*?) \|$", PAGE.read_text("utf-8"), re.M
    )
    return [(loop, kind, float(ape), float(rpe), limit.strip("*")) for loop, kind, ape, rpe, limit in found]


def test_the_table_has_all_kinds() -> None:
    assert {kind for _, kind, *_ in rows()} == set(LIMITS)
    assert {loop for loop, *_ in rows()} == {"fsm", "fsm+pma"}


@pytest.mark.slow
@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row[0]}-{row[1]}")
def test_a_row_of_the_table(row: tuple[Any, ...], tmp_path: Path) -> None:
    loop, kind, ape, rpe, limit = row
    found = judged_with(loop, LIMITS[kind], tmp_path)
    assert found.ape_quantile == pytest.approx(ape, rel=0.02)
    assert found.rpe_windows_quantile == pytest.approx(rpe, rel=0.02)
    kept = re.fullmatch(r"met|exceeded", limit).group()
    strictest = min((row for row in found.rows if "RPE" in row.quantity), key=lambda row: row.limit)
    assert (strictest.value < strictest.limit) == (kept == "met")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALONE)
def test_a_kind_of_limit_alone(kind: str, tmp_path: Path) -> None:
    limits, rpe = ALONE[kind]
    assert judged_with("fsm+pma", limits, tmp_path).rpe_windows_quantile == pytest.approx(rpe, rel=0.005)


def judged_with(loop: str, changed: dict[str, float] | None, folder: Path) -> Summary:
    """Figures of a run of 30 s with these limits of the devices, or with none."""
    options = ["run", "--mode", "inprocess", "--duration", "30", "--loop", loop, "--no-report"]
    if changed is not None:
        parameters = folder / "limits.toml"
        parameters.write_text(
            "base = 'reference'\n[device_limits]\n" + "".join(f"{key} = {value}\n" for key, value in changed.items())
        )
        options += ["--set", "nonlinear=true", "--parameters", str(parameters)]
    assert main([*options, "--output", str(folder / "bag")]) == 0
    return summarise(Run.open(folder / "bag"))


SHIPPED = Path(pointing_analysis.__file__).with_name("budget") / "budget_testbed.toml"
INDICES = [
    "prob(|RPE(20 ms)| < 100 mas) >= 0.9 at 95 % confidence",
    "prob(|RPE(20 ms)| < 100 mas) >= 0.997 at 95 % confidence",
    "prob(|APE| < 10 arcsec) >= 0.5 at 95 % confidence",
    "prob(|APE| < 10 arcsec) >= 0.9 at 95 % confidence",
]


@pytest.mark.slow
def test_the_shipped_budget_agrees_with_a_run(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    options = ["--mode", "inprocess", "--scenario", "imbalance", "--loop", "fsm+pma", "--seed", "3", "--no-report"]
    assert main(["run", "--duration", "65", *options, "--output", str(bag)]) == 0
    requirements = tuple(parse(text) for text in INDICES)
    budget = replace(
        load_budget(SHIPPED, sources_of_the_testbed, requirements_of_the_testbed),
        draws=30_000,
        requirements=requirements,
    )
    run = Run.open(bag)
    for verdict in evaluate(budget):
        measured = judge(verdict.requirement, [run], 5.0).quantile
        assert measured.lower / RAD_PER_MAS <= verdict.level <= measured.upper / RAD_PER_MAS, verdict.requirement


PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/extend/regenerate.md")


@pytest.fixture(scope="module")
def filler():
    return script(ROOT / "docs" / "fill_tables.py")


def test_examples(filler) -> None:
    result = doctest.testmod(filler)
    assert result.attempted >= 3
    assert result.failed == 0


def test_pages_have_the_markers_once(filler) -> None:
    for name in filler.PAGES:
        page = filler.PAGES[name].read_text("utf-8")
        assert filler.filled(page, name, "TABLE").count("TABLE") == 1


def test_the_readme_shows_the_results_of_the_results_page(filler) -> None:
    """Both tables of worst cases come from one run of the stages."""
    results = (ROOT / "docs" / "results.md").read_text("utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    assert filler.worst_case(results.split("<!-- stages:begin -->")[1].split("<!-- stages:end -->")[0]) in readme


def test_the_page_of_the_paper_has_the_numbers_of_the_files_beside_it(filler) -> None:
    """After a change of the telescope or of a design `make paper` has been run."""
    text = (ROOT / "docs/figures/paper/results.json").read_text("utf-8")
    of, page = (
        paper_numbers.names(PaperCase.of(ROOT / "examples/paper")),
        filler.PAGES["paper_gammas"].read_text("utf-8"),
    )
    assert of.items() <= json.loads(text).items()
    for name in ("paper_gammas", "paper_decades", "paper_reduction"):
        assert filler.filled(page, name, filler.table_of(name, text)) == page


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gammas", ""),
        ("stages", "nothing"),
        ("other", "| a |"),
        ("run", ""),
        ("worst_case", ""),
        ("paper_gammas", "{}"),
    ],
)
def test_errors_do_not_change_the_page(tmp_path: Path, name: str, text: str) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- gammas:begin -->\n<!-- gammas:end -->\n")
    command = [sys.executable, str(ROOT / "docs" / "fill_tables.py"), name, "--page", str(page)]
    done = subprocess.run(command, input=text, text=True, capture_output=True, timeout=600)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert page.read_text() == "<!-- gammas:begin -->\n<!-- gammas:end -->\n"


def test_targets_of_make_exist() -> None:
    text = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"^([a-z-]+):", text, flags=re.MULTILINE))
    for name in PAGES:
        named = set(
            re.findall(
                r"`?make ([a-z-]+)\b",
                "\n".join(re.findall(r"`[^`]+`|^make .*$", (ROOT / name).read_text("utf-8"), flags=re.MULTILINE)),
            )
        )
        assert named <= targets, name
