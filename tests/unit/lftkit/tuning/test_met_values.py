"""Soft values that count as met: a problem without a minimum has one, and only its certificate says ``converged``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lftkit import System
from lftkit.tuning import HinfGain, TuningOptions, TuningResult, gain, tune

EFFORT = TuningOptions(starts=0)


def tuned(*more: HinfGain, met: float, options: TuningOptions = EFFORT) -> TuningResult:
    """A lag with u = k y: its gain 1 / (1 - k) comes down to zero as k falls for ever; the command's is k / (k - 1)."""
    C, D = [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]]
    plant = System([[-1]], [[1, 1]], C, D, [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)], "lag")
    structure = gain([("y", 1)], [("u", 1)])
    options = replace(options, met=met)
    return tune([plant], [HinfGain("w", "z"), *more], structure, initial=[[-0.5]], options=options)


@pytest.mark.parametrize("met", [0.3, 1e-3])
def test_an_infimum_of_zero_is_converged_where_less_counts_as_met(met: float) -> None:
    found = tuned(met=met)
    assert found.status == "converged" and found.stationarity == 0.0 and "counts as met" in found.advice
    assert found.certificate is not None and found.certificate.upper.max() <= met
    assert float(found.controller.D[0, 0]) <= 1.0 - 1.0 / met


def test_without_it_the_same_problem_is_not_converged() -> None:
    assert tuned(met=-np.inf).status in ("unbounded", "iterations", "stalled")


def test_a_minimum_above_it_is_converged_by_its_first_order_condition() -> None:
    """The effort held at 0.8 leaves 0.2 as the smallest gain."""
    limit = HinfGain("w", "effort", bound=0.8, hard=True)
    found = tuned(limit, met=0.1)
    assert found.status == "converged" and found.soft == pytest.approx(0.2, rel=2e-3)
    assert "random directions" in found.advice and 0.0 < found.stationarity < 1e-3


def test_a_run_that_is_cut_above_it_is_not_converged() -> None:
    found = tuned(met=0.3, options=replace(EFFORT, wall_limit=1e-9))
    assert found.soft > 0.3 and found.status == "out_of_time"


def test_hard_requirements_count_with_their_own_limit() -> None:
    """A hard value of 0.99 is above what counts as met, and kept."""
    limit = HinfGain("w", "effort", bound=0.96, hard=True)
    found = tuned(limit, met=0.05)
    assert found.status == "converged" and found.soft <= 0.05 < 0.98 < found.hard <= 1.0
