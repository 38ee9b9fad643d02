"""Plants with the ports of a tuning, one signal each, and a static law between them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lftkit.systems.system import System
from lftkit.tuning import gain

STATIC = gain([("y", 1)], [("u", 1)])


def tuned_plant(A: Any, B: Any, C: Any, D: Any = None, dt: float = 0.0, name: str = "plant") -> System:
    """Disturbance w and command u to z and y, or to z, effort and y; no direct path unless it is given."""
    outputs = ("z", "y") if len(C) == 2 else ("z", "effort", "y")
    D = np.zeros((len(outputs), 2)) if D is None else D
    return System(A, B, C, D, [("w", 1), ("u", 1)], [(port, 1) for port in outputs], name, dt)


def lag(pole: float = -1.0, dt: float = 0.0, name: str = "lag") -> System:
    """``x' = pole x + w + u`` with the outputs x, u and x."""
    return tuned_plant([[pole]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]], dt, name)


def first_order(pole: float, dt: float = 0.0) -> System:
    """``x' = pole x + w + u``, x+ in discrete time; controlled and measured is x."""
    return tuned_plant([[pole]], [[1, 1]], [[1], [1]], dt=dt)


def double_integrator() -> System:
    """``1 / s^2``: no static gain of the position stabilises it."""
    return tuned_plant([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], name="double integrator")
