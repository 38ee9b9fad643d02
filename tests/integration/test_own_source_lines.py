"""Sources of the user that are tones are tones in the budget of a run and lines in its report, no noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process

from pointing_analysis.read.run import Run
from pointing_analysis.report.report import render
from pointing_analysis.requirements.summary import Summary, summarise

COOLER = """
import numpy as np
from titop_plant.interface import DT
from titop_plant.simulation.driven_plant import DISTURBANCE_COLUMNS


class Cooler:
    def reset(self):
        self.tick = 0

    def step(self, out):
        angle = 2.0 * np.pi * 45.0 * DT * self.tick
        out[:] = 0.0
        force = 200.0 * np.sin(angle) + 100.0 * np.sin(2.0 * angle + 1.0)
        out[DISTURBANCE_COLUMNS["external_wrench"]] = force * np.array([1.0, 0.5, 0.2, 0.1, 0.1, 0.0])
        self.tick += 1
"""


def run_of(bag: Path, **settings: object) -> tuple[Run, Summary]:
    run_in_process(RunConfig(mode="inprocess", duration=8.0, loop="fsm+pma", seed=4, **settings), bag)  # type: ignore[arg-type]
    run = Run.open(bag)
    return run, summarise(run)


@pytest.mark.further
@pytest.mark.usefixtures("without_pictures")
def test_harmonics_of_a_cooler_are_tones_and_what_is_left_is_the_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_cooler.py").write_text(COOLER)
    monkeypatch.syspath_prepend(tmp_path)
    run, with_cooler = run_of(tmp_path / "cooler", disturbance_source="own_cooler:Cooler", start="rest")
    _, quiet = run_of(tmp_path / "quiet", disturbance=False, start="rest")
    assert with_cooler.budget is not None and quiet.budget is not None
    lines = [line for line in with_cooler.budget.found if not line.is_sideband]
    assert [line.omega / (2.0 * np.pi) for line in lines] == pytest.approx([45.0, 90.0], abs=0.02)
    moving = {line.carrier for line in with_cooler.budget.found if line.is_sideband}
    assert moving <= {line.omega for line in lines}, "the ringing of the start is at the sides of the tones"
    assert with_cooler.budget.fast > 20.0 and with_cooler.budget.slow == 0.0
    assert quiet.budget.found == () and quiet.budget.fast == 0.0
    assert with_cooler.budget.noise == pytest.approx(quiet.budget.noise, rel=0.1), "and the ringing of its start"
    page = render([run])
    assert page.count("dB above the noise") == 2
