"""Figures, budget, star, page, campaign and replay have the window of the user's requirement, not the reference's."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.metrics import radial, windows
from pointing_analysis.read.run import Run
from pointing_analysis.read.series import series
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.summary import summarise

OMEGA, AMPLITUDE = 2.0 * np.pi * 7.0, 30.0
WINDOWS = {"5 ms": 0.005, "50 ms": 0.05, "250 ms": 0.25}
MISSION = """replace = ["requirement"]
[[requirement]]
name = "APE"
text = "prob(|APE| < 10 arcsec) >= 0.95 at 95 % confidence"
[[requirement]]
name = "RPE, mirror"
text = "prob(rms RPE({window}) < 900 mas) >= 0.9999 at 95 % confidence"
loop = ["fsm"]
[[requirement]]
name = "RPE, all"
text = "prob(rms RPE({window}) < 400 mas) >= 0.9999 at 95 % confidence"
loop = ["fsm+pma"]
"""


def required(window: str) -> Any:
    return parse(f"prob(rms RPE({window}) < 40 mas) >= 0.95 at 95 % confidence", "RPE")


@pytest.mark.parametrize("window", WINDOWS)
def test_a_tone_has_the_relative_error_of_the_window_that_is_required(window: str) -> None:
    """Of a circle in windows of T seconds: amplitude times sqrt(1 - sinc(w T / 2)^2), whatever the window's place."""
    t = np.arange(20_000) / 1000.0
    circle = AMPLITUDE * np.column_stack([np.sin(OMEGA * t), np.cos(OMEGA * t)])
    found = summarise(series(t, circle, unit="mas"), requirements=(required(window),))
    half = 0.5 * OMEGA * WINDOWS[window]
    assert found.window == WINDOWS[window]
    assert found.rpe_rms == pytest.approx(AMPLITUDE * np.sqrt(1.0 - (np.sin(half) / half) ** 2), rel=0.03)
    assert found.budget is not None and found.budget.total == pytest.approx(found.rpe_windows_p997)
    named = [figure.name for figure in found.figures]
    assert f"RPE rms, {window} windows" in named
    assert found.as_dict()["window_s"] == WINDOWS[window]


@pytest.fixture(scope="module", params=WINDOWS)
def mission(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    file = tmp_path_factory.mktemp("windows") / "mission.toml"
    file.write_text(MISSION.format(window=request.param))
    return str(request.param), file


def test_run_star_replay_and_campaign_have_the_window_of_the_mission(
    mission: tuple[str, Path], call: Callable[..., tuple[int, str, str]]
) -> None:
    window, file = mission
    settings = ("--parameters", file, "--loop", "fsm+pma", "--scenario", "none", "--duration", 3)
    code, out, err = call("run", "--mode", "inprocess", *settings, "--output", "bag", "--no-report")
    assert code == 0, err
    run = Run.open(Path("bag"))
    summary, error = summarise(run), performance_error(run)
    sizes = radial(np.sqrt(windows(error.values, error.dt, WINDOWS[window]).variance)) / RAD_PER_MAS
    assert summary.window == WINDOWS[window]
    assert summary.rpe_windows_p997 == pytest.approx(np.quantile(sizes, 0.997, method="higher"))
    assert summary.star is not None
    assert summary.star.exposure == WINDOWS[window]
    assert f"RKE rms, {window} windows" in call("replay", "bag")[1]
    code, out, err = call("campaign", *settings, "--samples", 2, "--output", "campaign", "--json")
    assert code == 0, err
    found = json.loads(out.splitlines()[-1])
    assert found["window_s"] == WINDOWS[window]
    assert found["metrics"]["rpe_window_p997_mas"]["members"] == 2
    judged = {verdict["requirement"]: verdict["column"] for verdict in found["verdicts"]}
    assert judged["RPE, all"] == "rpe_window_p9999_mas"
