"""H-infinity norms beside SLICOT's AB13DD, where Slycot is installed, on systems of any order."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import hinf_norm
from lftkit.arrays import FloatArray, Matrices

try:
    import slycot
except ImportError:
    slycot = None

ab13dd: Any = slycot and slycot.ab13dd
"""SLICOT's routine, None where Slycot is not installed."""
RTOL = 1e-6
"""Relative distance of the sides, and the tolerance of AB13DD."""
ROUNDS = 3
"""Of each order, interleaved; medians are given."""
ORDERS = (1, 2, 4, 8, 12, 20, 40, 80, 160, 300)
LARGE = 20
"""Order from which on systems are lightly damped structures."""


def random_system(rng: np.random.Generator, states: int, discrete: bool) -> Matrices:
    """(A, B, C, D): slowest decay 0.01 to 1 rad/s, or largest pole 0.5 to 0.999; every second one without D."""
    A = rng.normal(size=(states, states))
    poles = linalg.eigvals(A)
    if discrete:
        A *= (1.0 - 10.0 ** rng.uniform(-3.0, -0.3)) / np.abs(poles).max()
    else:
        A -= (poles.real.max() + 10.0 ** rng.uniform(-2.0, 0.0)) * np.eye(states)
    return A, rng.normal(size=(states, 2)), rng.normal(size=(2, states)), rng.integers(0, 2) * rng.normal(size=(2, 2))


def structure(rng: np.random.Generator, modes: int, inputs: int = 22) -> Matrices:
    """Modes from 0.1 to 2000 rad/s with damping 0.001 to 0.02, in coordinates that mix all of them."""
    w, zeta = np.sort(10 ** rng.uniform(-1, 3.3, modes)), 10 ** rng.uniform(-3, -1.7, modes)
    A: FloatArray = np.zeros((2 * modes, 2 * modes))
    i = np.arange(modes)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * zeta * w
    B, C = np.zeros((2 * modes, inputs)), np.zeros((2, 2 * modes))
    B[1::2], C[:, ::2] = rng.normal(size=(modes, inputs)), rng.normal(size=(2, modes)) / w
    T = np.eye(2 * modes) + 0.2 * rng.normal(size=A.shape) / np.sqrt(2 * modes)
    inverse = linalg.inv(T)
    return T @ A @ inverse, T @ B, C @ inverse, np.zeros((2, inputs))


def slycot_norms(systems: Sequence[Matrices], time_domain: str = "C", rtol: float = RTOL) -> list[float] | None:
    """Norms by AB13DD, or None where Slycot is not installed."""
    if ab13dd is None:
        return None
    norms = []
    for A, B, C, D in systems:
        n, (p, m) = len(A), D.shape
        norms.append(float(ab13dd(time_domain, "I", "S", "D", n, m, p, A, np.eye(n), B, C, D, rtol)[0]))
    return norms


def compared(orders: Sequence[int] = ORDERS, samples: int = 10) -> Iterator[dict[str, Any]]:
    """One row for each order and time: seconds of a norm, those of AB13DD, their ratio, the largest difference."""
    rng = np.random.default_rng(0)
    for discrete in (False, True):
        for states in orders:
            if states >= LARGE and not discrete:
                systems = [structure(rng, states // 2) for _ in range(samples)]
            else:
                systems = [random_system(rng, states, discrete) for _ in range(samples)]
            yield {
                "time": "discrete" if discrete else "continuous",
                "states": len(systems[0][0]),
                **_row(systems, discrete),
            }


def _row(systems: Sequence[Matrices], discrete: bool) -> dict[str, Any]:
    dt = 1.0 if discrete else None
    ours: list[float] = []
    theirs: list[float] = []
    reference: list[float] | None = None
    for _ in range(ROUNDS):
        begin = time.process_time()
        norms = [hinf_norm(*system, dt=dt, rtol=RTOL) for system in systems]
        middle = time.process_time()
        reference = slycot_norms(systems, "D" if discrete else "C")
        ours.append((middle - begin) / len(systems))
        theirs.append((time.process_time() - middle) / len(systems))
    row: dict[str, Any] = {"seconds": float(np.median(ours))}
    if reference is not None:
        row["slycot_seconds"] = float(np.median(theirs))
        row["times_slycot"] = float(np.median(np.divide(ours, theirs)))
        row["relative_difference"] = max(abs(n.value / r - 1.0) for n, r in zip(norms, reference))
    return row
