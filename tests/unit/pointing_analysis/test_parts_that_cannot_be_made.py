"""What of a summary or a page cannot be made is named with its reason, and is not just left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import render
from pointing_analysis.requirements.requirement import entries, parse
from pointing_analysis.requirements.summary import summarise

MAS = np.pi / 648_000_000
NOISE = 30.0 * MAS * np.random.default_rng(0).standard_normal((12_000, 2))
OPTICS = {"aperture_diameter": 1.5, "obscuration": 0.3, "wavelength": 5.5e-7, "pixel_mas": 38.0, "weight_mas": 76.0}
MOTION = {"knots": [[0.0, 0, 100.0, 0, 0, 0], [12.0, 0, 500.0, 0, 0, 0]], "harmonics": [1.0], "modes": [300.0]}


def recorded(folder: Path, truth: Any = NOISE, more: dict[str, Any] | None = None, **parameters: Any) -> Run:
    given = {"loop": "fsm", "mode": "inprocess", "transient_s": 0.0, **parameters}
    return Run.open(write_bag(folder / "bag", {"truth/los": truth, **(more or {})}, parameters=given))


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"motion": {**MOTION, "knots": [[0.0, 1.0]]}}, "the motion of the recording cannot be read"),
        ({"sensors": [{"topic": "m1/accel"}]}, "the sensors of the recording cannot be read: a sensor must have topic"),
        ({"sensors": {}}, "the sensors of the recording cannot be read: sensors must be a list, got dict"),
    ],
)
def test_metadata_that_cannot_be_read_are_named(tmp_path: Path, parameters: dict[str, Any], reason: str) -> None:
    run = recorded(tmp_path, **parameters)
    summary = summarise(run)
    assert [text for text in summary.problems if text.startswith(reason)] and reason in render([run])
    assert [text for text in summary.as_dict()["problems"] if text.startswith(reason)]


def test_lines_of_a_run_whose_motion_is_unknown_are_not_searched(tmp_path: Path) -> None:
    """Its spectrum may be that of a wheel that changes its speed."""
    assert summarise(recorded(tmp_path / "still")).budget is not None
    assert summarise(recorded(tmp_path / "unknown", motion=3)).budget is None


def test_estimates_without_the_gauges_have_no_knowledge_error_and_a_reason(tmp_path: Path) -> None:
    summary = summarise(recorded(tmp_path, more={"los_estimate": NOISE}))
    assert summary.knowledge is None
    assert [text for text in summary.problems if text.startswith("no AKE and RKE: bag: for a knowledge error")]
    assert not summarise(recorded(tmp_path / "without")).problems, "without an estimate none is expected"


@pytest.mark.parametrize(
    "counts", [{"ticks": "12000", "missed_ticks": "many"}, {"ticks": "12000", "missed_ticks": "-1"}]
)
def test_a_run_in_real_time_whose_missed_ticks_are_unknown_has_no_verdict(
    tmp_path: Path, counts: dict[str, str]
) -> None:
    parameters = {
        "requirements": entries([parse("prob(|APE| < 1 arcsec) >= 0.5 at 95 % confidence")]),
        "mode": "realtime",
        "max_missed": 0.5,
        "statistics": {"plant": counts},
    }
    summary = summarise(recorded(tmp_path, **parameters))
    assert summary.overall == "disturbed" and "it cannot be read whether too many" in summary.rows[0].statement


def said(page: str) -> list[str]:
    """Sentences on what is missing of a page."""
    return [text.split("</p>")[0] for text in page.split('<p class="soft">') if text.startswith("No ")]


def test_pictures_that_a_run_is_too_short_for_are_named_on_its_page(tmp_path: Path) -> None:
    run = recorded(tmp_path, NOISE[:7], optics=OPTICS)
    found = said(render([run]))
    for start in (
        "No spectrum for fsm: error must have at least 8 samples",
        "No images for fsm: the run must",
        "No distribution of |RPE(20 ms)|: ",
        "No relative error by window length: ",
    ):
        assert [text for text in found if text.startswith(start)], (start, found)


def test_a_gap_leaves_no_waterfall_and_a_sentence(tmp_path: Path) -> None:
    gap = NOISE.copy()
    gap[6000] = np.nan
    found = said(render([recorded(tmp_path, gap, motion=MOTION)]))
    assert [text for text in found if text.startswith("No waterfall for fsm: ")]
    assert not [text for text in found if text.startswith(("No distribution", "No spectrum", "No relative"))]
