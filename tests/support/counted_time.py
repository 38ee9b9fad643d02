"""Time counted in evaluations, and a plant on which descents take many of them: limits without the machine's speed."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
import scipy.linalg as sl

from lftkit.systems.system import System
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.problem import Problem


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


def counted_evaluations(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every evaluation of a tuning advances the clock that all limits are compared with."""
    monkeypatch.setattr(time, "monotonic", clock)
    monkeypatch.setattr(Problem, "evaluate", clock.counted(Problem.evaluate))
    for name in ("__call__", "_largest", "linearised"):
        monkeypatch.setattr(SmoothObjective, name, clock.counted(getattr(SmoothObjective, name)))


def structure_with_all_states_seen(modes: int, stiffer: float = 1.0) -> System:
    """Lightly damped modes, three forces, three rates; all states and the commands count."""
    rng = np.random.default_rng(1)
    omega = stiffer * np.geomspace(0.5, 300.0, modes)
    A = sl.block_diag(*([[0.0, 1.0], [-w * w, -0.01 * w]] for w in omega))
    n, shapes = 2 * modes, rng.standard_normal((modes, 3))
    B, C = np.zeros((n, 3)), np.zeros((3, n))
    B[1::2], C[:, 1::2] = shapes, shapes.T
    D = np.zeros((n + 6, 6))
    D[n : n + 3, 3:] = np.eye(3)
    outputs = np.vstack([np.eye(n), np.zeros((3, n)), C])
    return System(A, np.hstack([0.1 * B, B]), outputs, D, [("w", 3), ("u", 3)], [("z", n + 3), ("y", 3)])
