"""The wall limit: at most a few evaluations after it; starts and rounds share it, and more make nothing worse."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations, structure_with_all_states_seen
from support.tuned_plants import STATIC, first_order

from lftkit.systems.system import System
from lftkit.tuning import (
    HinfGain,
    RobustOptions,
    TuningOptions,
    TuningResult,
    WorstCaseOptions,
    state_space,
    tune_robust,
)
from lftkit.tuning.tuner import tune

LAW = STATIC.with_bounds({"D[0,0]": (-4.0, 0.0)})
SHORT = WorstCaseOptions(samples=4, climbs=1, iterations=3)


def design(*starts: float) -> TuningResult:
    options = RobustOptions(TuningOptions(starts=0, iterations=20), SHORT)
    given, box = [[k] for k in starts], {"a": (1.0, 3.0)}
    return tune_robust(lambda p: first_order(-p["a"]), box, [HinfGain("w", "z")], LAW, initial=given, options=options)


@pytest.mark.further
def test_a_first_round_that_would_take_all_the_time_leaves_some_for_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is counted in evaluations: the worst parameters are looked for, and enter, with any number of starts."""
    plants = [structure_with_all_states_seen(4), structure_with_all_states_seen(4, stiffer=1.5)]
    clock = Clock()
    counted_evaluations(clock, monkeypatch)

    def varied(p: Mapping[str, float]) -> System:
        first, second = plants
        A = (1.0 - p["k"]) * first.A + p["k"] * second.A
        return System(A, first.B, first.C, first.D, first.inputs, first.outputs)

    law = state_space([("y", 3)], [("u", 3)], 2)
    x = 0.01 * np.random.default_rng(0).standard_normal(law.size)
    options = RobustOptions(TuningOptions(starts=5, wall_limit=300.0), WorstCaseOptions(samples=4, climbs=0))
    result = tune_robust(varied, {"k": (0.0, 1.0)}, [HinfGain("w", "z")], law, initial=[x], options=options)
    assert len(result.rounds) > 1 and len(result.active) > 1
    assert clock.now < 300.0 + 20.0


@pytest.mark.further
def test_more_starts_are_never_worse_and_the_same_ones_give_the_same_bits() -> None:
    """The worst case is at least the value on the models that were tuned on."""
    first, again, more = (design(*starts) for starts in ((-3.0,), (-3.0,), (-3.0, -0.1)))
    assert more.worst[0].value <= first.worst[0].value * (1.0 + 1e-3)
    assert all(r.worst[0].value >= r.soft * (1.0 - 1e-9) for r in (first, more))
    assert first.x.tobytes() == again.x.tobytes() and first.starts == again.starts and first.worst == again.worst


AFTER = 4  # evaluations after the limit: the one that is running, the point that is kept, and the result


@pytest.mark.parametrize(("limit", "order"), [(0.5, 1), (10.5, 0), (60.5, 1)])
def test_no_more_than_a_few_evaluations_after_the_limit(
    limit: float, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = structure_with_all_states_seen(22)
    clock = Clock()
    counted_evaluations(clock, monkeypatch)
    structure = state_space([("y", 3)], [("u", 3)], order)
    result = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(wall_limit=limit))
    assert result.status == "out_of_time" and "allow more time" in result.advice
    assert limit < clock.now < limit + AFTER
    assert np.isfinite(result.soft) and result.certificate is not None and result.certificate.stable


@pytest.mark.further
def test_no_start_is_begun_after_the_limit_in_other_processes() -> None:
    """But the first: each of the others had the whole time that was left when the first was begun."""
    plant, structure = structure_with_all_states_seen(2), state_space([("y", 3)], [("u", 3)], 0)
    given = [0.01 * np.random.default_rng(k).standard_normal(structure.size) for k in range(4)]
    options = TuningOptions(starts=0, wall_limit=1e-6, workers=2)
    result = tune([plant], [HinfGain("w", "z")], structure, initial=given, options=options)
    assert result.status == "out_of_time"
    assert len(result.starts) == 1
