"""Design in rounds with a stand-in for descent and search: what is added, when it ends, what is kept and reported."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lftkit.support.job import Job
from lftkit.tuning import Descent, DescentState, TuningStatus
from lftkit.tuning.responses import ResponseLook
from los_design.search.worst_case_search import SearchOptions
from los_design.search.worst_points import WorstPoint
from los_design.synthesis import rounds
from los_design.synthesis import task as task_module
from los_design.synthesis.pair_problem import BOTH
from los_design.synthesis.rounds import MAX_NEW, Effort, design_in_rounds
from los_design.synthesis.task import ImplementedTask

QUICK, THOROUGH = SearchOptions(seed=1), SearchOptions(seed=2)
SHARES = {"soft tones": 0.5, "hard tones": 1.0}
NAMES = ("p", "q")


def peak(name: str, gamma: float, omega: float) -> WorstPoint:
    parameters = {"p": omega / 1e3, "q": 0.5}
    return WorstPoint("fsm+pma", name, gamma, 1.0, omega, parameters, np.ones(1, complex), np.ones(1, complex))


def no_controllers(x: np.ndarray) -> Any:
    """In place of the controllers of a parameter vector: descent and search are stand-ins."""


class FewSamples:
    """Parameter points without responses."""

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self.around: list[float] = []
        self.open_loop = SimpleNamespace(
            names=NAMES,
            telescope=None,
            point=lambda values: np.array([values.get("p", 0.5), values.get("q", 0.5)]),
            values=lambda point: dict(zip(NAMES, np.asarray(point).tolist())),
        )

    def add(self, points: np.ndarray) -> None:
        self.points += points.tolist()

    def add_around(self, omega: float, point: np.ndarray) -> None:
        self.around.append(omega)


class Bench:
    """A descent that reaches 0.9, and searches that give prepared answers; both keep a record."""

    def __init__(self, monkeypatch, answers, status: str = "stalled", lost=(), value=0.9, step=1.0) -> None:
        self.tuned: list[int] = []
        self.searched: list[tuple[int, tuple[str, ...], int]] = []
        self.answers, self.status, self.lost = iter(answers), status, list(lost)
        self.value, self.step = value, step
        self.samples = FewSamples()
        monkeypatch.setattr(task_module, "pair_problem", self.problem)
        monkeypatch.setattr(rounds, "descend", self.descend)
        monkeypatch.setattr(task_module, "limits", lambda telescope, stage: SHARES)

    def problem(self, samples, stages, tuned, threads):
        gains = tuple(SimpleNamespace(name=name) for name in SHARES)
        noises = (SimpleNamespace(name="noise"),)
        return SimpleNamespace(samples=samples.points, gains=gains, noises=noises, least_level=1.0)

    def descend(self, source, x, options, report, keep, goes_on):
        assert source.stable(x)
        self.tuned.append(len(source.problem.samples))
        values, noise = np.array([self.value, 0.5]), np.array([0.8])
        look = ResponseLook(x + self.step, (0.0, 0.9), values, noise)
        report(0, look)
        return Descent(look, TuningStatus(self.status), options.iterations)

    def search(self, task, x, stage, options):
        def run(names, known, workers):
            self.searched.append((options.seed % 1000, tuple(names), len(known)))
            found = next(self.answers)
            return {name: [p for p in found if p.requirement == name] for name in names}

        return SimpleNamespace(run=run, loop=SimpleNamespace(parameters=None), metrics=SHARES)

    def stable(self, task, x, values=None):
        return not (values and self.lost and abs(values["p"] - self.lost[0]) < 1e-12 and self.lost.pop(0) >= 0.0)

    def design(self, count: int = 5, job=None, points: int = 0, known=(), hidden=list, limit=np.inf):
        effort = Effort(count, points, 6, 3, 0.0, (QUICK, THOROUGH))
        self.lines: list[str] = []
        self.hidden = hidden
        task = ImplementedTask(self.samples, (BOTH,), (0, 1), 0, limit, known=known, sampled=no_controllers)
        return design_in_rounds(task, lambda: np.zeros(2), effort, self.lines.append, job)


@pytest.fixture
def bench(monkeypatch):
    """A bench whose `search`, `stable` and `hidden` are methods of the task."""

    def make(answers, **options):
        made = Bench(monkeypatch, answers, **options)
        monkeypatch.setattr(ImplementedTask, "search", lambda task, *rest: made.search(task, *rest))
        monkeypatch.setattr(ImplementedTask, "stable", lambda task, *rest: made.stable(task, *rest))
        monkeypatch.setattr(ImplementedTask, "missed_peaks", lambda task, x, tuned: made.hidden())
        return made

    return make


def test_it_ends_when_the_thorough_search_finds_nothing_worse_either(bench) -> None:
    """Values up to 1 and a slack do not count: 0.5005 over the share 0.5, and 1.002."""
    fine = [peak("soft tones", 0.5005, 10.0), peak("hard tones", 1.002, 20.0)]
    made = bench([fine, fine])
    found = made.design()
    assert found.status == "converged" and found.active == [{"p": 0.5, "q": 0.5}]
    # the round's search looks at what is near the largest value, the thorough one at all
    assert made.searched == [(1, ("soft tones",), 0), (2, ("soft tones", "hard tones"), 0)]
    assert found.worst["hard tones"].gamma == 1.002
    assert found.tuned == {"soft tones": 0.9, "hard tones": 0.5, "noise": 0.8}
    assert [(c["requirement"], c["value"]) for c in found.worst_cases()] == [
        ("soft tones", 1.001),
        ("hard tones", 1.002),
    ]
    assert made.lines[0] == "round 1, step 0: 0.9000 (0 s)"
    assert made.lines[-1].startswith(
        "round 1: 1 samples, stalled at 0.9000, noise 0.800; worst found: soft tones 1.001"
    )


def test_worse_points_are_added_and_climbed_from_again(bench) -> None:
    worse, fine = [peak("soft tones", 0.6, 10.0)], [peak("soft tones", 0.4, 10.0)]
    made = bench([worse, fine, [peak("hard tones", 1.5, 33.0)], fine, fine])
    found = made.design()
    assert found.status == "converged"
    assert made.tuned == [1, 2, 3] and made.samples.around == [10.0, 33.0]
    assert [seed for seed, _, _ in made.searched] == [1, 1, 2, 1, 2]
    assert [known for _, _, known in made.searched] == [0, 1, 1, 1, 1]
    assert [v["p"] for v in found.active] == [0.5, 0.01, 0.033]
    # the first of several searches looks at what was too large before
    assert [names for _, names, _ in made.searched if len(names) < 2] == [("soft tones",)] * 2 + [("hard tones",)]


@pytest.mark.parametrize(
    ("value", "status", "ended", "descents"),
    [
        (2.1, "stalled", "stalled", 1),
        (9.0, "iterations", "rounds", 2),
        (9.0, "out_of_time", "out_of_time", 1),
        (1.9, "stalled", None, 1),
    ],
)
def test_far_above_the_limits_nothing_is_searched(bench, value: float, status: str, ended, descents: int) -> None:
    """A descent that ended by itself ends the design, with its own status; one at its iteration limit goes on."""
    made = bench(itertools.repeat([]), value=value, status=status)
    found = made.design(2)
    assert len(made.tuned) == descents
    if ended is None:
        assert made.searched and not any("times what is tuned for" in line for line in made.lines)
        return
    assert found.status == ended and not made.searched and not found.worst
    assert made.lines[-1].startswith(f"the best controllers so far are at {value:.3g} times what is tuned for")
    assert f"(soft tones {value:.3g}); if this remains, relax" in made.lines[-1]


def test_a_descent_that_finds_no_lower_point_is_not_repeated(bench) -> None:
    """From the same point, with the same samples, it would find none again."""
    made = bench(itertools.repeat([]), value=9.0, status="iterations", step=0.0)
    assert made.design(5).status == "stalled" and len(made.tuned) == 1


def test_new_points_are_few_and_apart(bench) -> None:
    many = [peak("soft tones", 1.0 - 0.001 * k, 100.0 * 1.007**k) for k in range(60)]
    made = bench([many, many])
    found = made.design(2)
    assert found.status == "rounds" and len(made.samples.around) == MAX_NEW
    assert made.samples.around[0] == 100.0
    assert all(b / a > 1.01 for a, b in itertools.pairwise(made.samples.around))
    assert [seed for seed, _, _ in made.searched] == [1, 2]  # the last round adds nothing: it is measured whole


def test_an_unstable_point_is_watched_and_the_descent_repeated(bench) -> None:
    made = bench([[], []], lost=[0.5])
    made.lost = [made.samples.open_loop.point({})[0]]
    found = made.design()
    assert made.tuned == [1, 1] and found.status == "converged"


def test_a_point_that_is_unstable_all_along_ends_nothing(bench, monkeypatch) -> None:
    """It is not watched: no descent could begin at it. What is sampled of it is the last stable point on the way."""
    made = bench([[peak("soft tones", 0.6, 100.0)], [], []])
    monkeypatch.setattr(ImplementedTask, "stable", lambda task, x, values=None: not values or values["p"] > 0.3)
    found = made.design()
    assert made.tuned == [1, 2] and found.status == "converged"
    at = made.samples.points[1]  # on the way from 0.5 to 0.1
    assert 0.3 < at[0] < 0.3 + 0.4 / 2**7 * 1.01 and made.samples.around == [100.0]


def test_known_worst_points_are_sampled_and_climbed_from(bench) -> None:
    known = (peak("soft tones", 0.6, 70.0), peak("hard tones", 0.6, 80.0), peak("soft tones", 0.5, 70.0))
    made = bench([[], []])
    found = made.design(known=known)
    assert found.active == [{"p": p, "q": 0.5} for p in (0.5, 0.07, 0.08)]
    assert made.tuned == [3] and [known for _, _, known in made.searched] == [3, 3]


def test_random_points_and_corners_come_first(bench) -> None:
    made = bench([[], []])
    made.design(points=6)
    points = np.array(made.samples.points)
    assert len(points) == 7 and points[0].tolist() == [0.5, 0.5]
    assert set(points[1:4].ravel()) <= {0.0, 1.0} and not set(points[4:].ravel()) & {0.0, 1.0}


def test_an_interrupted_design_goes_on_after_its_last_descent(bench, tmp_path) -> None:
    """The search of the third round is interrupted; a second call begins with it, at the point of the third descent."""
    job = Job("design", {"seed": 0}, tmp_path / "rounds.json")
    made = bench([[peak("soft tones", 0.6, 10.0)], [peak("soft tones", 0.6, 20.0)]])
    with pytest.raises(StopIteration):
        made.design(job=job)
    assert (job.state() or {}).get("number") == 3
    again = bench([[], []])
    found = again.design(job=job)
    assert again.lines[0] == "goes on after 3 rounds, before the searches of the last" and again.tuned == []
    assert again.samples.points == [[0.5, 0.5], [0.01, 0.5], [0.02, 0.5]] and again.samples.around == [10.0, 20.0]
    assert again.searched[0][2] == 1  # climbed from, as it would have been
    np.testing.assert_array_equal(found.x, [3.0, 3.0])
    other = bench([[], []])
    other.design(job=Job("design", {"seed": 1}, job.record))  # made for something else: not used
    assert other.tuned == [1]
    job.record.write_text("{")
    assert bench([[], []]).design(job=job).status == "converged"


def test_the_result_names_every_source_that_it_was_made_with(bench, tmp_path, monkeypatch) -> None:
    """The commit is that of the beginning, not of the end; a design that goes on with another names both."""
    job = Job("design", {}, tmp_path / "rounds.json")
    commits = iter(["one", "two", "two"])
    monkeypatch.setattr(rounds, "commit", lambda: next(commits))
    for _ in range(2):
        with pytest.raises(StopIteration):
            bench([[peak("soft tones", 0.6, 10.0)]]).design(job=job)
    assert bench([[], []]).design(job=job).commits == ["one", "two"]


def test_a_search_that_found_nothing_is_not_repeated(bench, tmp_path) -> None:
    """Interrupted in the thorough search of the first round: neither its descent nor its quick search is made again."""
    job = Job("design", {"seed": 0}, tmp_path / "rounds.json")
    whole = bench([[], [peak("hard tones", 1.5, 33.0)], [], []]).design()
    with pytest.raises(StopIteration):
        bench([[]]).design(job=job)
    again = bench([[peak("hard tones", 1.5, 33.0)], [], []])
    found = again.design(job=job)
    assert [seed for seed, _, _ in again.searched] == [2, 1, 2] and again.tuned == [2]
    np.testing.assert_array_equal(found.x, whole.x)
    assert (found.tuned, found.active, found.worst_cases()) == (whole.tuned, whole.active, whole.worst_cases())


def test_an_interrupted_descent_begins_after_the_last_whole_round(bench, tmp_path, monkeypatch) -> None:
    job = Job("design", {"seed": 0}, tmp_path / "rounds.json")
    made, descend = bench([[peak("soft tones", 0.6, 10.0)]]), rounds.descend
    monkeypatch.setattr(rounds, "descend", lambda *rest: next(iter(())) if made.tuned else descend(*rest))
    with pytest.raises(StopIteration):
        made.design(job=job)
    again = bench([[], []])
    found = again.design(job=job)
    assert again.lines[0] == "goes on after 1 rounds" and again.tuned == [2]
    np.testing.assert_array_equal(found.x, [2.0, 2.0])


def test_a_descent_goes_on_at_its_last_look(bench, tmp_path, monkeypatch) -> None:
    """Interrupted after the second look, with a point that is watched: both are there again."""
    job = Job("design", {}, tmp_path / "rounds.json")
    made, looks = bench([[], []], lost=[0.5]), []
    whole = made.descend

    def descend(source, x, options, report, keep, goes_on):
        looks.append(goes_on)
        if made.tuned:  # the descent after that which lost the point
            at = np.array([0.1, 1.0 / 3.0])
            keep(DescentState(at, at, 0.25, [3, 1], [(0.0, 1.5), (0.0, 0.97)], 6, 1))
            raise StopIteration
        return whole(source, x, options, report, keep, goes_on)

    monkeypatch.setattr(rounds, "descend", descend)
    made.lost = [made.samples.open_loop.point({})[0]]
    with pytest.raises(StopIteration):
        made.design(job=job)
    assert looks == [None, None]
    again = bench([[], []])

    def goes_on(*given):
        looks.append(given[-1])
        return again.descend(*given)

    monkeypatch.setattr(rounds, "descend", goes_on)
    assert again.design(job=job).status == "converged"
    assert again.lines[0] == "goes on after 0 rounds, in the descent of the next"
    inside = looks[-1]
    np.testing.assert_array_equal(inside.best, [0.1, 1.0 / 3.0])
    assert (inside.memory, inside.history, inside.iteration) == ([3, 1], [(0.0, 1.5), (0.0, 0.97)], 6)


def test_a_descent_that_the_wall_limit_cut_short_goes_on(bench, tmp_path) -> None:
    job = Job("design", {}, tmp_path / "rounds.json")
    assert bench([[]], status="out_of_time").design(job=job).status == "converged"
    again = bench([[], []])
    found = again.design(job=job)
    assert again.lines[0] == "goes on after 0 rounds" and again.tuned == [1]
    np.testing.assert_array_equal(found.x, [1.0, 1.0])


@pytest.mark.parametrize(("status", "found"), [("iterations", "rounds"), ("stalled", "converged")])
def test_a_descent_above_1_that_is_not_at_its_end_goes_on(bench, status: str, found: str) -> None:
    """Nothing worse than 1.2 is found: no reason to end while the descent still goes down."""
    known = [peak("soft tones", 0.55, 10.0)]
    made = bench([known] * 5, status=status, value=1.2)
    assert made.design(3).status == found
    assert made.tuned == ([1, 1, 1] if status == "iterations" else [1])
    # the thorough search waits for the end of the descent
    assert [seed for seed, _, _ in made.searched] == ([1, 1, 2] if status == "iterations" else [1, 2])


def test_a_design_out_of_time_says_so(bench) -> None:
    worse = [peak("soft tones", 0.6, 10.0)]
    found = bench([worse, worse], status="out_of_time").design()
    assert found.status == "out_of_time"


def test_hidden_peaks_begin_the_rounds_anew_with_what_is_there(bench) -> None:
    """Points and worst points stay, nothing is sampled twice, and all requirements are looked at again."""
    hidden = iter([[7.0, 8.0], []])
    made = bench([[peak("soft tones", 0.6, 10.0)], [], [], [], []])
    found = made.design(points=2, hidden=lambda: next(hidden))
    assert found.status == "converged" and made.tuned == [3, 4, 4]
    assert len(made.samples.points) == 4 and made.samples.around == [10.0, 7.0, 8.0]
    assert [seed for seed, _, _ in made.searched] == [1, 1, 2, 1, 2]
    assert [len(names) for _, names, _ in made.searched] == [1, 1, 2, 1, 2]
    assert len(found.active) == 4
    np.testing.assert_array_equal(found.x, [3.0, 3.0])


def test_an_interrupted_design_has_its_hidden_peaks_again_in_their_order(bench, tmp_path) -> None:
    job = Job("design", {"seed": 0}, tmp_path / "rounds.json")
    known, late = [peak("soft tones", 0.6, 10.0)], [peak("soft tones", 0.6, 20.0)]
    hidden = iter([[7.0], [8.0], []])

    def peaks():
        return next(hidden)

    with pytest.raises(StopIteration):
        bench([known, [], [], late, [], []]).design(job=job, hidden=peaks)
    again = bench([[], []])
    found = again.design(job=job, hidden=peaks)
    assert found.status == "converged" and again.tuned == []
    assert again.samples.points == [[0.5, 0.5], [0.01, 0.5], [0.02, 0.5]]
    assert again.samples.around == [10.0, 7.0, 20.0, 8.0]


def test_hidden_peaks_end_with_the_wall_limit_or_their_number(bench, monkeypatch) -> None:
    """Each going on takes 40 s of 100 s, and there is always another peak."""
    now = [0.0]

    def peaks():
        now[0] += 40.0
        return [1.0]

    monkeypatch.setattr(rounds, "time", SimpleNamespace(monotonic=lambda: now[0]))
    made = bench(itertools.repeat([]))
    assert made.design(hidden=peaks, limit=100.0).status == "out_of_time" and len(made.tuned) == 3
    made = bench(itertools.repeat([]))
    assert made.design(hidden=peaks).status == "rounds" and len(made.tuned) == rounds.MAX_HIDDEN + 1
