"""A mode with an uncertain stiffness under a sampled velocity feedback, and its loop from tick to tick."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from lftkit import Port, RealParameter, SampledSystem, System
from lftkit.arrays import FloatArray

DAMPING = 0.1


def mode_and_law(gain: float, dt: float, pole: float = 0.8) -> tuple[System, SampledSystem]:
    """1 rad/s with k in [0.8, 1.3], a force command and a measured velocity; the law has a lag, x is the error."""
    k = RealParameter("k", 1.0, 0.8, 1.3)
    A, B = [[0.0, 1.0], [-1.0, -DAMPING]], [[0.0, 0.0, 0.0], [-1.0, 1.0, 1.0]]
    C, D = [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]], np.zeros((3, 3))
    inputs, outputs = (Port("force", 1), Port("u", 1)), (Port("v", 1), Port("x", 1))
    plant = System(A, B, C, D, inputs, outputs, channels=("k",), elements=(k,))
    law = SampledSystem([[pole]], [[0.2]], [[gain]], [[0.0]], (Port("v", 1),), (Port("u", 1),), dt=dt, name="law")
    return plant, law


def tick_matrices(plant: System, law: SampledSystem, deviation: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Plant state, held command and law from tick to tick; noise of the measurement. The command has index 2."""
    data = plant.at({"k": 1.0 + deviation})
    step = np.zeros((3, 3))
    step[:2, :2], step[:2, 2] = data.A, data.B[:, 1]
    A, N = np.zeros((4, 4)), np.zeros((4, 1))
    A[:2, :3] = expm(step * law.dt)[:2]
    A[2, 3], A[3, 3], A[3, :2], N[3] = law.C[0, 0], law.A[0, 0], (law.B @ data.C[:1])[0], law.B[0]
    return A, N
