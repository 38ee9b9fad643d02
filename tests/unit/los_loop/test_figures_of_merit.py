"""The table of the figures of merit, and that a row added to it takes effect wherever figures are used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from los_testbed.campaign.meanings import meaning
from los_testbed.campaign.member import metric_columns

from los_design.search.worst_case_search import Search
from los_design.synthesis.pair_problem import ALONE, BOTH, Samples, limits, pair_problem
from los_design.synthesis.state_space_requirements import implemented_requirements, paper_requirements, requirement
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import figures_of
from los_design.verification.verification import broken_requirements, check_implemented
from los_loop import figures_of_merit
from los_loop.figures_of_merit import FIGURES, FigureOfMerit, figure, figures, paper_figures
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.member_metrics import MemberMetrics, metric_names
from los_loop.open_loop import OpenLoop
from los_loop.worst_tone import INDICES
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES

SLOW = replace(figure("force"), name="force, slow", paper=(), band=(0.0, 85.0))
ADDED = replace(SLOW, limit=lambda telescope, stage: 0.2, target=None, allowed=0.5)
NOISE = replace(figure("noise -> RPE"), name="noise of the camera", inputs=("camera_los",), relative=False)


@pytest.fixture
def added(monkeypatch):
    monkeypatch.setattr(figures_of_merit, "FIGURES", (*FIGURES, ADDED, NOISE))


def test_the_table_is_that_of_the_paper_and_of_the_loop() -> None:
    alone, both = ([row.name for row in paper_figures(stage)] for stage in MIRROR_STAGES)
    assert (alone, both) == (["APE", "RPE", "mirror"], ["APE", "RPE", "noise -> APE", "force"])
    assert len({row.name for row in FIGURES}) == len(FIGURES)
    for row in FIGURES:
        assert row.is_noise + row.is_sensitivity + row.is_error <= 1
        assert (row.name in INDICES) == row.is_error


def test_a_target_is_at_most_what_is_accepted(telescope) -> None:
    for stage in MIRROR_STAGES:
        for row in figures(stage):
            assert 0.0 < row.tuned_for(telescope, stage) <= row.allowed * row.limit(telescope, stage)


@pytest.mark.parametrize(
    ("output", "inputs", "message"),
    [
        ("los", ("disturbance",), "output must be one of los_controlled, fsm_command, pma_force, got 'los'"),
        ("fsm_command", ("camera_los",), "output of noise must be los_controlled, got 'fsm_command'"),
        ("fsm_command", ("camera_los", "disturbance"), "inputs must be one of disturbance, fsm_command, pma_force"),
        ("fsm_command", (), "inputs must be"),
    ],
)
def test_ports_that_the_loop_does_not_have_are_named(output, inputs, message) -> None:
    with pytest.raises(ValueError, match=f"mine: {message}"):
        FigureOfMerit("mine", output, inputs, lambda telescope, stage: 1.0)
    with pytest.raises(ValueError, match=r"figure must be one of APE, RPE, .*, got 'mine'"):
        figure("mine")


def test_an_added_row_is_tuned_for(added, telescope, system) -> None:
    """The tuner on responses and that on state spaces have it, with its band, bound and kind."""
    assert limits(telescope, BOTH)["force, slow"] == 0.1 and "force, slow" not in limits(telescope, ALONE)
    problem = pair_problem(Samples(OpenLoop(system, telescope, telescope.loop_ports.used_by())), (ALONE, BOTH), (0, 1))
    gain = next(g for g in problem.gains if g.name == "force, slow")
    assert gain.hard and gain.scale(np.array([10.0, 84.0, 86.0])).tolist() == [10.0, 10.0, 0.0]
    names = [noise.name for noise in problem.noises]
    assert names[-1] == "noise of the camera" and "noise of the camera, alone" in names
    heard = problem.noises[-1].density[0]
    assert np.flatnonzero(heard).tolist() == [18, 19]
    assert problem.noises[0].density[0, 18] == heard[18]
    force = requirement(replace(ADDED, band=(0.0, np.inf)), telescope, "fsm+pma", 0.1)
    assert (force.outputs, force.bound, force.hard) == (("pma_force",), 0.1, True)
    assert "force, slow" not in [r.name for r in paper_requirements(telescope, "fsm+pma")]
    with pytest.raises(ValueError, match="force, slow: band must be the whole axis"):
        implemented_requirements(telescope, "fsm+pma")
    with pytest.raises(ValueError, match="noise of the camera: the plant has one noise for camera_los, fsm_angle"):
        implemented_requirements(telescope, "fsm")


@pytest.mark.slow
def test_an_added_row_is_searched_verified_and_proven(added, telescope, system) -> None:
    """The slow forces of the stored design, by the search's response at their worst point."""
    pair = load_designs("implemented")
    check = check_implemented(system, telescope, *pair, [{}], changes=False)
    found = check.both.worst["force, slow"]
    loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, FORCE_STAGES[0])
    assert "force, slow" in Search(loop).metrics
    assert figures_of(telescope, "fsm+pma", telescope.loop_ports.used_by())["force, slow"].band == (0.0, 85.0)
    T = loop.all_responses(loop.at(found.omega), loop.point({})[None])[0]
    assert found.omega <= 85.0
    assert found.gamma == pytest.approx(np.linalg.norm(T[4:10, :22], 2) / 0.2, rel=1e-3)
    said = [line for line in broken_requirements(check) if line.startswith("fsm+pma: force, slow")]
    assert bool(said) == (found.gamma > 0.5)
    for line in said:
        assert float(line.split()[3]) == pytest.approx(found.gamma, rel=1e-2)
        assert line.endswith("of its limit, must be at most 0.5")
    assert not [line for line in broken_requirements(check) if line.startswith("fsm: force")]


@pytest.mark.slow
def test_an_added_row_is_a_column_of_campaigns(monkeypatch, telescope, system) -> None:
    before = metric_columns("model", ())
    monkeypatch.setattr(figures_of_merit, "FIGURES", (*FIGURES, ADDED, NOISE))
    assert set(metric_columns("model", ())) - set(before) == {"force_slow_gain"}
    assert meaning("force_slow_gain") == "force slow gain"
    pair = load_designs("implemented")
    found = MemberMetrics.of(telescope, *pair, "fsm+pma").metrics({})
    assert tuple(found) == metric_names()
    loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, "fsm+pma")
    metric = loop_metrics(telescope, "fsm+pma", telescope.loop_ports.used_by())["force, slow"]
    values = [loop.gains(loop.at(w), metric, loop.point({})[None])[0] for w in np.geomspace(0.01, 85.0, 400)]
    assert found["force_slow_gain"] >= 0.99 * max(values) > 0.0


def test_the_columns_of_campaigns_are_those_of_the_table() -> None:
    assert metric_columns("model", ()) == metric_names()
