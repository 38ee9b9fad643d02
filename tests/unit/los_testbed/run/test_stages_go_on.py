"""Stages that were interrupted: what is left is whole, and the same plan goes on with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.run import stages
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.stages import PLAN, Plan, StageRun, finish, perform

from los_design.synthesis.store import load_designs
from pointing_analysis.indices.errors import performance_error
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import run_end

PLANNED = Plan(RunConfig(duration=1.1, mode="inprocess"), Path(), ("imbalance",), 1, ("all",))


def interrupted(plan: Plan, monkeypatch: pytest.MonkeyPatch, after: int) -> list[str]:
    """Interrupt the plan in the run behind `after` finished ones; the runs that were started."""
    started: list[str] = []

    def progress(run: StageRun, ticks: int) -> None:
        if run.name not in started:
            started.append(run.name)
        if len(started) > after and ticks:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        perform(plan, progress)
    return started


@pytest.mark.slow
def test_finished_runs_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(PLANNED, folder=tmp_path / "s")
    first, second = interrupted(plan, monkeypatch, 1)
    assert {path.name for path in plan.folder.iterdir()} == {PLAN, first}
    kept = (plan.folder / first / "metadata.yaml").stat().st_mtime_ns

    killed = plan.folder / second  # as SIGKILL leaves it
    killed.mkdir()
    started = interrupted(plan, monkeypatch, 1)
    assert started[0] == second and (plan.folder / first / "metadata.yaml").stat().st_mtime_ns == kept
    results = [r.as_dict() for r in perform(plan)]

    whole = replace(PLANNED, folder=tmp_path / "whole")
    assert [r.as_dict() for r in perform(whole)] == results and len(results) == 4
    finish(whole)
    assert not (whole.folder / PLAN).exists()


@pytest.mark.further
def test_another_plan_does_not_go_on_in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages, "record", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    plan = replace(PLANNED, folder=tmp_path / "s")
    with pytest.raises(KeyboardInterrupt):
        perform(plan)
    other = replace(plan, base=replace(plan.base, seed=plan.base.seed + 1))
    with pytest.raises(ValueError, match="--output must be a new folder or one of the same comparison"):
        perform(other)
    finish(plan)
    (plan.folder / "report.html").write_text("of a comparison that is done", "utf-8")
    with pytest.raises(ValueError, match="--output must be a new folder"):
        perform(plan)


def test_a_ramp_that_leaves_the_family_leaves_no_folder(tmp_path: Path) -> None:
    """From the speeds of the scenario imbalance it stays inside, from those of the worst case it does not."""
    ramp = {"wheel_acceleration": [-8.0, 8.0, -8.0, 8.0], "ramp_duration": 100.0}
    base = replace(PLANNED.base, wheel_speed=(30.0, -30.0, 30.0, -30.0), **ramp)  # type: ignore[arg-type]
    plan = replace(PLANNED, base=base, folder=tmp_path / "s", scenarios=("worst_case",))
    with pytest.raises(ValueError, match="at the end of the ramp"):
        perform(plan)
    assert not plan.folder.exists()


@pytest.mark.slow
def test_a_run_that_diverged_is_none_that_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its bag ends where it diverged; the stages that go on after an interrupt say so like those without one."""
    stored = load_designs("implemented")[0]
    file = tmp_path / "k_fsm.json"
    replace(stored, A=2.5 * np.eye(stored.order)).to_file(file)
    base = replace(PLANNED.base, k_fsm=str(file), start="rest")
    plan = replace(PLANNED, base=base, folder=tmp_path / "s", keep=True)
    interrupted(plan, monkeypatch, 3)
    assert (plan.folder / "imbalance-nominal-fsm").exists(), "the run behind it was interrupted"
    results, whole = perform(plan), perform(replace(plan, folder=tmp_path / "whole"))
    assert [(r.note, repr(r.as_dict())) for r in results] == [(r.note, repr(r.as_dict())) for r in whole]
    assert "diverged" in results[2].note


def test_a_run_that_was_interrupted_ends_early_and_is_judged_by_what_it_has(tmp_path: Path) -> None:
    """With the ticks of its messages, also where the signal came behind a block that was written already."""

    def progress(ticks: int) -> None:
        if ticks:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_process(RunConfig(duration=600.0, mode="inprocess", start="rest"), tmp_path / "bag", progress=progress)
    run = Run.open(tmp_path / "bag")
    end = run_end(run.parameters, run.covered_ticks)
    assert end.done == end.covered == len(run["truth/los"]) and end.text.startswith("the run ended early: after ")
    assert not performance_error(run, 0.0).missing
