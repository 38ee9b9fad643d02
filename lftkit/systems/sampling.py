"""From continuous systems to discrete ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_positive
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.sampled_system import SampledSystem
from lftkit.systems.system import System

METHODS = ("tustin", "hold")


@checked
def sampled(
    system: Any,
    dt: float,
    *,
    method: str = "tustin",
    name: str = "controller",
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sample a system.

    Parameters
    ----------
    system : System, or what :func:`lftkit.systems.exchange.as_system` takes, as an expression
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
        Unknown method, a period that is not positive, or a provenance that is no mapping.
    """
    s = _continuous(system, dt, method).nominal()
    matrices = to_discrete(*s.matrices, dt) if method == "tustin" else _zero_order_hold(*s.matrices, dt)
    if provenance is not None and not isinstance(provenance, Mapping):
        raise InputError(f"provenance must be a mapping, got {type(provenance).__name__}")
    return SampledSystem(*matrices, s.inputs, s.outputs, dt, name=name, provenance=dict(provenance or {}))


@checked
def discretise(system: Any, dt: float, *, method: str = "tustin") -> System:
    """The system in discrete time, as a :class:`System`; :func:`sampled` gives a controller ready to run.

    Parameters
    ----------
    system : System, or what :func:`lftkit.systems.exchange.as_system` takes, as an expression
        Continuous time. Uncertain elements stay with the method "tustin"; dynamics become discrete ones.
    dt : float
        Period [s].
    method : {"tustin", "hold"}
        Bilinear transformation, or zero-order hold of the inputs (certain systems only).

    Raises
    ------
    ValueError
        Unknown method, a period that is not positive, a discrete system, or a hold of an uncertain one.

    Examples
    --------
    >>> from lftkit import transfer
    >>> float(discretise(transfer([1.0], [1.0, 1.0]), 0.5, method="hold").A[0, 0]) == float(np.exp(-0.5))
    True
    """
    continuous = _continuous(system, dt, method)
    matrices = to_discrete(*continuous.lft, dt) if method == "tustin" else _zero_order_hold(*continuous.matrices, dt)
    return continuous.with_lft(matrices, dt=dt)


def _continuous(system: Any, dt: float, method: str) -> System:
    """The system to be sampled, with a period and a method that there are."""
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    as_positive(dt, "dt")
    converted = as_system(system)
    converted.require_continuous()
    return converted


def _zero_order_hold(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, dt: float) -> Matrices:
    n, size = len(A), sum(B.shape)
    whole = np.zeros((size, size))
    whole[:n, :n], whole[:n, n:] = A, B
    step = linalg.expm(whole * dt)[:n]
    return step[:, :n], step[:, n:], C, D
