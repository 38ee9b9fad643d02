"""Batches of starts end when most of them end at the same value, or where no lower value is possible."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lftkit.support.progress import Progress
from lftkit.tuning import HinfGain, TuningOptions, TuningStatus, gain, state_space, tune
from lftkit.tuning.descent import start_runner
from lftkit.tuning.descent.grid_source import point_at
from lftkit.tuning.descent.minimax.minimax import DescentOptions
from lftkit.tuning.descent.single_start import StartResult
from lftkit.tuning.descent.start_runner import run_starts
from lftkit.tuning.descent.starts import Start, random_starts
from lftkit.tuning.full_order import reduced_starts
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import published_plant
from lftkit.tuning.tuner import _own_order_first, _search

PLANT = published_plant("AC17")
STRUCTURE = gain([PLANT.outputs[1]], [PLANT.inputs[1]])


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        (lambda number: 1.0, 8),  # all agree: the first portion of the first batch is enough
        (lambda number: 1.0 if number % 3 == 0 else 2.0 + number, 48),  # a third of them: two batches
        (lambda number: 1.0 if number == 40 else 1.5 + number, 72),  # a better one in the second batch: three
    ],
)
def test_starts_that_are_begun(ends: object, expected: int, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers: list[int] = []

    def screened(problem: object, start: object, limits: object, band: object) -> StartResult:
        number = start.number  # type: ignore[attr-defined]
        numbers.append(number)
        value = ends(number)  # type: ignore[operator]
        return StartResult(TuningStatus.ITERATIONS, np.full(STRUCTURE.size, number), value, -np.inf, -1.0, np.inf, 1, 0)

    def carried_on(problem: object, start: object, limits: object, band: object) -> StartResult:
        number = int(start.x[0])  # type: ignore[attr-defined]
        value = ends(number)  # type: ignore[operator]
        return StartResult(TuningStatus.CONVERGED, np.full(STRUCTURE.size, number), value, -np.inf, -1.0, 0.0, 1, 0)

    monkeypatch.setattr(start_runner.ExactValue, "suits", staticmethod(lambda problem: False))
    monkeypatch.setattr(start_runner, "_screened", screened)
    monkeypatch.setattr(start_runner, "_full", carried_on)
    problem = Problem([PLANT], [HinfGain("w", "z")], STRUCTURE)
    found = run_starts(problem, [], lambda n: random_starts(24, 0, n), DescentOptions(), 0.3, 1, Progress("", False))
    assert len(numbers) == expected
    assert found.best.soft == pytest.approx(1.0)


def test_values_of_a_result_are_those_of_its_certificate() -> None:
    options = TuningOptions(starts=0)
    x0 = np.zeros(STRUCTURE.size)
    result = tune([PLANT], [HinfGain("w", "z")], STRUCTURE, initial=[x0], options=options)
    assert result.certificate is not None
    assert result.values.tolist() == result.certificate.values.tolist()
    assert result.soft <= result.certificate.upper.max()


def test_search_ends_where_the_value_vanishes() -> None:
    """AC1: the disturbance can be rejected completely."""
    plant = published_plant("AC1")
    result = tune([plant], [HinfGain("w", "z")], gain([plant.outputs[1]], [plant.inputs[1]]))
    assert result.soft < 1e-6
    assert len(result.starts) <= 4, "no random start after that"


def test_the_order_asked_for_is_looked_at_before_the_lower_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four starts at a time, the best two carried on; the lowest point of all goes first in the search that follows."""
    work: list[tuple[str, int, float]] = []

    def fake(name: str) -> Callable[..., StartResult]:
        def run(problem: Problem, start: Start, limits: object, band: object) -> StartResult:
            x = np.full(problem.structure.size, 0.01 * len(work))
            given = np.inf if start.x is None else point_at(problem, start.x).soft
            work.append((name, problem.structure.order, given))
            return StartResult(TuningStatus.ITERATIONS, x, 1.0 + 0.1 * (len(work) % 7), -np.inf, -1.0, np.inf, 1, 0)

        return run

    for name in ("screen", "cycles", "polish", "restarts"):
        monkeypatch.setattr(start_runner, f"direct_{name}", fake(name))
    monkeypatch.setattr(start_runner, "_full", fake("full"))
    problem = Problem([PLANT], [HinfGain("w", "z")], state_space([PLANT.outputs[1]], [PLANT.inputs[1]], 1))
    options = TuningOptions()
    problem.limit = np.full(problem.structure.size, 1e8)
    found = _search(problem, [], options, np.inf, Progress("", False))
    names = "".join(name[0] for name, order, _ in work[: work.index(next(w for w in work if w[1] == 0))])
    assert names == 2 * "sssscc"
    begin = max(k for k, w in enumerate(work) if w[1] == 0) + 1
    after = work[begin : begin + 4 + len(reduced_starts(problem))]
    assert {name for name, _, _ in after} == {"polish"} and np.isfinite(after[0][2])
    assert [value for _, _, value in after] == sorted(value for _, _, value in after), "unstable ones are last"
    assert found.complete and found.best.soft == pytest.approx(1.0)


def test_no_first_look_with_few_starts_or_without_a_state() -> None:
    for order, starts in ((0, 24), (1, 6)):
        structure = state_space([PLANT.outputs[1]], [PLANT.inputs[1]], order)
        problem = Problem([PLANT], [HinfGain("w", "z")], structure)
        found = _own_order_first(problem, TuningOptions(starts=starts), np.inf, Progress("", False))
        assert found.results == () and found.complete
