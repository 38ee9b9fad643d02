"""Weights of goals: expressions, numbers and matrices, and what is said of those that do not fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal

from lftkit import System, discretise, real, s, transfer
from lftkit.tuning import ClosedLoopPoles, H2Gain, HinfGain, TuningOptions, certify, tune, tune_discrete, worst_case
from lftkit.tuning.goals import Sensitivity
from lftkit.tuning.structures.structures import controller, gain

FEW = TuningOptions(starts=2)
LAW = gain([("y", 1)], [("u", 1)])


def plant(dt: float = 0.0) -> System:
    """``x' = -x + w + u``."""
    ports: Any = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    system = System([[-1]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), *ports)  # type: ignore[arg-type]
    return discretise(system, dt) if dt else system


@pytest.mark.parametrize(
    ("weight", "same"),
    [
        (1 / (s + 1), transfer([1.0], [1.0, 1.0])),
        (signal.TransferFunction([1.0], [1.0, 1.0]), transfer([1.0], [1.0, 1.0])),
        (2.0, System.static([[2.0]], [("in", 1)], [("out", 1)])),
        ([[2.0]], System.static([[2.0]], [("in", 1)], [("out", 1)])),
        (np.array([[2]]), System.static([[2.0]], [("in", 1)], [("out", 1)])),
    ],
)
def test_what_is_a_linear_system_is_a_weight(weight: Any, same: System) -> None:
    K = controller(LAW, [-1.0])
    for side in ("weight_in", "weight_out"):
        given, made = (HinfGain("w", "z", **{side: w}) for w in (weight, same))
        assert isinstance(getattr(given, side), System)
        assert certify([plant()], K, [given]).values == certify([plant()], K, [made]).values
    assert isinstance(Sensitivity("u", weight=weight).weight, System)


def test_an_expression_is_a_weight_of_a_run() -> None:
    """The pole is at most at -5 rad/s: 1/5 at zero frequency, where the weight is 1."""
    goals = [HinfGain("w", "z", weight_out=1 / (s + 1)), ClosedLoopPoles(max_frequency=5.0)]
    found = tune([plant()], goals, LAW, options=TuningOptions(starts=1))
    assert found.soft == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_sizes_of_weights_are_checked_in_one_line(dt: float) -> None:
    run: Any = tune_discrete if dt else tune
    two, lines = np.eye(2), np.ones((3, 1))
    for goal, message in (
        (HinfGain("w", "z", weight_out=two), "HinfGain w -> z: weight_out must have 1 inputs, as many as z, got 2"),
        (HinfGain("w", ("z", "y"), weight_out=2.0), "weight_out must have 2 inputs, as many as z[+]y, got 1"),
        (HinfGain("w", "z", weight_in=lines), "weight_in must have 1 outputs, as many as w, got 3"),
        (H2Gain("w", "z", weight_in=lines), "H2Gain w -> z: weight_in must have 1 outputs, as many as w, got 3"),
        (H2Gain("w", "z", weight_out=two), "weight_out must have 1 inputs, as many as z, got 2"),
        (Sensitivity("u", weight=two), "Sensitivity u: weight_out must have 1 inputs, as many as u.applied, got 2"),
    ):
        with pytest.raises(ValueError, match=message):
            run([plant(dt)], [goal], LAW, options=FEW)
    if not dt:
        goals, K, box = [HinfGain("w", "z", weight_out=two)], controller(LAW, [-1.0]), {"a": (0.0, 1.0)}
        for check in (lambda: certify([plant()], K, goals), lambda: worst_case(lambda _: plant(), box, K, goals)):
            with pytest.raises(ValueError, match="weight_out must have 1 inputs, as many as z, got 2"):
                check()


def test_what_is_no_weight() -> None:
    for weight, message in (
        ("low-pass", "^weight_out: system must be a System, .* got str$"),
        (1 / (s + real("k", 2.0, 1.0, 3.0)), "^weight_out: .* must be certain .* got elements k$"),
        (1 / (s - 1), "must be stable"),
    ):
        given: Any = weight
        with pytest.raises(ValueError, match=message):
            HinfGain("w", "z", weight_out=given)
        with pytest.raises(ValueError, match=message.replace("weight_out", "weight")):
            Sensitivity("u", weight=given)
