"""Design in rounds with a stand-in for tuner and search: what is added, when it ends, what is reported."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from los_design import rounds
from los_design.rounds import MAX_NEW, Effort, Task, design_in_rounds
from los_design.worst_points import SearchOptions, WorstPoint
from robust_design import HinfGain, TuningOptions

QUICK, THOROUGH = SearchOptions(seed=1), SearchOptions(seed=2)
REQUIREMENTS = (HinfGain("w", "z", name="soft"), HinfGain("w", "u", hard=True, name="hard"))


def peak(name: str, gamma: float, omega: float) -> WorstPoint:
    return WorstPoint("fsm", name, gamma, 1.0, omega, {"p": omega}, np.ones(1, complex), np.ones(1, complex))


class Bench:
    """A tuner that reaches 0.9, and searches that give prepared answers; both keep a record."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, answers: list[list[WorstPoint]], status: str = "target"
    ) -> None:
        self.tuned: list[list[float]] = []
        self.searched: list[int] = []
        self.known: list[int] = []
        self.answers, self.status = iter(answers), status
        monkeypatch.setattr(rounds, "tune", self.tune)
        bounds = {"soft tones": ("soft", 2.0), "hard tones": ("hard", 1.0)}
        self.task = Task(lambda v: v, REQUIREMENTS, None, 0.0, lambda K: K, self.search, bounds)

    def tune(self, models, requirements, structure, *, initial, loop_delay, options):
        self.tuned.append([float(m.get("p", 0.0)) for m in models])
        return SimpleNamespace(
            x=initial[0] + 1.0, soft=0.9, abscissa=-1.0, status=self.status, controller="K",
            requirement_names=("soft", "hard"), values=np.array([[0.9], [0.8]]),
        )  # fmt: skip

    def search(self, controller, options):
        self.searched.append(options.seed)

        def run(names, known):
            self.known.append(len(known))
            found = next(self.answers)
            return {name: [p for p in found if p.requirement == name] for name in names}

        return SimpleNamespace(run=run)

    def design(self, count: int = 5):
        effort = Effort(count, 3, QUICK, THOROUGH)
        self.lines: list[str] = []
        return design_in_rounds(self.task, np.zeros(2), [{}], effort, TuningOptions(), self.lines.append)


def test_it_ends_when_the_thorough_search_finds_nothing_worse_either(monkeypatch) -> None:
    """Values up to 1 and a slack do not count: 2 * 0.501 and 1.002."""
    fine = [peak("soft tones", 0.501, 10.0), peak("hard tones", 1.002, 20.0)]
    bench = Bench(monkeypatch, [fine, fine])
    found = bench.design()
    assert found.status == "converged" and found.active == [{}]
    assert (bench.tuned, bench.searched) == ([[0.0]], [1, 2])
    assert found.worst["hard tones"].gamma == 1.002 and found.controller == "K"
    assert [(c["requirement"], c["value"]) for c in found.worst_cases()] == [("soft", 1.002), ("hard", 1.002)]
    assert bench.lines[0].startswith("round 1: 1 models, tuned 0.900, worst found: soft tones 1.002 at 10 rad/s")


def test_worse_points_are_added_and_climbed_from_again(monkeypatch) -> None:
    worse = [peak("soft tones", 0.6, 10.0), peak("hard tones", 1.5, 20.0)]
    fine = [peak("soft tones", 0.4, 10.0)]
    bench = Bench(monkeypatch, [worse, fine, [peak("soft tones", 0.51, 33.0)], fine, fine])
    found = bench.design()
    assert bench.tuned == [[0.0], [0.0, 20.0, 10.0], [0.0, 20.0, 10.0, 33.0]]  # the largest excess first
    assert bench.searched == [1, 1, 2, 1, 2]
    assert bench.known == [0, 2, 2, 1, 1]
    assert found.status == "converged" and [v.get("p") for v in found.active] == [None, 20.0, 10.0, 33.0]


def test_new_points_are_few_and_apart(monkeypatch) -> None:
    many = [peak("soft tones", 1.0 - 0.01 * k, 100.0 * 1.02**k) for k in range(12)]
    bench = Bench(monkeypatch, [many, many])
    found = bench.design(2)
    assert found.status == "rounds" and len(found.active) == 1 + MAX_NEW
    added = [v["p"] for v in found.active[1:]]
    assert added[0] == 100.0 and all(b / a > 1.03 for a, b in itertools.pairwise(added))
    assert bench.searched == [1, 1]  # the last round adds nothing: it was never tuned on


@pytest.mark.parametrize(("status", "expected"), [("infeasible", "infeasible"), ("iterations", "converged")])
def test_a_tuner_that_failed_is_not_called_converged(status: str, expected: str, monkeypatch) -> None:
    bench = Bench(monkeypatch, [[], []], status)
    assert bench.design().status == expected
