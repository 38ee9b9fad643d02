"""Campaigns find the members that are as bad as they should be, with controllers whose worst case is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.adversarial import adversarial_members
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.sampling import MemberParameters, members
from los_testbed.config.run_config import RunConfig

from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop_norms import weighted_gains
from titop_plant.interface import FRAME_TICKS

REFERENCE = MemberParameters.of()

FIXTURES = Path(__file__).parents[1] / "fixtures"
OLD = RunConfig(
    mode="inprocess",
    loop="fsm+pma",
    k_fsm=str(FIXTURES / "k_fsm_without_margin.json"),
    k_pma=str(FIXTURES / "k_pma_without_margin.json"),
)


def rows_of(evaluator: MemberEvaluator, points: np.ndarray) -> list[dict[str, Any]]:
    rows = [evaluator.row(k, {**dict(zip(REFERENCE.columns, p)), "seed": 1}, "model") for k, p in enumerate(points)]
    assert {row["status"] for row in rows} == {"ok"}
    return rows


@pytest.mark.slow
def test_adversarial_members_reach_the_known_worst_case_and_random_ones_do_not() -> None:
    """1.48 of 40 mas is known of these controllers (`tests/unit/los_design/test_worst_points.py`).

    Random members are between the limit and that. The worst of them is confirmed by the periodic solution of its
    assembled loop.
    """
    evaluator = MemberEvaluator.of(OLD)
    found = [row["rpe_fine_gain"] for row in rows_of(evaluator, adversarial_members(OLD, 10, 0))]
    assert found[0] == max(found) and found[0] == pytest.approx(1.48, abs=0.04)
    points = members("uniform", 400, 1)
    rows = rows_of(evaluator, points)
    random = np.array([row["rpe_fine_gain"] for row in rows])
    assert 1.0 < random.max() < found[0] and np.median(random) < 1.0
    worst = int(random.argmax())
    plant = evaluator.family.control_loop.at(dict(zip(REFERENCE.ranges, points[worst])))
    pair, telescope = (evaluator.controllers["k_fsm"], evaluator.controllers["k_pma"]), evaluator.family.telescope
    closed = sampled_loop(plant, ControlLaws(*pair, "fsm+pma"), frame_ticks=FRAME_TICKS)
    near = rows[worst]["rpe_peak_rad_s"] * (1.0 + np.linspace(-2e-3, 2e-3, 81))
    peak = float(weighted_gains(closed, plant, telescope, near)[1].max()) / telescope.weights.rpe_limit_fine
    assert random[worst] == pytest.approx(peak, rel=0.02)
