"""The wall limit of a problem with many states and outputs: at most a few evaluations after it."""

from __future__ import annotations

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations, structure_with_all_states_seen

from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.structures.structures import state_space
from lftkit.tuning.tuner import tune

AFTER = 4  # evaluations after the limit: the one that is running, the point that is kept, and the result


@pytest.mark.parametrize("limit", [0.5, 10.5, 60.5])
@pytest.mark.parametrize("order", [0, 1])
def test_no_more_than_a_few_evaluations_after_the_limit(
    limit: float, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = structure_with_all_states_seen(22)
    clock = Clock()
    counted_evaluations(clock, monkeypatch)
    structure = state_space([("y", 3)], [("u", 3)], order)
    result = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(wall_limit=limit))
    assert result.status == "out_of_time"
    assert limit < clock.now < limit + AFTER
    assert np.isfinite(result.soft)
    assert result.certificate is not None
    assert result.certificate.stable


def test_no_start_is_begun_after_the_limit_in_other_processes() -> None:
    """But the first: each of the others had the whole time that was left when the first was begun."""
    plant, structure = structure_with_all_states_seen(2), state_space([("y", 3)], [("u", 3)], 0)
    given = [0.01 * np.random.default_rng(k).standard_normal(structure.size) for k in range(4)]
    options = TuningOptions(starts=0, wall_limit=1e-6, workers=2)
    result = tune([plant], [HinfGain("w", "z")], structure, initial=given, options=options)
    assert result.status == "out_of_time"
    assert len(result.starts) == 1
