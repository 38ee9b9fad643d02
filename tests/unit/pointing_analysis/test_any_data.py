"""The same samples give the same verdict wherever they come from: our bag, another bag, CSV, Parquet, NumPy, arrays."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main

from pointing_analysis.indices.errors import RAD_PER_ARCSEC, performance_error
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.external_bag import candidates
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.run import Run
from pointing_analysis.read.series import series
from pointing_analysis.report import report
from pointing_analysis.report.report import render
from pointing_analysis.requirements.series_verdict import judge_series
from pointing_analysis.requirements.summary import Summary, summarise
from pointing_analysis.requirements.verdict import load

external_bags = pytest.importorskip("support.external_bags", reason="could not import 'rosbags'")
pytestmark = pytest.mark.usefixtures("without_pictures")
RATE = 512.0
REQUIREMENTS = """
[[requirement]]
text = "prob(|APE| < 0.12 arcsec) >= 0.95 at 90 % confidence"
[[requirement]]
text = "prob(|RPE(31.25 ms)| < 60 mas) >= 0.9 at 90 % confidence"
[[requirement]]
text = "prob(|RPE_x(15.625 ms)| < 20 mas) >= 0.9 at 90 % confidence"
[[requirement]]
text = "prob(|PDE(62.5 ms, 500 ms)| < 90 mas) >= 0.5 at 90 % confidence"
"""


def samples(n: int = 6000) -> np.ndarray[Any, Any]:
    """Tone and noise [arcsec]; none of the numbers is short in decimal or binary."""
    t = np.arange(n) / RATE
    tone = 0.07 * np.column_stack([np.sin(2 * np.pi * 11.3 * t), np.cos(2 * np.pi * 7.7 * t)])
    return np.asarray(tone + 0.011 * np.random.default_rng(3).standard_normal((n, 2)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same samples in our bag, another bag, CSV and NumPy."""
    made, xy = tmp_path_factory.mktemp("any"), samples()
    (made / "mission.toml").write_text(REQUIREMENTS)
    write_bag(made / "ours", {"truth/los": xy * RAD_PER_ARCSEC}, dt=1 / RATE)
    topics = {"/my/los": ("geometry_msgs/msg/PointStamped", xy), "/text": ("std_msgs/msg/String", xy[:3])}
    external_bags.write_external(made / "theirs", topics, RATE)
    t = np.arange(len(xy)) / RATE
    rows = "\n".join(f"{a!r},{x!r},{y!r}" for a, (x, y) in zip(t.tolist(), xy.tolist()))
    (made / "a.csv").write_text("time,x,y\n" + rows + "\n")
    (made / "bare.csv").write_text("\n".join(f"{x!r};{y!r}" for x, y in xy.tolist()))
    np.save(made / "a.npy", xy)
    np.savez(made / "a.npz", t=t, los=xy)
    return made


@pytest.fixture(scope="module")
def ours(folder: Path) -> Summary:
    return summarise(Run.open(folder / "ours"), requirements=load(folder / "mission.toml"))


def comparable(summary: Summary) -> dict[str, Any]:
    """All of a summary but where it comes from."""
    values = dataclasses.asdict(summary)
    return {name: value for name, value in values.items() if name not in ("path", "problems", "kind", "sampling")}


SOURCES = [
    ("theirs", {"los": "/my/los", "rate": RATE}),
    ("theirs", {"los": "/my/los.point"}),
    ("a.csv", {"rate": RATE}),
    ("a.csv", {"los": "x,y"}),
    ("bare.csv", {"rate": RATE}),
    ("a.npy", {"rate": RATE}),
    ("a.npz", {}),
]


@pytest.mark.parametrize(("name", "options"), SOURCES, ids=lambda value: str(value)[:40])
def test_every_source_gives_the_verdict_of_our_own_bag(
    folder: Path, ours: Summary, name: str, options: dict[str, Any]
) -> None:
    requirements = load(folder / "mission.toml")
    assert {v.status for v in ours.verdicts} >= {"compliant", "not compliant"}
    other = summarise(open_los(folder / name, unit="arcsec", **options), requirements=requirements)
    assert repr(comparable(other)) == repr(comparable(ours))


def test_parquet_gives_the_verdict_of_our_own_bag(folder: Path, ours: Summary) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    xy = samples()
    stamps = external_bags.START + np.arange(len(xy)) * round(1e9 / RATE)
    columns = {"when": pyarrow.array(stamps, pyarrow.timestamp("ns")), "az": xy[:, 0], "el": xy[:, 1]}
    parquet.write_table(pyarrow.table(columns), folder / "a.parquet")
    for time in ("when", None):  # the only dates are the time
        run = open_los(folder / "a.parquet", los="az,el", unit="arcsec", time=time)
        assert repr(comparable(summarise(run, requirements=load(folder / "mission.toml")))) == repr(comparable(ours))


@pytest.mark.further
@pytest.mark.pictures
def test_arrays_give_the_same_objects_and_the_same_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "PICTURES", report.PICTURES[::2])  # each takes a while
    xy, requirements = samples(), load(folder / "mission.toml")
    ours = summarise(Run.open(folder / "ours"), requirements=requirements)
    found, again = (
        judge_series(None, xy, unit="arcsec", rate=RATE, requirements=given)
        for given in (requirements, folder / "mission.toml")
    )
    assert repr(comparable(found)) == repr(comparable(ours)) and found.verdicts == again.verdicts
    in_mas = judge_series(np.arange(len(xy)) / RATE, 1e3 * xy, unit="mas", requirements=list(requirements))
    assert [v.status for v in in_mas.verdicts] == [v.status for v in ours.verdicts]
    pages = [
        render([run], requirements=requirements)
        for run in (Run.open(folder / "ours"), series(None, xy, unit="arcsec", rate=RATE, name="ours"))
    ]
    moved = shutil.copytree(folder / "ours", folder / "moved" / "ours")
    assert render([Run.open(moved)], requirements=requirements) == pages[0], "same bag, same bytes"
    tables = [page[page.index('<section id="requirements"') : page.index('<section id="provenance"')] for page in pages]
    words = (r'<p class="soft">No timing histogram[^<]*</p>', ""), ("The bag names", "The data name")
    for wrong, right in words:  # what is said of bags only
        tables = [re.sub(wrong, right, table) for table in tables]
    assert " ".join(tables[0].split()) == " ".join(tables[1].split())


def test_the_command_line_judges_a_bag_of_others(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--unit", "arcsec", "--rate", "512", "--requirements", str(folder / "mission.toml"), "--json"]
    results = []
    for name, more in (("theirs", ["--los", "/my/los"]), ("a.csv", []), ("ours", None)):
        chosen = options[4:] if more is None else [*options, *more]
        assert main(["analyse", str(folder / name), *chosen, "--output", str(folder / f"{name}.html")]) == 0
        results.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
        assert "<html" in (folder / f"{name}.html").read_text("utf-8")[:200]
    assert results[0]["requirements"] == results[1]["requirements"] == results[2]["requirements"]
    assert results[0]["ape_arcsec"] == results[2]["ape_arcsec"]
    assert not any("RPE" in problem for problem in results[0]["problems"])


def test_the_rate_of_a_topic_is_seen_through_the_jitter_of_a_link(tmp_path: Path) -> None:
    """Messages come up to four periods late: the median of single steps would be 249 Hz."""
    late = external_bags.START + np.arange(2000) * 5_000_000 + np.random.default_rng(2).integers(0, 20_000_000, 2000)
    topics = {"/los": ("geometry_msgs/msg/Vector3Stamped", np.zeros((2000, 2)))}
    (found,) = candidates(external_bags.write_external(tmp_path / "bag", topics, 200.0, late))
    assert found.rate == pytest.approx(200.0, rel=0.01)


def test_a_record_of_others_is_refused_by_its_own_name() -> None:
    with pytest.raises(ValueError, match=r"^series: line of sight: topic must have at least two samples, got 1$"):
        performance_error(series(None, np.zeros((1, 2)), unit="mas", rate=100.0), 0.0)


def test_listing_of_what_could_be_used(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "topics", str(folder / "theirs"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out.splitlines()[-1])["candidates"]
    assert row["los"] == "/my/los.point" and row["components"] == ["x", "y", "z"]
    assert row["messages"] == 6000 and row["rate"] == pytest.approx(RATE, rel=1e-6)


@pytest.mark.parametrize(
    ("kind", "los", "time"),
    [
        ("geometry_msgs/msg/Vector3Stamped", "/a.vector", "header"),
        ("geometry_msgs/msg/Vector3", "/a", "log"),
        ("std_msgs/msg/Float64MultiArray", "/a", "log"),
        ("my_msgs/msg/LosError", "/a", "header"),
    ],
)
def test_any_message_with_two_numbers(tmp_path: Path, kind: str, los: str, time: str) -> None:
    xy = samples(40)
    bag = external_bags.write_external(tmp_path / "bag", {"/a": (kind, xy)}, RATE)
    run = open_los(bag, los=los, unit="mas")
    single = kind == external_bags.CUSTOM
    expected = xy.astype(np.float32).astype(float) if single else xy
    mas = RAD_PER_ARCSEC / 1000
    assert run["truth/los"].values.tolist() == (expected * mas).tolist()
    assert run.parameters["time"] == time
    assert run["truth/los"].period == pytest.approx(1 / RATE, rel=1e-9)


@pytest.mark.parametrize(
    ("kind", "los", "quantity"),
    [
        ("geometry_msgs/msg/TwistStamped", "/a.twist.angular", r"angular velocity \[rad/s\] of .*/msg/Twist"),
        ("sensor_msgs/msg/Imu", "/a.angular_velocity", r"an angular velocity \[rad/s\] of sensor_msgs/msg/Imu"),
        ("sensor_msgs/msg/Imu", "/a.linear_acceleration", r"an acceleration \[m/s2\]"),
        ("geometry_msgs/msg/TwistStamped", "/a", "must be an angle, got /a.twist.linear"),
    ],
)
def test_what_is_no_angle_is_refused(tmp_path: Path, kind: str, los: str, quantity: str) -> None:
    """Angular velocities, accelerations and positions were taken as radians."""
    bag = external_bags.write_external(tmp_path / "bag", {"/a": (kind, samples(40))}, RATE)
    with pytest.raises(ValueError, match=quantity) as caught:
        open_los(bag, los=los, unit="rad")
    assert "Vector3Stamped" in str(caught.value) and "\n" not in str(caught.value)
    assert {one.field for one in candidates(bag)} <= {"orientation"}


@pytest.mark.parametrize("lost", [0, 50])
def test_samples_missing_by_a_clock_that_stepped_are_said_to_be(tmp_path: Path, lost: int) -> None:
    """Stamps that jump ahead by 0.5 s while the times of recording go on, and samples that are lost in both."""
    kept = np.r_[0:3000, 3000 + lost : 6000]
    logged = external_bags.START + 10 * 1_000_000 * kept
    ahead = np.where((kept >= 3000) & (lost == 0), 500 * 1_000_000, 0)
    topics = {"/los": ("geometry_msgs/msg/Vector3Stamped", samples(len(kept)))}
    bag = external_bags.write_external(tmp_path / "bag", topics, 100.0, logged + 2 * 1_000_000, logged + ahead)
    (problem,) = summarise(open_los(bag, los="/los", unit="arcsec")).problems
    assert "50 samples missing in 1 gap" in problem
    assert ("whose clock, or the recorder's, was stepped" in problem) == (lost == 0)


def test_log_times_with_jitter_go_to_the_grid_of_the_rate(tmp_path: Path) -> None:
    xy, rng = samples(3000), np.random.default_rng(1)
    even = external_bags.START + np.arange(len(xy)) * round(1e9 / RATE)
    kept = np.delete(np.arange(len(xy)), [700, 701])
    logged = (even + rng.integers(-400_000, 400_000, len(xy)))[kept]
    topics = {"/a": ("geometry_msgs/msg/Vector3", xy[kept])}
    bag = external_bags.write_external(tmp_path / "bag", topics, RATE, logged)
    run = open_los(bag, los="/a", unit="rad", rate=RATE)
    assert run["truth/los"].integrity.missing == 2 and len(run["truth/los"]) == len(xy) - 2
    with pytest.raises(ValueError, match=r"rate must match the samples, about 5\d\d"):
        open_los(bag, los="/a", unit="rad", rate=100.0)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("theirs", {"los": "/other"}, r"one of /my/los.point \(geometry_msgs/msg/PointStamped: x, y, z\), got"),
        ("theirs", {"los": "/text"}, "los must be one of /my/los.point"),
        ("theirs", {"los": "/my/los", "unit": None}, "theirs: unit must be given .--unit mas, .* for /my/los"),
        ("theirs", {"unit": None}, r"a topic such as .* `analyse --los` takes other lines of sight"),
        ("theirs", {"los": "/my/los", "unit": "gon"}, "unit must be one of .* got 'gon'"),
        ("theirs", {"los": "/my/los", "rate": -1.0}, "rate must be positive"),
        ("theirs", {"los": "/my/los", "time": "clock"}, "time must be one of auto, header, log, got 'clock'"),
        ("ours", {}, "los must be given with unit, rate or time"),
        ("a.npy", {}, "rate must be given where the samples have no times"),
        ("a.csv", {"los": "x,z"}, "los must be two of the columns time, x, y, got 'x,z'"),
        ("a.csv", {"time": "when"}, "time must be one of time, x, y, got 'when'"),
        ("none.csv", {}, "no such file"),
        ("none", {"los": "/a"}, "no such file or folder"),
    ],
)
def test_mistakes_are_one_line(folder: Path, name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        open_los(folder / name, **{"unit": "arcsec", **options})
    assert "\n" not in str(caught.value)


def test_lines_are_found_at_rates_without_a_window_of_20_ms(tmp_path: Path) -> None:
    """At 80 Hz 20 ms are less than two samples: no budget, but the spectrum and the page have the line."""
    t, rng = np.arange(20 * 80) / 80, np.random.default_rng(5)
    values = 4.0 * rng.standard_normal((t.size, 2)) + 20.0 * np.sin(2 * np.pi * 17.0 * t)[:, None]
    np.savetxt(tmp_path / "los.csv", np.c_[t, values], delimiter=",", header="t (s),x (mas),y (mas)", comments="")
    run = open_los(tmp_path / "los.csv")
    summary = summarise(run)
    (line,) = summary.found
    assert summary.budget is None and line.omega == pytest.approx(2 * np.pi * 17.0, rel=1e-4)
    page = render([run], summaries=[summary])
    assert "dB above the noise" in page and "none is above the noise" not in page


def test_columns_that_may_be_the_time_are_named_where_none_is_used(tmp_path: Path) -> None:
    rows = "\n".join(f"{i / RATE},{i}.5,1,20" for i in range(3000))
    (tmp_path / "a.csv").write_text("clock,az,el,celsius\n" + rows)
    with pytest.raises(ValueError, match=r"rate must be given .* for --time: clock, celsius"):
        open_los(tmp_path / "a.csv", los="az,el", unit="mas")
    run = open_los(tmp_path / "a.csv", los="az,el", unit="mas", rate=RATE)
    assert run.problems == ("no time column: 512 Hz without gaps assumed (others, for --time: clock, celsius)",)
    assert open_los(tmp_path / "a.csv", los="az,el", unit="mas", time="clock").problems == ()


def test_times_that_cannot_be_used() -> None:
    xy = samples(100)
    gap = np.arange(100) / RATE
    gap[50] = np.nan
    for t, message in (
        (gap, "t must be finite, got 1 of 100 times"),
        (1e12 * np.arange(100), "t must be in seconds, got times over 9.9e"),
        (np.arange(99), r"t must be 100 times \[s\], got an array of shape \(99,\)"),
    ):
        with pytest.raises(ValueError, match=message):
            series(t, xy, unit="mas")


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("rate", [None, RATE])
def test_a_sample_that_is_no_angle_counts_as_missing(value: float, rate: float | None) -> None:
    t = np.arange(6000) / RATE
    clean = np.random.default_rng(1).standard_normal((6000, 2))
    missing, odd = clean.copy(), clean.copy()
    missing[5000, 1], odd[5000, 1] = np.nan, value
    text = "prob(|APE| < 9 arcsec) >= 0.95 at 90 % confidence"
    expected = judge_series(t, missing, unit="arcsec", rate=rate, requirements=text)
    found = judge_series(t, odd, unit="arcsec", rate=rate, requirements=text)
    assert found.verdicts == expected.verdicts and found.ape_max == expected.ape_max
    assert any("1 sample infinite or above" in problem for problem in found.problems)


def test_infinite_rows_of_a_table_are_missing_and_rows_of_one_time_may_repeat_them(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    t = np.repeat(np.arange(3000) / RATE, 2)
    xy = np.repeat(np.random.default_rng(2).standard_normal((3000, 2)), 2, axis=0)
    xy[2000:2020] = np.inf
    np.savetxt(tmp_path / "los.csv", np.column_stack([t, xy]), delimiter=",", header="t,x,y", comments="")
    found = open_los(tmp_path / "los.csv", los="x,y", unit="mas")
    assert "samples infinite or above" in " ".join(found.problems) and not recwarn.list
