"""The start-up of a run that does not begin in its steady state: measured, left out, or the reason for no verdict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.conditions import MEASURED, NEVER
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.settling import judge_settled, start_up
from pointing_analysis.requirements.summary import summarise

MAS = np.pi / 648e6
APE = parse("prob(|APE| < 100 mas) >= 0.95 at 90 % confidence")
RPE = parse("prob(rms RPE(20 ms) < 100 mas) >= 0.95 at 90 % confidence")
DT = 1e-3


def noise(seconds: float, seed: int, memory: float = 0.0) -> FloatArray:
    """Two axes of unit noise; `memory` [s] is the time constant of its correlation."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((round(seconds / DT), 2))
    if not memory:
        return white
    a = np.exp(-DT / memory)
    return np.asarray(lfilter([np.sqrt(1 - a * a)], [1, -a], white, axis=0))


def tone(seconds: float, hz: float, amplitude: FloatArray | float = 1.0) -> FloatArray:
    t = DT * np.arange(round(seconds / DT))
    return np.column_stack([amplitude * np.sin(2 * np.pi * hz * t), 0.0 * t])


def series(values: FloatArray) -> ErrorSeries:
    return ErrorSeries(MAS * values, DT, 5.0, 0)


@pytest.mark.parametrize("memory", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("requirement", [APE, RPE], ids=["APE", "RPE"])
def test_noise_has_no_start_up(memory: float, requirement: object) -> None:
    """In at most one of forty records, 40 s each."""
    found = [start_up(series(noise(40.0, seed, memory)), requirement) for seed in range(40)]  # type: ignore[arg-type]
    assert np.count_nonzero(found) <= 1


@pytest.mark.parametrize(("constant", "size"), [(3.0, 10.0), (3.0, 3.0), (6.0, 5.0)])
def test_a_decay_is_left_out_until_it_is_small(constant: float, size: float) -> None:
    """|e|^2 falls with half of the time constant of e; the time is that at which 0.1 of the level is left."""
    t = DT * np.arange(60_000)
    values = noise(60.0, 3) + size * np.exp(-t / constant)[:, None]
    expected = 0.5 * constant * np.log(size**2 / (0.1 * 1.0))
    assert start_up(series(values), APE) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("hz", [0.756, 11.0, 63.5])
@pytest.mark.parametrize("constant", [50.0, 200.0, 1000.0])
def test_a_tone_that_still_builds_up_is_not_settled(hz: float, constant: float) -> None:
    """From rest at a mode that rings for minutes, and of a level near that of the noise."""
    t = DT * np.arange(55_000)
    grown = series(8.0 * tone(55.0, hz, 1.0 - np.exp(-t / constant)) + 0.3 * noise(55.0, 1))
    assert start_up(grown, APE, [2 * np.pi * hz]) > 0.5 * 55.0


@pytest.mark.parametrize("seed", range(3))
def test_tones_in_their_steady_state_are_settled(seed: int) -> None:
    """Also two that beat, one that the noise hides, and one with no whole number of periods in a segment."""
    lines = (0.756, 11.0, 11.02, 63.5, 101.3)
    values = 0.5 * noise(55.0, seed, 0.02) + sum(
        size * tone(55.0, hz) for hz, size in zip(lines, (5.0, 2.0, 1.5, 3.0, 1e-3))
    )
    omega = [2 * np.pi * hz for hz in lines]
    assert start_up(series(values), APE, omega) == start_up(series(values), RPE, omega) == 0.0


@pytest.mark.parametrize("linewidth", [0.02, 0.5])
def test_a_tone_whose_phase_wanders_is_settled(linewidth: float) -> None:
    """In at most one of forty records, 15 s each."""
    found = []
    for seed in range(40):
        steps = np.sqrt(2 * np.pi * linewidth * DT) * np.random.default_rng(seed).standard_normal(15_000)
        phase = 2 * np.pi * 47.0 * DT * np.arange(15_000) + np.cumsum(steps)
        values = np.column_stack([5.0 * np.sin(phase), 2.0 * np.cos(phase)])
        found.append(start_up(series(values), RPE, [2 * np.pi * 47.0]))
    assert np.count_nonzero(found) <= 1


def test_a_level_that_still_falls_and_keeps_its_limit_is_judged(tmp_path: Path) -> None:
    t = DT * np.arange(30_000)
    values = np.exp(-t / 60.0)[:, None] * np.array([1.0, 0.5])
    found = judge_settled(APE, bag(tmp_path / "a", values, start_up=MEASURED))
    assert found.verdict.within_limit and found.verdict.status != "not judged"
    rising = bag(tmp_path / "b", np.array([1.0, 0.5]) - values, start_up=MEASURED)
    assert judge_settled(APE, rising).verdict.status == "not judged"


def bag(folder: Path, values: FloatArray, **parameters: object) -> Run:
    requirements = [{"name": one.index, "text": str(one)} for one in (APE, RPE)]
    parameters = {"requirements": requirements, **parameters}
    return Run.open(write_bag(folder, {"truth/los": MAS * values}, parameters=parameters))


@pytest.mark.further
def test_the_verdict_leaves_it_out_and_says_so(tmp_path: Path) -> None:
    """Of the absolute error, which drifts in; the relative error has none."""
    t = DT * np.arange(60_000)
    values = noise(60.0, 3) + 400.0 * np.exp(-t / 4.0)[:, None]
    run = bag(tmp_path / "a", values, start_up=MEASURED)
    ape, rpe = (judge_settled(requirement, run) for requirement in (APE, RPE))
    assert ape.verdict.status == "compliant" and "measured start-up and excluded" in ape.remark
    assert rpe.verdict.status == "compliant" and not rpe.remark
    assert ape.remark in summarise(run).problems
    usual, asked = judge_settled(APE, bag(tmp_path / "b", values)), judge_settled(APE, run, 5.0)
    assert usual.verdict.status == asked.verdict.status == "not enough data" and not usual.remark + asked.remark


@pytest.mark.further
def test_a_run_that_is_not_settled_is_not_judged(tmp_path: Path) -> None:
    t = DT * np.arange(40_000)
    values = tone(40.0, 0.756, 60.0 * (1.0 - np.exp(-t / 200.0)))
    rows = summarise(bag(tmp_path / "a", values, start_up=MEASURED, tones_rad_s=[2 * np.pi * 0.756])).rows
    why = "not settled: its start-up takes longer than 40 s (a longer run, or analyse --transient SECONDS)"
    assert rows[0].status == "not judged" and rows[0].verdict_text == f"not judged: {why}"
    rows = summarise(bag(tmp_path / "b", values, transient_s=0, tones_rad_s=[2 * np.pi * 0.756])).rows
    assert rows[0].status != "not judged", "a run that is known to be steady"


def test_an_unstable_loop_is_never_within_its_limit(tmp_path: Path) -> None:
    """What keeps its limit now: of a loop that diverges a longer run would not show it."""
    values = 1e-3 * noise(20.0, 3)
    for number, known in enumerate(({}, {"start_up": NEVER})):
        run = bag(tmp_path / str(number), values, **known)
        for transient in (None, 1.0):
            verdict = judge_settled(APE, run, transient).verdict
            assert verdict.statement == ("not judged" if known else "compliant"), verdict
    beyond = judge_settled(APE, bag(tmp_path / "beyond", 1e6 * values, start_up=NEVER)).verdict
    assert beyond.status == "not compliant"
