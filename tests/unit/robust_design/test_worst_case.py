"""Worst parameters: known answers, hidden peaks, instability, and the outer loop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from lti.state_space_model import StateSpace
from robust_design.requirements import ClosedLoopPoles, H2Gain, HinfGain
from robust_design.robust import tune_robust
from robust_design.structures import gain
from robust_design.tuner import TuningOptions
from robust_design.worst_case import WorstCaseOptions, worst_case

OPEN = StateSpace.static([[0.0]], [("y", 1)], [("u", 1)], "no controller")


def oscillator(p: Mapping[str, float]) -> StateSpace:
    """Two modes whose distance depends on the parameters: their peaks add up where they meet."""
    A = np.zeros((4, 4))
    for i, w in enumerate((1.0 + 0.3 * p["a"], 1.5 + 0.3 * p["b"])):
        A[2 * i, 2 * i + 1] = 1.0
        A[2 * i + 1, 2 * i : 2 * i + 2] = -(w**2), -0.04 * w
    B = np.zeros((4, 2))
    B[1], B[3] = 1.0, 1.0
    C = np.array([[1.0, 0, 1, 0], [1, 0, 1, 0]])
    return StateSpace(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])


def test_interior_worst_case_is_found_by_the_climb() -> None:
    """Against a dense scan of the square."""
    box = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
    options = WorstCaseOptions(samples=15, climbs=3)
    found = worst_case(oscillator, box, OPEN, [HinfGain("w", "z"), H2Gain("w", "z")], options=options)
    w = np.linspace(0.6, 1.9, 2601)
    scan = 0.0
    for a in np.linspace(-1, 1, 41):
        for b in np.linspace(-1, 1, 41):
            modes = [(1.0 + 0.3 * a), (1.5 + 0.3 * b)]
            scan = max(scan, np.abs(sum(1 / (m * m - w * w + 0.04j * m * w) for m in modes)).max())
    assert found[0].value >= scan * (1 - 1e-3)
    assert found[0].value >= found[0].sampled
    model = oscillator(found[0].parameters)
    at_peak = model.C[:1] @ np.linalg.solve(1j * found[0].omega * np.eye(4) - model.A, model.B[:, :1])
    assert abs(at_peak.item()) == pytest.approx(found[0].value, rel=1e-6)
    assert found[1].value > 0 and set(found[1].parameters) == {"a", "b"}


def test_instability_is_the_worst_of_all() -> None:
    def build(p: Mapping[str, float]) -> StateSpace:
        return StateSpace(
            [[p["pole"]]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
        )

    weak = StateSpace.static([[-0.5]], [("y", 1)], [("u", 1)])
    found = worst_case(build, {"pole": (-1.0, 1.0)}, weak, [HinfGain("w", "z")])
    assert found[0].value == np.inf and found[0].parameters["pole"] >= 0.5


def test_poles_over_the_box() -> None:
    options = WorstCaseOptions(samples=10, climbs=2)
    needs = [ClosedLoopPoles(max_frequency=1.0)]
    found = worst_case(oscillator, {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}, OPEN, needs, options=options)
    assert found[0].value == pytest.approx(1.8, rel=1e-6) and found[0].parameters["b"] == pytest.approx(1.0)


def test_outer_loop_adds_the_worst_models_until_none_is_worse() -> None:
    """1 / (s - pole), pole in [-1, 1]: the effort |k / (k - pole)| <= 1.25 binds at pole 1 only, k >= 5."""

    def build(p: Mapping[str, float]) -> StateSpace:
        D = np.zeros((4, 2))
        D[1, 1] = D[2, 1] = 1.0
        C = [[1.0], [0.0], [0.0], [1.0]]
        outputs = [("z", 1), ("effort", 1), ("cost", 1), ("y", 1)]
        return StateSpace([[p["pole"]]], [[1, 1]], C, D, [("w", 1), ("u", 1)], outputs)

    needs = [HinfGain("w", "z", bound=0.25, hard=True), HinfGain("w", "effort", name="effort")]
    result = tune_robust(
        build, {"pole": (-1.0, 1.0)}, needs, gain([("y", 1)], [("u", 1)]), options=TuningOptions(starts=2)
    )
    assert result.status == "converged"
    # the gain 1 / (k - 1) <= 1/4 asks for k >= 5; the effort k / (k - 1) falls with k, at the pole 1
    assert -result.controller.D.item() >= 5.0 * (1 - 1e-4)
    assert {round(a["pole"], 6) for a in result.active} >= {0.0, 1.0}
    assert len(result.rounds) >= 2
    assert all(w.value <= max(1.0, result.tuning.soft) * 1.01 for w in result.worst)


@pytest.mark.parametrize(
    ("box", "message"), [({}, "box of parameters is empty"), ({"a": (1.0, 0.0)}, "'a': expected finite bounds")]
)
def test_bad_boxes(box: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        worst_case(oscillator, box, OPEN, [HinfGain("w", "z")])


def test_same_seed_same_answer() -> None:
    box = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
    options = WorstCaseOptions(samples=5, climbs=1, seed=3)
    first, again = (worst_case(oscillator, box, OPEN, [HinfGain("w", "z")], options=options) for _ in range(2))
    assert first == again


def test_outer_loop_recovers_when_a_worst_model_is_unstable() -> None:
    """Integral feedback of a resonance: the nominal design uses the collocated phase that a sign change takes away."""

    def build(p: Mapping[str, float]) -> StateSpace:
        A = [[0, 1], [-1, -0.05]]
        B = [[0, 0], [1, 1]]
        C = [[1.0, 0.0], [p["mix"], 1.0]]
        return StateSpace(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])

    box = {"mix": (-2.0, 2.0)}
    structure = gain([("y", 1)], [("u", 1)])
    result = tune_robust(
        build, box, [HinfGain("w", "z")], structure, nominal={"mix": 2.0}, options=TuningOptions(starts=2)
    )
    assert result.rounds[0].worst_soft > 2 * result.rounds[0].soft, "the nominal design is worse or unstable elsewhere"
    assert result.status == "converged"
    assert all(np.isfinite(w.value) for w in result.worst)
    assert result.worst[0].value <= result.tuning.soft * 1.01


def test_runners_up_have_their_peaks_elsewhere() -> None:
    """Two oscillators, each excited most at its own corner of the box: the second peak is reported beside the first."""

    def build(p: dict) -> StateSpace:
        A = np.zeros((4, 4))
        for k, w in enumerate((1.0, 10.0)):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, w], [-w, -0.02 * w]]
        B = np.array([[0.0, 0.0], [p["slow"], 0.0], [0.0, 0.0], [0.9 * p["fast"], 0.0]])
        C = np.array([[1.0, 0.0, 10.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
        return StateSpace(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])

    box = {"slow": (0.1, 1.0), "fast": (0.1, 1.0)}
    none = StateSpace.static([[0.0]], [("y", 1)], [("u", 1)])
    (found,) = worst_case(build, box, none, [HinfGain("w", "z")], options=WorstCaseOptions(samples=10, climbs=0))
    assert found.omega == pytest.approx(1.0, rel=0.05)
    assert len(found.others) == 1
    value, parameters = found.others[0]
    assert 0.85 < value / found.value < 1.0
    assert parameters["fast"] == 1.0 and parameters["slow"] < 1.0


def test_runner_up_beside_a_peak_at_infinite_frequency() -> None:
    """A direct path whose gain is reached at infinity, beside a resonance: no warning, both are reported."""

    def build(p: Mapping[str, float]) -> StateSpace:
        A = [[0.0, 1.0], [-1.0, -0.1]]
        D = [[p["through"], 0.0], [0.0, 0.0]]
        return StateSpace(
            A, [[0, 0], [0.1 * p["mode"], 0]], [[1, 0], [0, 0]], D, [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
        )

    none = StateSpace.static([[0.0]], [("y", 1)], [("u", 1)])
    box = {"through": (0.0, 2.0), "mode": (0.0, 1.5)}
    with np.errstate(all="raise"):
        (found,) = worst_case(build, box, none, [HinfGain("w", "z")], options=WorstCaseOptions(samples=4, climbs=0))
    assert found.value > 2.0 and np.isfinite(found.value)
