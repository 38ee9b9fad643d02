"""Pictures of the report: limits stand on the curve of their own statistic, what moves has no fixed lines."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointing_analysis.indices.motion import motion_of
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report import distribution_figure, exposure_figure, figures
from pointing_analysis.report.figures import time_history
from pointing_analysis.report.moving_tones import moving_pictures
from pointing_analysis.report.report import render, view
from pointing_analysis.requirements.requirement import Requirement, entries, parse
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.requirements.verdict import judge
from pointing_analysis.units import RAD_PER_MAS

TEXTS = [
    "prob(rms RPE(20 ms) < 40 mas) >= 0.997 at 95 % confidence",
    "prob(rms RPE(20 ms) < 30 mas) >= 0.95 at 95 % confidence",
    "prob(rms RPE(50 ms) < 60 mas) >= 0.997 at 95 % confidence",
    "prob(|RPE_x(20 ms)| < 70 mas) >= 0.9 at 95 % confidence",
]
REQUIREMENTS = [parse(text) for text in (*TEXTS, "prob(|APE| < 0.2 arcsec) >= 0.997 at 95 % confidence")]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    los = 30.0 * RAD_PER_MAS * np.random.default_rng(0).standard_normal((12_000, 2))
    return Run.open(write_bag(tmp_path_factory.mktemp("limits") / "bag", {"truth/los": los}))


def drawn(module: Any, draw: Any, monkeypatch: pytest.MonkeyPatch) -> dict[str, Axes]:
    """Title and axis of each picture that a function makes."""
    made: dict[str, Axes] = {}

    def picture(name: str, title: str, alt: str, height: float, show: Any) -> str:
        figure = Figure()
        show(figure)
        made[title] = figure.axes[0]
        return name

    monkeypatch.setattr(module, "picture", picture)
    draw()
    return made


def marks(axis: Axes) -> set[tuple[float, float]]:
    """Points of the limits in a picture."""
    points = [line for line in axis.get_lines() if line.get_color() == figures.LIMIT and np.size(line.get_xdata()) == 1]
    places = [np.asarray(p.get_xydata(), dtype=float)[0] for p in points]
    return {(round(float(x), 6), round(float(y), 6)) for x, y in places}


@pytest.mark.parametrize("requirement", REQUIREMENTS, ids=str)
def test_a_curve_says_of_a_limit_what_the_table_says(
    run: Run, requirement: Requirement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The share at the limit is the verdict's; the quantile of the table is on the curve at the required part."""
    shown = [view(run, "run")]
    made = drawn(distribution_figure, lambda: distribution_figure.distributions(shown, [requirement]), monkeypatch)
    axis = made[f"Distribution of {requirement.quantity}"]
    curve = next(line for line in axis.get_lines() if line.get_label() == "run")
    value, share = (np.asarray(data, dtype=float) for data in curve.get_data())
    found = judge(requirement, [run])
    ((limit, _),) = marks(axis)
    steps = np.searchsorted(value, limit)  # between two samples the share is that of the larger one
    at = share[steps] if steps < share.size else 0.0
    assert at == pytest.approx(found.exceeding, rel=0.03, abs=2.0 / found.samples)
    unit = requirement.limit / limit
    kept = value[share > 1.0 - requirement.probability + 1e-9][-1]
    assert curve.get_drawstyle() == "steps-pre" and kept == pytest.approx(found.quantile.value / unit, rel=1e-12)
    circles = [line.get_xydata() for line in axis.get_lines() if line.get_marker() == "o" and len(line.get_xdata())]
    assert np.allclose(circles, [[[kept, 1.0 - requirement.probability]]], rtol=1e-12)


def test_limits_over_the_exposure_are_on_the_curve_of_their_part(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = [view(run, "run")]
    made = drawn(exposure_figure, lambda: exposure_figure.over_exposure(shown, REQUIREMENTS), monkeypatch)
    (axis,) = made.values()
    names = [line.get_label() for line in axis.get_lines()]
    assert {"99.7 % of the windows", "95 % of the windows", "limit for 99.7 %", "limit for 95 %"} <= set(names)
    assert marks(axis) == {(20.0, 40.0), (20.0, 30.0), (50.0, 60.0)}
    curves = [line for line in axis.get_lines() if len(line.get_xdata()) > 2]
    for requirement, curve in ((REQUIREMENTS[0], curves[0]), (REQUIREMENTS[1], curves[1])):
        xs, ys = (np.asarray(data, dtype=float) for data in curve.get_data())
        value = judge(requirement, [run]).quantile.value / RAD_PER_MAS
        assert ys[np.isclose(xs, 20.0, rtol=1e-9)] == pytest.approx([value], rel=1e-12)


def test_a_required_window_has_its_value_even_if_the_run_has_few_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No whole number of samples, and longer than a tenth of the run."""
    los = 30.0 * RAD_PER_MAS * np.random.default_rng(1).standard_normal((1000, 2))
    source = write_bag(tmp_path / "bag", {"truth/los": los}, parameters={"transient_s": 0})
    short, requirement = Run.open(source), parse("prob(rms RPE(300.5 ms) < 40 mas) >= 0.9 at 95 % confidence")
    made = drawn(
        exposure_figure, lambda: exposure_figure.over_exposure([view(short, "run")], [requirement]), monkeypatch
    )
    (axis,) = made.values()
    (curve,) = (line for line in axis.get_lines() if len(line.get_xdata()) > 2 and line.get_label() == "run")
    value = judge(requirement, [short]).quantile.value / RAD_PER_MAS
    xs, ys = (np.asarray(data, dtype=float) for data in curve.get_data())
    assert xs[-1] == pytest.approx(300.5) and ys[-1] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("limits", "shown"),
    [
        (["rms RPE(20 ms) < 40 mas) >= 0.997"], True),
        (["rms RPE(35 ms) < 40 mas) >= 0.997"], True),
        (["rms RPE(20 ms) < 40 mas) >= 0.95"], True),
        (["rms RPE(20 ms) < 40 mas) >= 0.95", "rms RPE(20 ms) < 90 mas) >= 0.997"], False),
        (["|APE| < 1 arcsec) >= 0.95"], True),  # on no windows: nothing is said of them
    ],
)
def test_the_budget_has_the_limit_of_its_own_windows_and_part(tmp_path: Path, limits: list[str], shown: bool) -> None:
    """Its total is of the windows and of the largest part of them that are required: another part has no limit."""
    asked = [parse(f"prob({limit} at 95 % confidence") for limit in limits]
    los = 30.0 * RAD_PER_MAS * np.random.default_rng(0).standard_normal((3000, 2))
    parameters = {"rpe_budget_mas": {"total": 40.0}, "requirements": entries(asked), "transient_s": 0}
    summary = summarise(Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, parameters=parameters)))
    assert summary.requirements_known and summary.budget is not None
    assert (" of 40" in str(summary.budget)) == shown and bool(summary.budget.allowances) == shown


@pytest.mark.parametrize("curves", [2, 6, 9])
def test_a_legend_stays_within_the_picture(curves: int) -> None:
    """Two required probabilities once made a third column whose names were cut."""
    figure = Figure(figsize=(5.2, 4.4), layout="constrained")
    axis = figure.subplots()
    for number in range(curves):
        axis.plot([0, 1], label=f"{99.7 + number} % of the windows")
    figures.legend_above(figure, axis)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert len(legend.get_texts()) == curves
    assert legend.get_window_extent().x1 <= figure.bbox.x1


MAS = np.pi / 648_000_000
SECONDS, START, RATE = 12.0, 100.0, 40.0
MOTION = {
    "knots": [[0.0, 0.0, START, 0, 0, 0], [SECONDS, 0.0, START + RATE * SECONDS, 0, 0, 0]],
    "harmonics": [1.0, 2.0],
    "modes": [300.0],
    "modes_over_time": [[0.0, 300.0], [SECONDS, 330.0, 410.0]],
}


def bag(folder: Path, **parameters: Any) -> Run:
    """A chirp that follows the wheel, 50 mas in amplitude about the middle of the run and 1 mas before and after."""
    t = 1e-3 * np.arange(round(1e3 * SECONDS))
    size = np.where(np.abs(t - 6.0) < 0.5, 50.0, 1.0) * MAS
    phase = START * t + 0.5 * RATE * t**2
    truth = size[:, None] * np.column_stack([np.sin(phase), np.zeros_like(t)])
    given = {"loop": "fsm", "mode": "inprocess", "scenario": "ramp", "tones_rad_s": [50.0], "transient_s": 0.0}
    return Run.open(write_bag(folder, {"truth/los": truth}, parameters={**given, **parameters}))


def test_the_report_has_pictures_of_what_moves_and_no_lines_or_tones_of_fixed_frequency(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = (lambda drawn: moving_pictures(drawn.views, drawn.requirements),)
    monkeypatch.setattr("pointing_analysis.report.report.PICTURES", pictures)
    run = bag(tmp_path / "moving", motion=MOTION)
    page = render([run])
    for name in ("rpe-over-time", "waterfall-1", "campbell-1"):
        assert f'id="{name}"' in page
    assert "Wheels or arrays move during this run" in page and "Budget of the RPE" not in page
    assert summarise(run).budget is None and summarise(run).as_dict()["budget_rpe_mas"] is None
    still = bag(tmp_path / "still")
    page = render([still])
    assert "campbell" not in page and "Wheels or arrays move" not in page and "Budget of the RPE" in page
    assert summarise(still).budget is not None


def test_the_spectrum_over_time_follows_the_wheel(tmp_path: Path) -> None:
    from pointing_analysis.report.moving_tones import _spectra

    omega, time, values = _spectra(view(bag(tmp_path / "b", motion=MOTION), "fsm"))
    loudest = omega[values.argmax(axis=0)]
    away = np.abs(np.abs(time - 6.0) - 0.5) > 0.6  # not where the size jumps
    np.testing.assert_allclose(loudest[away], (START + RATE * time)[away], atol=30.0)


@pytest.mark.parametrize(
    "motion",
    [
        None,
        3,
        {},
        {"knots": [], "harmonics": [], "modes": []},
        {**MOTION, "knots": [[0.0, 1.0]]},
        {**MOTION, "knots": [[1.0, 0, 0, 0, 0, 0], [0.0, 0, 0, 0, 0, 0]]},
        {**MOTION, "modes_over_time": [[]]},
        {**MOTION, "modes_over_time": [["x"]]},
        {**MOTION, "harmonics": "no"},
    ],
)
def test_an_entry_that_cannot_be_read_is_no_motion(motion: object) -> None:
    assert motion_of(SimpleNamespace(parameters={"motion": motion})) is None


def test_the_smaller_axis_over_time_is_drawn_in_front(tmp_path: Path) -> None:
    values = MAS * np.random.default_rng(5).standard_normal((4000, 2))
    for number, (x, y) in enumerate(((1.0, 30.0), (30.0, 1.0))):
        run = Run.open(write_bag(tmp_path / str(number), {"truth/los": values * (x, y)}))
        drawn = time_history([view(run, "a")])
        assert drawn.draw is not None
        drawn.draw(figure := Figure())
        front = max(figure.axes[0].get_lines(), key=lambda line: line.get_zorder())
        assert front.get_label() == ("LOS x" if x < y else "LOS y")
