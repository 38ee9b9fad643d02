"""From continuous controllers to sampled ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices
from lftkit.systems.bilinear import to_discrete
from lftkit.systems.sampled_system import SampledSystem
from lftkit.systems.state_space import StateSpace
from lftkit.systems.uncertain_system import UncertainSystem

METHODS = ("tustin", "hold")


def sampled(
    system: StateSpace | UncertainSystem,
    dt: float,
    *,
    method: str = "tustin",
    name: str = "controller",
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sample a system.

    Parameters
    ----------
    system : StateSpace or UncertainSystem
        Continuous time; of an uncertain system the nominal member.
    dt : float
        Period [s].
    method : {"tustin", "hold"}
        Bilinear transformation (for controllers: no extra delay) or zero-order hold (for plants).
    name, provenance
        As in :class:`SampledSystem`.

    Raises
    ------
    ValueError
        Unknown method, or a period that is not positive.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt must be positive, got {dt}")
    s = system.data_at({}) if isinstance(system, UncertainSystem) else system
    matrices = to_discrete(*s.matrices, dt) if method == "tustin" else _zero_order_hold(*s.matrices, dt)
    return SampledSystem(*matrices, s.inputs, s.outputs, dt, name=name, provenance=dict(provenance or {}))


def _zero_order_hold(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> Matrices:
    n, size = len(A), sum(B.shape)
    whole = np.zeros((size, size))
    whole[:n, :n], whole[:n, n:] = A, B
    step = linalg.expm(whole * dt)[:n]
    return step[:, :n], step[:, n:], C, D
