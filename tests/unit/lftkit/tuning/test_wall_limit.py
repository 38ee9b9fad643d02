"""The wall limit of a problem with many states and outputs: at most a few evaluations after it."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl

from lftkit.systems.system import System
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.structures.structures import state_space
from lftkit.tuning.tuner import TuningOptions, tune

AFTER = 4  # evaluations after the limit: the one that is running, the point that is kept, and the result


class Clock:
    """Stands in for ``time.monotonic``: every evaluation takes one second, and nothing else takes any."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def counted(self, function: Any) -> Any:
        def longer(*arguments: Any, **named: Any) -> Any:
            self.now += 1.0
            return function(*arguments, **named)

        return longer


def structure_with_all_states_seen(modes: int) -> System:
    """Lightly damped modes, three forces, three rates; all states and the commands count."""
    rng = np.random.default_rng(1)
    omega = np.geomspace(0.5, 300.0, modes)
    A = sl.block_diag(*([[0.0, 1.0], [-w * w, -0.01 * w]] for w in omega))
    n, shapes = 2 * modes, rng.standard_normal((modes, 3))
    B, C = np.zeros((n, 3)), np.zeros((3, n))
    B[1::2], C[:, 1::2] = shapes, shapes.T
    D = np.zeros((n + 6, 6))
    D[n : n + 3, 3:] = np.eye(3)
    outputs = np.vstack([np.eye(n), np.zeros((3, n)), C])
    return System(A, np.hstack([0.1 * B, B]), outputs, D, [("w", 3), ("u", 3)], [("z", n + 3), ("y", 3)])


@pytest.mark.parametrize("limit", [0.5, 10.5, 60.5])
@pytest.mark.parametrize("order", [0, 1])
def test_no_more_than_a_few_evaluations_after_the_limit(
    limit: float, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = structure_with_all_states_seen(22)
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock)
    monkeypatch.setattr(Problem, "evaluate", clock.counted(Problem.evaluate))
    for name in ("__call__", "_largest", "linearised"):
        monkeypatch.setattr(SmoothObjective, name, clock.counted(getattr(SmoothObjective, name)))
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
