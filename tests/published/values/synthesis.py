"""Full-order synthesis of the page of published values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lftkit import System, s
from lftkit.synthesis import h2syn, hinfsyn, mixsyn, ncfsyn

Values = Any
PORTS = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
ONE = np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])
"""Of disturbance and noise, command and its cost."""


def disturbance_process() -> System:
    return (200 / (10 * s + 1) / (0.05 * s + 1) ** 2).system("u", "y")


def standard(A: np.ndarray, B1: np.ndarray, B2: np.ndarray, C1: np.ndarray, C2: np.ndarray) -> System:
    """Plant with one disturbance beside the noise, and one error beside the cost."""
    none = np.zeros_like(B1)
    return System(A, np.hstack([B1, none, B2]), np.vstack([C1, np.zeros_like(C1), C2]), ONE, *PORTS)


def example_19_1() -> System:
    A, B1, B2 = np.array([[-1.0, 0, 4], [0, 2, 0], [0, 0, -3]]), np.array([[0.0], [1], [0]]), np.ones((3, 1))
    return standard(A, B1, B2, B1.T, B2.T)


def four_disks() -> System:
    A, B = np.diag(np.ones(7), -1), np.eye(8)[:, :1]
    A[0] = [-0.161, -6.004, -0.58215, -9.9835, -0.40727, -3.982, 0, 0]
    C1 = 1e-3 * np.array([[0, 0, 0, 0, 0.55, 11, 1.32, 18]])
    C2 = np.array([[0, 0, 0.00064432, 0.0023196, 0.071252, 1.0002, 0.10455, 0.99551]])
    return standard(A, B, B, C1, C2)


def scherer() -> System:
    A, B1 = np.array([[0.0, 10, 2], [-1, 1, 0], [0, 2, -5]]), np.array([[1.0], [0], [1]])
    B2, C1 = np.array([[0.0], [1], [0]]), np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0]])
    D = np.array([[0.0, 0], [0, 0], [0, 1], [2, 0]])
    ports = [("w", 1), ("u", 1)], [("z", 3), ("y", 1)]
    return System(A, np.hstack([B1, B2]), np.vstack([C1, [[0.0, 1, 0]]]), D, *ports)


def of_lag() -> System:
    """Controller of ``z = x + u, y = x + w`` for a lag with ``w + u``."""
    ports = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    return h2syn(System([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]], *ports), "y", "u").controller


def at_rest() -> float:
    K = of_lag()
    return float((K.D - K.C @ np.linalg.inv(K.A) @ K.B)[0, 0])


def mixed() -> float:
    return mixsyn(disturbance_process(), ((s / 1.5 + 10) / (s + 1e-3)).system("e", "z"), 1.0).value


def optimum_of_four_disks() -> float:
    found = hinfsyn(four_disks(), "y", "u")
    assert found.lower <= found.value <= 1.0001 * found.lower
    return found.value


COMPUTED: dict[str, Callable[[], Values]] = {
    "pole of the H2-optimal controller": lambda: float(of_lag().A[0, 0]),
    "gain at rest of the H2-optimal controller": at_rest,
    "mixed sensitivity of the disturbance process": mixed,
    "loop shaping of the disturbance process": lambda: (
        ncfsyn(disturbance_process(), ((s + 2) / (s + 1e-6)).system("v", "u")).value
    ),
    "H2-optimal value, example 19.1": lambda: h2syn(example_19_1(), "y", "u").value,
    "H2-optimal value, three states": lambda: h2syn(scherer(), "y", "u").value,
}
