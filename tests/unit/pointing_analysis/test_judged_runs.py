"""No verdict that the data do not carry: short runs, missing samples, runs that have not settled."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from support.slow_cases import slow

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report.source_share import SourceShare, source_table
from pointing_analysis.requirements import verdict as requirements
from pointing_analysis.requirements.conditions import MEASURED, NEVER
from pointing_analysis.requirements.settling import is_settled, judge_settled, start_up
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.requirements.verdict import judge, parse
from titop_plant.telescope.load import load_telescope

MAS = np.pi / 648_000_000
OF_TELESCOPE = load_telescope().to_mapping()["requirement"]


@pytest.fixture
def noise_run(tmp_path):
    """Runs of white noise; the 99.7 % quantile of its radial RPE in 20 ms is about 3.41 sqrt(0.95) sigma."""

    def make(sigma_mas: float = 10.0, seconds: float = 30.0, seed: int = 0, **parameters) -> Run:
        los = sigma_mas * MAS * np.random.default_rng(seed).standard_normal((round(1000 * seconds), 2))
        folder = tmp_path / f"{sigma_mas}-{seconds}-{seed}-{len(parameters)}"
        return Run.open(write_bag(folder, {"truth/los": los}, parameters={"transient_s": 0, **parameters}))

    return make


LIMITED = "prob(|RPE(20 ms)| < {limit} mas) >= 0.997 at 95 % confidence"


def test_compliant_not_compliant_and_not_enough(noise_run) -> None:
    run = noise_run(10.0, 30.0)
    quantile = 10 * math.sqrt(0.95) * 3.40856
    good = judge(parse(LIMITED.format(limit=60)), [run])
    assert good.status == "compliant"
    assert good.quantile.value / MAS == pytest.approx(quantile, rel=0.03)
    assert good.quantile.lower < good.quantile.value < good.quantile.upper < 60 * MAS
    assert judge(parse(LIMITED.format(limit=20)), [run]).status == "not compliant"
    assert judge(parse(LIMITED.format(limit=34)), [run]).status == "not enough data"


def test_too_short_a_run_is_never_compliant_and_says_how_long_it_takes(noise_run) -> None:
    """998 independent exposures of 20 ms are 19.96 s, however small the error."""
    verdict = judge(parse(LIMITED.format(limit=1000)), [noise_run(1.0, 10.0)])
    assert (verdict.status, verdict.exceeding) == ("not enough data", 0.0)
    assert verdict.effective == 500
    assert verdict.seconds_needed == pytest.approx(19.96)
    assert judge(parse(LIMITED.format(limit=1000)), [noise_run(1.0, 19.9)]).status == "not enough data"
    assert judge(parse(LIMITED.format(limit=1000)), [noise_run(1.0, 19.98)]).status == "compliant"


@pytest.mark.further
@pytest.mark.parametrize("pole", [slow(0.0), 0.9])
def test_wrong_verdicts_are_as_rare_as_the_confidence_says(pole: float) -> None:
    """At the very limit either verdict is wrong: each may be given in 5 % of the runs, correlated or not."""
    from scipy.signal import lfilter

    from pointing_analysis.indices.confidence import effective_number

    p, n, runs = 0.98, 5000, 400
    limit = math.sqrt(-2 * math.log(1 - p))
    requirement = parse(f"prob(|APE| < {limit} rad) >= {p} at 95 % confidence")
    rng = np.random.default_rng(11)
    white = rng.standard_normal((runs, 2, n + 200))
    e = lfilter([math.sqrt(1 - pole**2)], [1, -pole], white, axis=2)[:, :, 200:]
    norms = np.hypot(e[:, 0], e[:, 1])
    found = [requirements.decide(requirement, r, effective_number(r), 5.0).status for r in norms]
    # 5 % of 400 are 20; 30 are more than two standard deviations above.
    assert found.count("compliant") <= 30
    assert found.count("not compliant") <= 30
    assert found.count("compliant") + found.count("not compliant") > 0


@pytest.mark.further
def test_a_recording_without_requirements_has_metrics_and_no_verdict(noise_run) -> None:
    """Nobody's limits are taken for those of another; damaged ones are named."""
    found = summarise(noise_run(2.0, 25.0, loop="fsm"))
    assert found.verdicts == () and not found.requirements_known and found.ape_quantile > 0
    assert found.as_dict()["requirements"] == [] and not found.as_dict()["requirements_known"]
    for damaged in ("APE", [{"name": "no text"}], [{"text": "APE below 1"}], [{"text": 3}], ["prob"]):
        wrong = summarise(noise_run(2.0, 25.0, 1 + len(str(damaged)), requirements=damaged))
        assert wrong.verdicts == () and any("requirements of the recording cannot be read" in p for p in wrong.problems)
    given = [parse("prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence")]
    assert len(summarise(noise_run(2.0, 25.0, 99), requirements=given).verdicts) == 1
    none_applies = summarise(noise_run(2.0, 25.0, 77, loop="isolator", requirements=OF_TELESCOPE[2:]))
    assert none_applies.verdicts == () and none_applies.requirements_known


@pytest.mark.parametrize("n", [0, 1, 15])
def test_runs_too_short_for_anything(tmp_path, n: int) -> None:
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": np.zeros((n, 2))}))
    with pytest.raises(ValueError, match=r"at least two samples|longer than its start-up transient"):
        summarise(run)


def test_shorter_than_a_window_gives_the_ape_alone(tmp_path) -> None:
    los, parameters = np.full((15, 2), MAS), {"requirements": OF_TELESCOPE}
    s = summarise(Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, parameters=parameters)), transient=0.0)
    assert s.ape_max == pytest.approx(math.sqrt(2) * 1e-3)
    assert math.isnan(s.rpe_rms)
    assert {v.status for v in s.verdicts} == {"not enough data", "not judged"}
    assert s.as_dict()["rpe_mas"] == dict.fromkeys(("rms", "p997", "windows_p997"))


def test_nan_in_the_truth_is_no_zero(tmp_path) -> None:
    los = MAS * np.random.default_rng(0).standard_normal((3000, 2))
    los[1500:1510] = np.nan
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}))
    s = summarise(run)
    assert s.windows_skipped == 1
    assert any("10 messages with NaN" in p for p in s.problems)
    blank = Run.open(write_bag(tmp_path / "blank", {"truth/los": np.full((3000, 2), np.nan)}))
    with pytest.raises(ValueError, match="must have finite samples"):
        summarise(blank)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95, 0.997])
def test_the_quantile_is_below_the_limit_exactly_where_the_limit_is_kept(probability: float) -> None:
    """Two of 500 windows above 40 mas are more than 0.3 %: no quantile of 38 mas may stand beside that verdict."""
    rng = np.random.default_rng(0)
    for size in (*range(1, 40), 500, 1000, 1999):
        values = rng.exponential(20 * MAS, size)
        for rank in {0, size // 2, size - 1, max(size - 2, 0), int(probability * size) % size}:
            limit = np.sort(values)[rank] * (1 + 1e-9) / MAS
            asked = parse(f"prob(rms RPE(20 ms) < {limit:.12g} mas) >= {probability} at 95 % confidence")
            verdict = requirements.decide(asked, values, float(size), 1.0)
            assert verdict.within_limit == (verdict.quantile.value < asked.limit), (size, rank)


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
    tones = sum(size * tone(55.0, hz) for hz, size in zip(lines, (5.0, 2.0, 1.5, 3.0, 1e-3)))
    values = 0.5 * noise(55.0, seed, 0.02) + tones
    omega = [2 * np.pi * hz for hz in lines]
    assert start_up(series(values), APE, omega) == start_up(series(values), RPE, omega) == 0.0


def test_a_source_that_still_builds_up_is_marked() -> None:
    """Its error in a table would be that of the seconds that were simulated."""
    t = DT * np.arange(15_000)
    grown = ErrorSeries(MAS * tone(15.0, 11.0, 1.0 - np.exp(-t / 40.0)), DT, 5.0, 0)
    steady = ErrorSeries(MAS * tone(15.0, 11.0), DT, 5.0, 0)
    assert is_settled(steady, 0.02, [2 * np.pi * 11.0]) and not is_settled(grown, 0.02, [2 * np.pi * 11.0])
    rows = source_table([SourceShare("cooler", "cooler", "body", 1.0, 2.0, 1.0, settled=False)])
    assert rows.rows[0][0] == "cooler, not settled"


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
    why = "not settled: its level rises through 40 s (a longer run, or analyse --transient SECONDS)"
    assert rows[0].status == "not judged" and rows[0].verdict_text == f"not judged: {why}"
    rows = summarise(bag(tmp_path / "b", values, transient_s=0, tones_rad_s=[2 * np.pi * 0.756])).rows
    assert rows[0].status != "not judged", "a run that is known to be steady"


@pytest.mark.parametrize("begin", [6.0, 10.0, 12.0])
def test_a_fault_late_in_a_run_is_no_start_up(tmp_path: Path, begin: float) -> None:
    """White noise that is 20 times as large from a time on: beyond the limit of the RPE, within that of the APE."""
    values = noise(20.0, 5) * np.where(DT * np.arange(20_000) < begin, 1.0, 20.0)[:, None]
    run = bag(tmp_path / "a", 10.0 * values, start_up=MEASURED)
    rpe, far = parse("prob(rms RPE(20 ms) < 100 mas) >= 0.95 at 95 % confidence"), parse(str(APE).replace("1 ", "9 "))
    found = judge_settled(rpe, run).verdict
    assert not found.within_limit and found.status in ("not compliant", "not enough data")
    assert "start-up" not in judge_settled(far, run).verdict.note


@pytest.mark.parametrize(("begin", "end"), [(5.0, 12.0), (12.0, 25.0), (8.0, 15.0)])
def test_what_is_worse_for_a_while_is_no_start_up(tmp_path: Path, begin: float, end: float) -> None:
    """An observer that failed from 12 to 25 s: 24 s were "measured start-up and excluded"."""
    t = DT * np.arange(60_000)
    values = noise(60.0, 5) * np.where((t >= begin) & (t < end), 10.0, 1.0)[:, None]
    run = bag(tmp_path / "a", 100.0 * values, start_up=MEASURED)
    limit = parse("prob(|APE| < 500 mas) >= 0.9 at 95 % confidence")
    for requirement in (limit, parse("prob(rms RPE(20 ms) < 500 mas) >= 0.9 at 95 % confidence")):
        found = judge_settled(requirement, run)
        assert found.verdict.status in ("not judged", "not compliant", "not enough data") and not found.remark
    decays = 100.0 * noise(60.0, 5) * (1.0 + 9.0 * np.exp(-t / 4.0))[:, None]
    started = judge_settled(limit, bag(tmp_path / "b", decays, start_up=MEASURED))
    assert started.verdict.status == "compliant" and "measured start-up and excluded" in started.remark


@pytest.mark.parametrize("lost", [["truth/los"], ["truth/los", "isolator/accel"]])
def test_the_end_of_a_run_is_that_of_its_report_whatever_was_recorded(tmp_path: Path, lost: list[str]) -> None:
    """The quiet 12 s of 20 s are recorded; what is missing counts as above the limit."""
    signals = {"truth/los": 10.0 * MAS * noise(20.0, 1), "isolator/accel": np.zeros((20_000, 6))}
    signals = {name: rows[: 12_000 if name in lost else 20_000] for name, rows in signals.items()}
    requirement = "prob(rms RPE(20 ms) < 100 mas) >= 0.9 at 95 % confidence"
    ran = {"duration": 20.0, "rate_hz": 1000, "statistics": {"plant": {"ticks": "20000", "planned_ticks": "20000"}}}
    for number, known in enumerate(({}, ran)):
        path = write_bag(tmp_path / str(number), signals, parameters=known)
        found = summarise(Run.open(path), requirements=[parse(requirement)])
        (row,) = found.rows
        assert (row.status == "compliant") == (not known), row.verdict_text
    assert found.samples_lost == 8000 * len(lost)


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
    values[-len(values) // 18 :] *= 1e6  # one event above the limit, which a longer run of a stable loop might allow
    stable, unstable = (
        judge_settled(APE, bag(tmp_path / start, values, start_up=start)).verdict for start in (MEASURED, NEVER)
    )
    assert stable.statement.startswith("above limit; not yet demonstrated"), stable
    assert unstable.statement == "not judged" and unstable.note == "the loop is unstable"


@pytest.mark.parametrize("seconds", [9.0, 10.0])
def test_a_brief_start_up_behind_the_usual_one_leaves_a_run_judged(tmp_path: Path, seconds: float) -> None:
    """An observer that dies as the judged half begins: some large windows, then a constant level above the limit."""
    t = DT * np.arange(round(seconds / DT)) - 0.5 * seconds
    size = np.where(t < 0.0, 5.0, np.where(t < 0.06, 400.0, 120.0))
    rpe = parse("prob(rms RPE(20 ms) < 100 mas) >= 0.95 at 95 % confidence")
    found = judge_settled(rpe, bag(tmp_path / "a", noise(seconds, 5) * size[:, None], start_up=MEASURED))
    assert found.verdict.status == "not compliant"


def test_a_rig_that_failed_lacks_the_frames_up_to_the_planned_end(tmp_path: Path) -> None:
    """Its camera stands for the line of sight: 4 of 10 s were "compliant", nothing missing."""
    from pointing_analysis.report.report import report_content

    frames = {"camera/los": 10.0 * MAS * noise(4.0, 1)[::20], "isolator/accel": np.zeros((4000, 6))}
    ticks = {"ticks": "4000", "planned_ticks": "10000"}
    requirement = parse("prob(|APE| < 100 mas) >= 0.9 at 60 % confidence")
    for number, (failure, status) in enumerate((({"failure": "read failed"}, "not enough data"), ({}, "compliant"))):
        known = {"device": "my:Rig", "duration": 10.0, "rate_hz": 1000, "mode": "realtime"}
        known |= {"statistics": {"plant": ticks | failure}}
        run = Run.open(write_bag(tmp_path / str(number), frames, periods={"camera/los": 20}, parameters=known))
        verdict = judge(requirement, [run], 0.0)
        assert verdict.status == status and verdict.missing == (300 if failure else 0)
        text = str(report_content([run], requirements=[requirement]))
        assert "from the camera, with its noise" in text and "true line of sight recorded" not in text
        assert summarise(run, requirements=[requirement]).ticks == pytest.approx(10_000 if failure else 4000, abs=20)
