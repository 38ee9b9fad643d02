"""The wall limit is shared between starts and rounds: further ones take nothing from the first, rounds follow."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.counted_time import Clock, counted_evaluations, structure_with_all_states_seen

from lftkit.systems.system import System
from lftkit.tuning import (
    HinfGain,
    RobustOptions,
    TuningOptions,
    TuningResult,
    WorstCase,
    WorstCaseOptions,
    gain,
    state_space,
    tune,
    tune_robust,
)
from lftkit.tuning.descent.single_start import only_point
from lftkit.tuning.problem import Problem
from lftkit.tuning.tuner import result_of

robust_module = importlib.import_module("lftkit.tuning.robust.robust")
LAW = gain([("y", 1)], [("u", 1)])
PORTS: Any = [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)]
NEEDS = [HinfGain("w", "z"), HinfGain("w", "effort", bound=0.8, hard=True)]
SHORT = WorstCaseOptions(samples=4, climbs=1, iterations=3)


def build(p: Mapping[str, float]) -> System:
    return System([[-p["a"]]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]], *PORTS)


def design(starts: int, **more: Any) -> TuningResult:
    options = RobustOptions(TuningOptions(starts=starts, wall_limit=60.0), SHORT)
    return tune_robust(build, {"a": (1.0, 3.0)}, NEEDS, LAW, options=options, **more)


@pytest.mark.parametrize(("initial", "fewer"), [([[-0.1]], 0), ([], 1)])
def test_further_starts_take_nothing_from_the_first(
    initial: list[list[float]], fewer: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first call is the same for any number of starts: its starts, seed and time; all calls leave a third of it."""
    calls: list[dict[str, Any]] = []

    def recorded(*arguments: Any, **named: Any) -> TuningResult:
        calls.append(named)
        return tune(*arguments, **named)

    monkeypatch.setattr(robust_module, "tune", recorded)
    firsts, results = [], []
    for starts in (fewer, 3):
        calls.clear()
        results.append(design(starts, initial=initial))
        options = [call["options"] for call in calls]
        firsts.append((options[0].starts, options[0].seed, options[0].wall_limit, calls[0]["initial"]))
        seeds = [o.seed for o in options if o.starts]
        assert sum(o.starts for o in options) == starts and len(set(seeds)) == len(seeds)
        assert sum(o.wall_limit for o in options) <= 40.0 + 1e-9
    assert firsts[0] == firsts[1]
    few, many = (result.worst[0].value for result in results)
    assert many <= few * (1.0 + 1e-3)
    assert len(results[1].starts) >= 3


def test_a_first_round_that_would_take_all_the_time_leaves_some_for_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is counted in evaluations: the worst parameters are looked for, and enter, with any number of starts."""
    plants = [structure_with_all_states_seen(4), structure_with_all_states_seen(4, stiffer=1.5)]
    for starts in (0, 5):
        clock = Clock()
        counted_evaluations(clock, monkeypatch)

        def varied(p: Mapping[str, float]) -> System:
            first, second = plants
            A = (1.0 - p["k"]) * first.A + p["k"] * second.A
            return System(A, first.B, first.C, first.D, first.inputs, first.outputs)

        law = state_space([("y", 3)], [("u", 3)], 2)
        x = 0.01 * np.random.default_rng(0).standard_normal(law.size)
        options = RobustOptions(TuningOptions(starts=starts, wall_limit=600.0), WorstCaseOptions(samples=4, climbs=0))
        result = tune_robust(varied, {"k": (0.0, 1.0)}, [HinfGain("w", "z")], law, initial=[x], options=options)
        assert len(result.rounds) > 1 and len(result.active) > 1, starts
        assert clock.now < 600.0 + 20.0
        monkeypatch.undo()


def test_same_seed_same_bits_with_several_starts() -> None:
    first, again = (design(2, initial=[[-0.1]]) for _ in range(2))
    assert first.x.tobytes() == again.x.tobytes() and first.starts == again.starts and first.worst == again.worst


def scaled(p: Mapping[str, float]) -> System:
    """z = (1 + (1 + 10 p) k) w / (s + 1) with u = k w."""
    B, D = [[1.0, 1.0 + 10.0 * p["p"]]], [[0.0, 0.0], [1.0, 0.0]]
    return System([[-1.0]], B, [[1.0], [0.0]], D, [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])


def ends_at(*points: float) -> Callable[..., TuningResult]:
    """Stands in for ``tune``: its calls end at these gains."""
    left = iter(points)

    def tuned(models: Any, requirements: Any, structure: Any, **_: Any) -> TuningResult:
        problem = Problem(models, requirements, structure)
        return result_of(problem, [only_point(problem, np.array([next(left)]))], 0.0)

    return tuned


@pytest.mark.parametrize("order", [(-1.0, -0.17), (-0.17, -1.0)])
def test_the_better_one_by_worst_case_is_the_result(order: tuple[float, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """One start ends at 0 on the nominal model and 10 elsewhere, the other at 0.83 and 0.87."""
    monkeypatch.setattr(robust_module, "tune", ends_at(*order))
    common: Any = scaled, {"p": (0.0, 1.0)}, [HinfGain("w", "z")], LAW
    start: Any = {"active": [{"p": 0.0}], "initial": [[0.0]]}
    options = RobustOptions(TuningOptions(starts=1), SHORT)
    result = tune_robust(*common, **start, options=replace(options, max_rounds=1))
    assert result.x.item() == -0.17 and result.worst[0].value == pytest.approx(0.87)
    monkeypatch.setattr(robust_module, "tune", ends_at(*order))
    on = tune_robust(*common, **start, options=options)
    assert on.worst[0].value == pytest.approx(5.0 / 6.0, rel=1e-2), "k = -1/6 on both ends"


def test_few_random_starts_have_equal_parts_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of them begins although the first would take all; time is counted in evaluations."""
    clock = Clock()
    counted_evaluations(clock, monkeypatch)
    times: list[float] = []
    runner = importlib.import_module("lftkit.tuning.descent.start_runner")
    whole = runner.tune_from

    def noted(*arguments: Any, **named: Any) -> Any:
        times.append(clock.now)
        return whole(*arguments, **named)

    monkeypatch.setattr(runner, "tune_from", noted)
    law = state_space([("y", 3)], [("u", 3)], 0)
    result = tune(
        [structure_with_all_states_seen(22)],
        [HinfGain("w", "z")],
        law,
        options=TuningOptions(starts=3, wall_limit=90.5),
    )
    assert len(result.starts) >= 3 and len(times) >= 3
    assert times[1] < 45.0 and times[2] < 75.0 and time.monotonic() < 95.0


def test_the_worst_case_is_at_least_that_of_the_active_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that is cut finds less than the model that is tuned on has."""
    monkeypatch.setattr(robust_module, "tune", ends_at(-0.1))
    less = (WorstCase("z", 0.05, {"p": 0.5}, 1.0, 0.05, 1),)
    monkeypatch.setattr(robust_module, "worst_case", lambda *_, **__: less)
    options = RobustOptions(TuningOptions(starts=0), max_rounds=1)
    start: Any = {"active": [{"p": 1.0}], "initial": [[0.0]]}
    result = tune_robust(scaled, {"p": (0.0, 1.0)}, [HinfGain("w", "z")], LAW, **start, options=options)
    (found,) = result.worst
    assert found.value == result.soft == pytest.approx(0.1) and found.parameters == {"p": 1.0} and found.omega == 0.0
