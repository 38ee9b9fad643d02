"""Runs in which something moves: what their bags say, what the report shows in place of lines of fixed frequency."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pointing_analysis.indices.motion import motion_of
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report.moving_tones import moving_pictures
from pointing_analysis.report.report import render, view
from pointing_analysis.requirements.summary import summarise

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
