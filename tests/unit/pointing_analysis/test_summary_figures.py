"""Every figure of a summary against samples whose figures are known; every sentence about a damaged bag."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import metrics
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.records import BagError, RefutedBagError
from pointing_analysis.read.recorded_sensors import METADATA, RecordedSensor, sensors_of
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import run_end
from pointing_analysis.read.series import series
from pointing_analysis.report.report import render
from pointing_analysis.report.signal_files import signals_of
from pointing_analysis.requirements.exposure import Probabilities
from pointing_analysis.requirements.recording_state import missing_ends
from pointing_analysis.requirements.requirement import entries
from pointing_analysis.requirements.summary import (
    Knowledge,
    Performance,
    Summary,
    applicable,
    summarise,
    summarise_all,
)
from pointing_analysis.requirements.verdict import parse
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS

DT = 1e-3
NOISE = RAD_PER_MAS * np.random.default_rng(7).standard_normal((3000, 2)) + 5 * RAD_PER_MAS


def upper_rank(values: Any, p: float) -> float:
    """Smallest of the samples that no more than 1 - p of them exceed."""
    x = np.sort(values)
    return float(next(v for v in x if np.mean(x > v) <= 1 - p + 1e-12))


MANY = RAD_PER_MAS * np.random.default_rng(9).standard_normal((10_000, 2))
"""Of 500 windows two may be above the 99.7 % quantile, but for one: it is not the largest."""


@pytest.mark.parametrize(("errors", "windows"), [(NOISE, 150), (MANY, 500), (NOISE[:20], 1)], ids=["150", "500", "1"])
def test_performance(errors: FloatArray, windows: int) -> None:
    found, w = Performance.of(errors, DT, 0.02), metrics.windows(errors, DT, 0.02)
    radial, instants = np.hypot(*errors.T), np.hypot(*metrics.rpe_instant(errors, DT, 0.02).T)
    assert found.ape_max == pytest.approx(radial.max() / RAD_PER_ARCSEC)
    assert found.ape_quantile == pytest.approx(upper_rank(radial, 0.997) / RAD_PER_ARCSEC)
    assert found.rpe_axis == pytest.approx(w.rpe_rms / RAD_PER_MAS)
    assert found.rpe_rms == pytest.approx(math.hypot(*found.rpe_axis))
    assert found.rpe_quantile == pytest.approx(upper_rank(instants, 0.997) / RAD_PER_MAS)
    sizes = np.sqrt(w.variance.sum(axis=1)) / RAD_PER_MAS
    assert found.rpe_windows_quantile == pytest.approx(upper_rank(sizes, 0.997))
    assert (found.rpe_windows_quantile < sizes.max() * (1 - 1e-9)) == (windows == 500)
    assert (found.windows, found.windows_skipped) == (windows, 0)
    known = Knowledge.of(errors, DT, 0.02)
    assert known.ake_quantile_arcsec == pytest.approx(found.ape_quantile)
    assert (known.ake_quantile_arcsec < found.ape_max * (1 - 1e-9)) == (windows > 1)


def bag(folder: Path, n: int = 3000, *, lost: tuple[int, ...] = (), **parameters: Any) -> Run:
    """Truth and an accelerometer that lacks some samples."""
    stamps = 10**9 + 10**6 * np.arange(n)
    late = np.delete(stamps, list(lost))
    signals = {"truth/los": NOISE[:n], "m1/accel": np.zeros((len(late), 6))}
    return Run.open(write_bag(folder, signals, stamps={"truth/los": stamps, "m1/accel": late}, parameters=parameters))


def test_figures_of_a_bag(tmp_path: Path) -> None:
    found = summarise(bag(tmp_path / "a", loop="fsm", mode="inprocess", scenario="design", transient_s=1))
    assert (found.loop, found.mode, found.scenario, found.path.name) == ("fsm", "inprocess", "design", "a")
    assert (found.ticks, found.duration, found.transient, found.windows) == (3000, 3.0, 1.0, 100)
    assert (found.samples_lost, found.lost_by_topic, found.camera_dropped, found.problems) == (0, {}, 0, ())
    assert found.knowledge is None and found.budget is not None
    content = found.as_dict()
    assert content["ape_arcsec"] == {"max": float(f"{found.ape_max:.6g}"), "p997": float(f"{found.ape_quantile:.6g}")}
    relative = {"rms": found.rpe_rms, "p997": found.rpe_quantile, "windows_p997": found.rpe_windows_quantile}
    assert content["rpe_mas"] == {name: float(f"{value:.6g}") for name, value in relative.items()}
    counted = {name: content[name] for name in ("ticks", "windows", "transient_s", "knowledge")}
    assert counted == {"ticks": 3000, "windows": 100, "transient_s": 1.0, "knowledge": None}
    assert content["lost_messages"] == {} and content["budget_rpe_mas"]["total"] is not None


def test_the_ends_that_the_truth_lacks_are_lost() -> None:
    """Stamps [ns] of a truth that ends, or begins, a second after all others."""
    for ends in ((0, 9_000_000_000), (1_000_000_000, 10_000_000_000)):
        lost, problems = {"truth/los": 0, "m1/accel": 0}, list[str]()
        missing_ends(lost, problems, {"truth/los": (*ends, 1e-3), "m1/accel": (0, 10_000_000_000, 1e-3)})
        assert lost == {"truth/los": 1000, "m1/accel": 0} and len(problems) == 1


def test_what_is_told_of_lost_samples(tmp_path: Path) -> None:
    gaps = summarise(bag(tmp_path / "gaps", lost=(500, 501, 900), transient_s=0))
    assert gaps.lost_by_topic == {"m1/accel": 3} and gaps.samples_lost == 3
    assert gaps.problems == ("m1/accel: 3 samples missing in 2 gaps",)
    start = summarise(bag(tmp_path / "start", lost=(0, 1, 2), transient_s=0))
    assert start.lost_by_topic == {"m1/accel": 3}
    assert start.problems == ("m1/accel: 3 samples missing at the start or the end of the run",)
    ends = summarise(bag(tmp_path / "ends", lost=(0, 2998, 2999), transient_s=0))
    assert ends.samples_lost == 3 and "m1/accel: 3 samples missing at the start" in ends.problems[0]
    one = summarise(bag(tmp_path / "one", lost=(2999,), transient_s=0))  # the command to the last tick may come late
    assert one.samples_lost == 0 and one.problems == ()
    late = summarise(bag(tmp_path / "late", lost=(2995, 2996, 2997, 2998), transient_s=0))  # a gap, not an end
    assert late.problems == ("m1/accel: 4 samples missing in 1 gap",) and late.samples_lost == 4
    both = summarise(bag(tmp_path / "both", lost=(0, 1, 700), transient_s=0))
    assert both.lost_by_topic == {"m1/accel": 3} and len(both.problems) == 2


def test_a_run_that_failed_is_judged_to_its_planned_end(tmp_path: Path) -> None:
    """What a loop does that has diverged was not seen; nothing was lost, and a run that was shortened is whole."""
    texts = [parse("prob(|APE| < 100 arcsec) >= 0.9 at 90 % confidence")]
    for failure, missing in (("the loop diverged", 2000.0), ("", 0.0)):
        plant = {"ticks": "3000", "planned_ticks": "5000", **({"failure": failure} if failure else {})}
        run = bag(tmp_path / f"failed{len(failure)}", transient_s=0, rate_hz=1000, statistics={"plant": plant})
        found = summarise(run, requirements=texts)
        assert found.verdicts[0].missing == missing and found.samples_lost == 0
        assert (found.verdicts[0].status == "compliant") == (not failure)


def test_samples_before_the_first_and_after_the_last_are_lost() -> None:
    """Numbered messages, or the planned duration, say how many; they belong to the judged span."""
    made = series(None, NOISE, unit="rad", rate=1000.0)
    found = summarise(replace(made, topic=replace(made["truth/los"], lost_before=2, lost_after=3)), transient=0.0)
    assert found.lost_by_topic == {"truth/los": 5}
    assert found.problems == ("line of sight: 5 samples missing before the first and after the last one",)
    assert found.ticks == 3005
    never = summarise(replace(made, topic=replace(made["truth/los"], unsent_after=7)), transient=0.0)
    assert never.samples_lost == 0 and never.duration == pytest.approx(3.007)  # periods that a loop has lost at its end
    cut = summarise(replace(made, topic=replace(made["truth/los"], open_end=True)), transient=0.0)
    assert cut.samples_lost == 0 and "line of sight: the recording is truncated" in cut.problems[0]
    assert (cut.lost_text(), cut.lost_text(2), found.lost_text()) == ("unknown", "at least 2", "5")
    assert (cut.as_dict()["cut_off"], found.as_dict()["cut_off"]) == (True, False)


def test_messages_that_came_twice_or_late(tmp_path: Path) -> None:
    stamps = 10**9 + 10**6 * np.arange(3000)
    order = np.r_[np.arange(5), 6, 5, np.arange(7, 2999), 2999, 2999]
    signals = {"truth/los": NOISE, "m1/accel": np.zeros((len(order), 6))}
    given = {"truth/los": stamps, "m1/accel": stamps[order]}
    found = summarise(Run.open(write_bag(tmp_path / "a", signals, stamps=given, parameters={"transient_s": 0})))
    assert set(found.problems) == {"m1/accel: 1 stamp twice", "m1/accel: 1 message out of order"}
    assert found.samples_lost == 0


def test_frames_and_numbers_that_are_none(tmp_path: Path) -> None:
    signals = {"truth/los": NOISE, "camera/los": np.full((150, 2), np.nan), "m1/accel": np.zeros((3000, 6))}
    signals["m1/accel"][7] = np.nan
    signals["camera/los"][1:] = 0.0
    given = {"camera/los": 20}
    one = summarise(Run.open(write_bag(tmp_path / "a", signals, periods=given, parameters={"transient_s": 0})))
    assert one.problems == ("m1/accel: 1 message with NaN", "camera/los: 1 frame dropped (NaN)")
    assert one.camera_dropped == 1
    signals["camera/los"][5] = np.nan
    two = summarise(Run.open(write_bag(tmp_path / "b", signals, periods=given, parameters={"transient_s": 0})))
    assert two.camera_dropped == 2 and two.problems[-1] == "camera/los: 2 frames dropped (NaN)"


def test_sentences_about_the_run(tmp_path: Path) -> None:
    short = summarise(bag(tmp_path / "a"))
    assert short.transient == 1.5
    assert short.problems == (
        "less than 10 s recorded: only 1.5 s of start-up is excluded, not 5 s (analyse --transient SECONDS)",
    )
    assert summarise(bag(tmp_path / "b"), transient=0.0).problems == ()
    long = summarise(series(None, np.ones((10_000, 2)), unit="mas", rate=1000.0))
    still = ("x has the same value in all samples", "y has the same value in all samples")
    assert long.transient == 5.0 and long.problems == still
    failed = bag(tmp_path / "c", transient_s=0, mode="replay", statistics={"plant": {"failure": "no power"}})
    assert [p.partition(":")[0] for p in summarise(failed).problems] == ["the run failed", "a replay"]
    for odd in ("none", {"plant": "none"}, {}):
        assert summarise(bag(tmp_path / f"{len(str(odd))}", transient_s=0, statistics=odd)).problems == ()
    rate = summarise(series(None, NOISE, unit="rad", rate=512.0), transient=0.0)
    assert rate.problems == () and rate.budget is not None and rate.rpe_rms > 0
    assert rate.ticks == 3000 and rate.duration == pytest.approx(3000 / 512)
    slow = summarise(series(None, NOISE, unit="rad", rate=64.0), transient=0.0)
    assert slow.problems == ("no RPE of 20 ms: shorter than two samples of 15.625 ms",) and slow.budget is None
    few = summarise(series(None, NOISE[:19], unit="rad", rate=1000.0), transient=0.0)
    assert few.budget is None and few.problems == ()
    assert summarise(series(None, NOISE[:20], unit="rad", rate=1000.0), transient=0.0).budget is not None


TEXTS = {
    "prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence": (),
    "prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence, mixed": ("fsm", "none"),
    "prob(|APE| < 2 arcsec) >= 0.9 at 90 % confidence, ensemble": (),
}
REQUIREMENTS = tuple(parse(text, loops=loops) for text, loops in TEXTS.items())


def test_requirements_over_runs_are_judged_on_those_they_apply_to(tmp_path: Path) -> None:
    runs = [bag(tmp_path / str(k), transient_s=0, loop=loop) for k, loop in enumerate(("fsm", "fsm+pma", "none"))]
    assert applicable(REQUIREMENTS, runs[1]) == (REQUIREMENTS[0], REQUIREMENTS[2])
    assert applicable(REQUIREMENTS, bag(tmp_path / "x")) == REQUIREMENTS
    found = summarise_all(runs, requirements=REQUIREMENTS)
    samples = [[v.samples for v in s.verdicts] for s in found]
    assert samples == [[3000, 6000, 3], [3000, 3], [3000, 6000, 3]]  # the mixed one is not on the second run
    (alone,) = summarise_all(runs[:1], requirements=REQUIREMENTS)
    assert [v.status for v in alone.verdicts][1:] == ["not judged"] * 2
    two = summarise_all(runs[:2], requirements=REQUIREMENTS)
    assert two[0].verdicts[1].status == "not judged"  # one of them only
    assert (two[0].verdicts[2].samples, two[1].verdicts[1].samples) == (2, 2)


def test_runs_with_requirements_of_their_own(tmp_path: Path) -> None:
    """Each by its own; what is over several runs on those that hold it."""
    own = [{"name": "m", "text": "prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence, mixed"}]
    other = [{"name": "a", "text": "prob(|APE| < 3 arcsec) >= 0.9 at 90 % confidence"}]
    runs = [bag(tmp_path / str(k), transient_s=0, requirements=r) for k, r in enumerate((own, other, own))]
    found = summarise_all(runs)
    assert [[v.samples for v in s.verdicts] for s in found] == [[6000], [3000], [6000]]


class Beside:
    """A recording with a second topic."""

    def __init__(self, made: Any, **topics: Any) -> None:
        self._made, self._topics = made, {"truth/los": made["truth/los"], **topics}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._made, name)

    @property
    def topics(self) -> tuple[str, ...]:
        return tuple(sorted(self._topics))

    def __contains__(self, name: object) -> bool:
        return name in self._topics

    def __getitem__(self, name: str) -> Any:
        return self._topics[name]


def test_a_topic_ends_where_the_truth_was_to_end() -> None:
    """Three samples of the truth are lost at its end: what has as many lacks them, too."""
    made = series(None, NOISE, unit="rad", rate=1000.0)
    truth = made["truth/los"]
    short = Beside(replace(made, topic=replace(truth, lost_after=3)), **{"m1/accel": replace(truth, name="m1/accel")})
    found = summarise(short, transient=0.0)
    assert found.lost_by_topic == {"truth/los": 3, "m1/accel": 3}
    assert found.problems[-1] == "m1/accel: 3 samples missing at the start or the end of the run"
    assert summarise(Beside(made, **{"m1/accel": replace(truth, name="m1/accel")}), transient=0.0).samples_lost == 0


class Refuted(Beside):
    """A recording that contradicts its own digests."""

    contradictions = ("m1/accel: other bytes than recorded",)


def test_a_bag_without_a_verdict_is_refuted_where_it_contradicts_itself() -> None:
    """Too short for any: an error of its own kind, with the first contradiction, where there is one."""
    made = series(None, np.full((3, 2), np.nan), unit="rad", rate=1000.0)
    with pytest.raises(BagError) as plain:
        summarise(Beside(made), transient=0.0)
    assert type(plain.value) is BagError and "digests" not in str(plain.value)
    with pytest.raises(RefutedBagError, match=r"; the bag contradicts its own digests: m1/accel: other bytes") as told:
        summarise(Refuted(made), transient=0.0)
    assert str(told.value).startswith(str(plain.value))


PERIODS = (300, 301, 800, 1500)
"""Periods that the plant has lost: none of its topics has a sample of them."""


def bag_with_lost_periods(folder: Path, lost: tuple[int, ...], counted: int) -> Summary:
    """Of a run whose recorder counted so many samples of a topic that were not sent."""
    stamps = 10**9 + 10**6 * np.arange(3000)
    sent = np.setdiff1d(np.arange(3000), PERIODS)
    rest = np.setdiff1d(sent, lost)
    there = {"truth/los": sent, "isolator/accel": sent, "fsm/command": rest}
    signals = {"truth/los": NOISE[sent], "isolator/accel": np.zeros((len(sent), 6)), "fsm/command": NOISE[rest]}
    statistics = {"recorder": {f"unsent_/telescope/{name}": str(counted) for name in there}}
    given = {name: stamps[kept] for name, kept in there.items()}
    parameters = {"statistics": statistics, "transient_s": 0}
    return summarise(Run.open(write_bag(folder, signals, stamps=given, parameters=parameters)))


def test_samples_of_lost_periods_are_no_gaps(tmp_path: Path) -> None:
    """What is missing and was never sent has gaps in the record, but nothing is lost in them."""
    assert bag_with_lost_periods(tmp_path / "none", (), 4).problems == ()
    some = bag_with_lost_periods(tmp_path / "some", (100, 101, 802, 2000), 4)
    assert some.problems == ("fsm/command: 4 samples missing in 3 gaps",)
    beside = bag_with_lost_periods(tmp_path / "beside", (302, 303), 4)
    assert beside.problems == ("fsm/command: 2 samples missing in 1 gap",)


def test_of_periods_that_nothing_was_recorded_of_as_many_were_sent_as_the_recorder_counts(tmp_path: Path) -> None:
    """The plant says that it has lost three: the fourth was lost by the recorder, of all topics."""
    found = bag_with_lost_periods(tmp_path / "bag", (100,), 3)
    assert set(found.problems) == {
        "truth/los: 1 sample missing in 1 gap",
        "isolator/accel: 1 sample missing in 1 gap",
        "fsm/command: 2 samples missing in 2 gaps",
    }


GUIDE = RecordedSensor("guide/los", "rad", 10.0, True, (3e-8, 4e-8))
LOST = RecordedSensor("lost/los", "rad", 10.0, True, (1e-8,))


def recording(folder: Path, entries: Any, frames: np.ndarray) -> Run:
    signals = {"truth/los": 1e-7 * np.random.default_rng(1).standard_normal((3000, 2)), "guide/los": frames}
    return Run.open(write_bag(folder, signals, periods={"guide/los": 100}, parameters={METADATA: json.dumps(entries)}))


def test_what_is_written_is_read_and_only_for_topics_that_are_there(tmp_path: Path) -> None:
    frames = np.zeros((30, 2))
    frames[3] = np.nan
    run = recording(tmp_path / "bag", [sensor.to_mapping() for sensor in (GUIDE, LOST)], frames)
    assert sensors_of(run) == (GUIDE,)
    found = summarise(run, transient=0.0)
    assert found.sensors == (GUIDE,) and found.camera_dropped == 1
    assert found.problems == ("guide/los: 1 frame dropped (NaN)",)
    assert found.as_dict()["sensors"] == [GUIDE.to_mapping()]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rate_hz", [0.0, "fast", math.inf]),
        ("noise", [["loud"], 3.0, [math.nan]]),
        *[("held", [1]), ("topic", [5]), ("unit", [None])],
    ],
)
def test_a_description_that_cannot_be_read_is_none(tmp_path: Path, name: str, values: list[Any]) -> None:
    for k, value in enumerate(values):
        entry = {**GUIDE.to_mapping(), name: value}
        with pytest.raises(ValueError, match=r"a sensor must have|rate_hz and noise of a sensor must be finite"):
            RecordedSensor.from_mapping(entry)
        assert sensors_of(recording(tmp_path / str(k), [GUIDE.to_mapping(), entry], np.zeros((30, 2)))) == ()


def test_samples_have_the_unit_of_their_description(tmp_path: Path) -> None:
    """A gyroscope has the message type of an angle."""
    gyro = RecordedSensor("guide/los", "rad/s", 10.0, True, (1e-6, 1e-6))
    run = recording(tmp_path / "bag", [gyro.to_mapping()], np.zeros((30, 2)))
    assert (run["guide/los"].unit, run["truth/los"].unit) == ("rad/s", "rad")
    assert signals_of(run, ["guide/los"])[0].heads[0] == "guide/los x [rad/s]"


PLAN = {"duration": 10.0, "rate_hz": 1000, "mode": "realtime"}


def of_plant(**plant: str) -> str:
    return run_end({**PLAN, "statistics": {"plant": plant}}).text


def test_a_run_that_ended_early_is_told_with_both_counts() -> None:
    """By the plan of the plant: one that was started again has the rest of the run, its recorder the whole."""
    assert of_plant(ticks="10000") == of_plant(ticks="10000", planned_ticks="10000") == ""
    assert of_plant(ticks="6800", planned_ticks="6800") == ""
    assert of_plant(ticks="10000", planned_ticks="20000") == "the run ended early: after 10000 of 20000 ticks"
    assert of_plant(ticks="9999") == "the run ended early: after 9999 of 10000 ticks"
    two = run_end({**PLAN, "statistics": {"plant": {"ticks": "10000"}}}, covered=20_000)
    assert two.text == "the messages cover 20000 ticks, more than the 10000 in the run's record" and not two.by_plan
    ended = run_end({**PLAN, "statistics": {"plant": {"ticks": "4000"}}}, covered=4300)  # its last report is older
    assert ended.text == "the run ended early: after 4000 of 10000 ticks"


def test_a_plant_that_was_killed_before_its_first_report_is_not_taken_for_one_that_ended() -> None:
    for mode, said in (("realtime", True), ("lockstep", True), ("inprocess", False), (None, False)):
        assert bool(run_end({**PLAN, "mode": mode, "statistics": {"recorder": {"messages": "5"}}}).text) is said


def test_nothing_is_said_where_no_plan_is_known() -> None:
    early = {"statistics": {"plant": {"ticks": "5"}}}
    for parameters in ({}, PLAN, {**PLAN, "statistics": "none"}, early):
        assert run_end(parameters).text == ""
    for duration in (math.nan, math.inf, "ten"):
        assert run_end({**PLAN, **early, "duration": duration}).text == "", duration


def test_quantiles_are_those_of_the_parts_that_a_mission_asks_for(tmp_path: Path) -> None:
    """A mission of 99.9 and 95 % has no figure of 99.7 %, and the figures are the values of its verdicts."""
    limits = ("|APE| < 1 arcsec) >= 0.999", "rms RPE(20 ms) < 9 mas) >= 0.95")
    asked = [parse(f"prob({limit} at 95 % confidence") for limit in limits]
    stated = bag(tmp_path / "a", transient_s=0, requirements=entries(asked), loop="fsm", mode="inprocess")
    found = summarise(stated)
    assert found.probabilities == Probabilities(0.999, 0.999, 0.95, 0.999, 0.999)
    by_quantity = {figure.quantity: figure.value for figure in found.figures}
    assert len(found.rows) == 2
    for row in found.rows:
        assert by_quantity[row.quantity] == pytest.approx(row.value)
    content = found.as_dict()
    assert set(content["ape_arcsec"]) == {"max", "p999"} and set(content["rpe_mas"]) == {"rms", "p999", "windows_p95"}
    assert found.budget is not None and "total (95 %)" in str(found.budget)
    page = render([stated])
    assert "99.7 %" not in page and "99.9 %" in page and "95 %" in page


@pytest.mark.parametrize(("plant_hash", "shown"), [({"plant_hash": "ab"}, "worst_case"), ({}, "")])
def test_a_plant_that_announces_nothing_has_no_scenario(tmp_path: Path, plant_hash: dict[str, str], shown: str) -> None:
    """The recorder's settings name one also where somebody else's node was the plant."""
    known = {"scenario": "worst_case", "loop": "fsm", "mode": "lockstep", "transient_s": 0}
    recorded = bag(tmp_path / "a", **known, **plant_hash, statistics={"plant": {"ticks": "3000"}})
    assert summarise(recorded).scenario == shown
