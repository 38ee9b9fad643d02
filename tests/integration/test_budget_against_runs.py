"""The shipped budget agrees with a run of the testbed within the confidence of the run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from los_testbed.cli.app import main
from los_testbed.run.summary.pointing_budget_sources import testbed_requirements as requirements_of_the_testbed
from los_testbed.run.summary.pointing_budget_sources import testbed_sources as sources_of_the_testbed

import pointing_analysis
from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.verdict import judge, parse

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
