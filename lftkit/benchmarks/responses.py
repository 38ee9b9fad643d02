"""Frequency responses beside those of python-control, with its routines as installed."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.benchmarks.norms import structure
from lftkit.systems.ports import Port
from lftkit.systems.system import System

ORDERS = (10, 50, 100, 200)
ROUNDS = 3


def compared(orders: Sequence[int] = ORDERS, points: int = 1000) -> Iterator[dict[str, Any]]:
    """One row for each order: seconds of both, their ratio, the largest relative difference of an entry's norm."""
    import control  # with its pictures

    rng = np.random.default_rng(0)
    for states in orders:
        A, B, C, D = structure(rng, max(states // 2, 1))
        system = System(A, B, C, D, (Port("u", B.shape[1]),), (Port("y", len(C)),))
        omega = frequency_grid(linalg.eigvals(A), 1e-2, 1e4)
        omega = omega[np.linspace(0, len(omega) - 1, min(points, len(omega))).astype(int)]
        ours, theirs = [], []
        for _ in range(ROUNDS):
            begin = time.process_time()
            response = frequency_response(system, omega)
            middle = time.process_time()
            other = control.frequency_response(control.ss(A, B, C, D), omega).complex.transpose(2, 0, 1)
            ours.append(middle - begin)
            theirs.append(time.process_time() - middle)
        difference = _sizes(response - other) / _sizes(other)
        yield {
            "states": len(A),
            "points": len(omega),
            "seconds": float(np.median(ours)),
            "control_seconds": float(np.median(theirs)),
            "ratio": float(np.median(np.divide(theirs, ours))),
            "slycot": bool(control.exception.slycot_check()),
            "relative_difference": float(difference.max()),
        }


def _sizes(responses: ComplexArray) -> FloatArray:
    """Frobenius norm of each response."""
    return np.asarray(np.sqrt(np.sum(np.abs(responses) ** 2, axis=(1, 2))))
