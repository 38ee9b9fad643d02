"""The outer loop: what enters, when it ends, with which status; the wall limit is shared by starts and rounds."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations, structure_with_all_states_seen
from support.tuned_plants import STATIC, first_order, tuned_plant

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
from lftkit.tuning.rounds import Worse, in_rounds
from lftkit.tuning.source import lower
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.tuner import tune


@dataclass
class Tuning:
    status: TuningStatus


@dataclass
class Prepared:
    """A design whose tunings end as given, and which finds as many worse points as given."""

    ends: list[str]
    found: list[int]
    unfinished: bool = False
    lasts: list[bool] = field(default_factory=list)
    active: int = 1

    def tuned(self, number: int) -> Tuning:
        return Tuning(TuningStatus(self.ends[number]))

    def worse(self, number: int, tuned: Tuning, last: bool) -> Worse[int]:
        self.lasts.append(last)
        return Worse(range(self.found[number]), self.unfinished)

    def add(self, tuned: Tuning, worse: Worse[int]) -> None:
        self.active += len(worse.new)


@pytest.mark.parametrize(
    ("ends", "found", "status", "active"),
    [
        (["converged"], [0], "converged", 1),
        (["stalled", "target"], [2, 0], "converged", 3),
        (["converged", "stalled"], [1, 0], "stalled", 2),
        (["converged", "converged", "converged"], [1, 1, 1], "rounds", 3),
        (["out_of_time"], [1], "out_of_time", 1),
        (["not_stabilised"], [4], "not_stabilised", 1),
    ],
)
def test_rounds_end_where_nothing_worse_is_found(ends: list[str], found: list[int], status: str, active: int) -> None:
    design = Prepared(ends, found)
    outcome = in_rounds(design, 3)
    assert (str(outcome.status), design.active) == (status, active)
    assert design.lasts == [k == 2 or ends[k] in ("out_of_time", "not_stabilised") for k in range(len(ends))]


def test_a_tuning_that_is_not_at_its_end_goes_on_without_anything_new() -> None:
    design = Prepared(["iterations"] * 3, [0] * 3, unfinished=True)
    assert in_rounds(design, 3).status is TuningStatus.ROUNDS and len(design.lasts) == 3


def test_no_round_begins_after_the_deadline_and_none_is_made_twice() -> None:
    late = in_rounds(Prepared(["converged"] * 5, [1] * 5), 5, deadline=time.monotonic() - 1.0)
    assert late.status is TuningStatus.OUT_OF_TIME
    design = Prepared(["converged"] * 5, [1, 1, 1, 1, 0])
    assert in_rounds(design, 5, done=3).status is TuningStatus.CONVERGED and len(design.lasts) == 2


def test_points_are_compared_by_violation_before_value() -> None:
    assert lower((0.0, 5.0), (1.2, 1.0)) and not lower((1.2, 1.0), (0.0, 5.0))
    assert lower((1.1, 9.0), (1.2, 1.0)), "of two violations the smaller one"
    assert lower((0.0, 1.0), (0.0, 1.0)) and not lower((0.0, 1.0), (0.0, 1.0), 1e-9)
    assert not lower((0.0, np.nan), (0.0, 1.0)) and not lower((np.inf, np.inf), (0.0, 1.0))


@pytest.mark.further
def test_a_worst_case_below_the_target_is_not_worse() -> None:
    """The first tuning ends below the target; parameters that are worse than it, but below the target, end nothing."""
    common: Any = {
        "build": lambda p: first_order(-p["a"]),
        "box": {"a": (1.0, 2.0)},
        "requirements": [HinfGain("w", "z")],
        "structure": STATIC.with_bounds({"D[0,0]": (-4.0, 0.0)}),
        "initial": [[-3.0]],
    }
    search = WorstCaseOptions(samples=5, climbs=1)
    met = tune_robust(**common, options=RobustOptions(TuningOptions(starts=0, target=0.26), search))
    assert met.status is TuningStatus.CONVERGED and len(met.active) == 1
    assert met.soft < met.worst[0].value < 0.26
    exact = tune_robust(**common, options=RobustOptions(TuningOptions(starts=0), search))
    assert len(exact.active) > 1 and exact.soft == pytest.approx(0.2, rel=1e-3)


@pytest.mark.further
@pytest.mark.parametrize(("met", "models"), [(0.65, 1), (-float("inf"), 2)])
def test_worst_cases_up_to_the_value_given_end_the_rounds(met: float, models: int) -> None:
    """With k >= -1 the nominal model reaches 1/2 and the worst parameter 0.6, which is above what was tuned.

    x' = -x + w + u, z = p x, y = x: the gain is p / (1 - k).
    """
    result = tune_robust(
        lambda v: tuned_plant([[-1.0]], [[1.0, 1.0]], [[v["p"]], [1.0]]),
        {"p": (1.0, 1.2)},
        [HinfGain("w", "z")],
        STATIC.with_bounds({"D[0,0]": (-1.0, 0.0)}),
        active=[{"p": 1.0}],
        initial=[[0.0]],
        options=RobustOptions(TuningOptions(starts=0, met=met), WorstCaseOptions(samples=4, climbs=1, iterations=4)),
    )
    (worst,) = result.worst
    assert str(result.status) == "converged" and len(result.active) == models
    assert worst.value == pytest.approx(0.6, rel=1e-3)


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
