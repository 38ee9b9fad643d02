"""Campaigns find the members that are as bad as they should be, with controllers whose worst case is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign.adversarial import adversarial_members
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.sampling import COLUMNS, members
from los_testbed.config import RunConfig

FIXTURES = Path(__file__).parents[1] / "fixtures"
OLD = RunConfig(
    mode="inprocess",
    loop="fsm+pma",
    k_fsm=str(FIXTURES / "k_fsm_without_margin.json"),
    k_pma=str(FIXTURES / "k_pma_without_margin.json"),
)


@pytest.mark.slow
def test_adversarial_members_reach_the_known_worst_case_and_random_ones_do_not() -> None:
    """1.48 of 40 mas (:mod:`tests.support.worst_case_plants`); random members are between the limit and that."""
    evaluator = MemberEvaluator.of(OLD)

    def gains(points: np.ndarray) -> np.ndarray:
        rows = [evaluator.row(k, {**dict(zip(COLUMNS, p)), "seed": 1}, "model") for k, p in enumerate(points)]
        assert {row["status"] for row in rows} == {"ok"}
        return np.array([row["rpe_fine_gain"] for row in rows])

    found = gains(adversarial_members(OLD, 10, 0))
    assert found[0] == found.max() and found[0] == pytest.approx(1.48, abs=0.04)
    random = gains(members("uniform", 400, 1))
    assert random.max() < found[0] and np.median(random) < 1.0
