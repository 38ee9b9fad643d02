"""Plants whose worst parameters are known, for the worst-case search."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from lftkit.systems.system import System
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.robust.worst_case import WorstCaseOptions, worst_case

OPEN = System.static([[0.0]], [("y", 1)], [("u", 1)], "no controller")


def oscillator(p: Mapping[str, float]) -> System:
    """Two modes whose distance depends on the parameters: their peaks add up where they meet."""
    A = np.zeros((4, 4))
    for i, w in enumerate((1.0 + 0.3 * p["a"], 1.5 + 0.3 * p["b"])):
        A[2 * i, 2 * i + 1] = 1.0
        A[2 * i + 1, 2 * i : 2 * i + 2] = -(w**2), -0.04 * w
    B = np.zeros((4, 2))
    B[1], B[3] = 1.0, 1.0
    C = np.array([[1.0, 0, 1, 0], [1, 0, 1, 0]])
    return System(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])


def first_order(gain: float, decay: float = 1.0) -> System:
    """``gain / (s + decay)`` from w to z: H-infinity norm gain / decay at frequency 0, H2 norm gain / sqrt(2 decay)."""
    ports = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    return System([[-decay]], [[gain, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)), *ports)


def mode(omega: float, damping: float, gain: float = 1.0) -> System:
    """``gain / (s^2 + 2 damping omega s + omega^2)`` from w to z."""
    A = [[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]
    ports = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    return System(A, [[0.0, 0.0], [gain, 1.0]], [[1.0, 0.0], [1.0, 0.0]], np.zeros((2, 2)), *ports)


def mode_peak(omega: float, damping: float) -> tuple[float, float]:
    """Closed form of the peak of a mode and its frequency."""
    return 1.0 / (2.0 * damping * np.sqrt(1.0 - damping**2) * omega**2), omega * np.sqrt(1.0 - 2.0 * damping**2)


def modes(gains: list[float], dampings: float = 0.01) -> System:
    """Parallel modes at 1, 10, 100 ... rad/s whose peaks are `gains` but for what the neighbours add."""
    n = len(gains)
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2)), np.zeros((2, 2 * n))
    for k, g in enumerate(gains):
        w = 10.0**k
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, 1.0], [-(w**2), -2.0 * dampings * w]]
        B[2 * k + 1, 0] = 2.0 * dampings * w**2 * g
        C[0, 2 * k] = 1.0
    return System(A, B, C, np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])


class Recorder:
    """A build function that keeps the parameters it was asked for."""

    def __init__(self, build: Callable[[Mapping[str, float]], System]) -> None:
        self.build = build
        self.asked: list[dict[str, float]] = []

    def __call__(self, p: Mapping[str, float]) -> System:
        self.asked.append(dict(p))
        return self.build(p)

    def table(self) -> np.ndarray:
        return np.array([list(p.values()) for p in self.asked])


GAIN = HinfGain("w", "z")
ONLY_POINTS = WorstCaseOptions(samples=0, climbs=0)


def bump(p: Mapping[str, float]) -> float:
    """Largest, 1, at a = 0.3 and b = -0.2; neither the middle nor a corner of the unit box."""
    return 1.0 / (1.0 + (p["a"] - 0.3) ** 2 + 2.0 * (p["b"] + 0.2) ** 2)


def asked_points(n: int, seed: int, samples: int) -> np.ndarray:
    """All points of a search over n parameters between 2 and 5."""
    build = Recorder(lambda p: first_order(1.0))
    box = {f"p{k}": (2.0, 5.0) for k in range(n)}
    options = WorstCaseOptions(samples=samples, climbs=0, seed=seed)
    (found,) = worst_case(build, box, OPEN, [GAIN], options=options)
    assert found.evaluations == len(build.asked)
    return build.table()
