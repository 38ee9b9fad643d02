"""From continuous controllers to sampled ones, and the filters that fly with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import signal

from uncertain_systems.interconnection import connect
from uncertain_systems.runtime import Port, SampledSystem
from uncertain_systems.system import UncertainSystem, state_space

METHODS = {"tustin": "bilinear", "hold": "zoh"}


def high_pass(port: Port, corner: float) -> UncertainSystem:
    """First-order washout ``s / (s + corner)`` on every signal of a port; input and output have its name.

    Parameters
    ----------
    port : Port
    corner : float
        rad/s, positive.

    Examples
    --------
    A constant bias dies out:

    >>> f = high_pass(Port("a", 1, "m/s2"), 0.1).nominal()
    >>> float(abs(f(0))), round(float(abs(f(10j))), 4)
    (0.0, 1.0)
    """
    if not corner > 0.0:
        raise ValueError(f"washout corner must be positive, got {corner} rad/s")
    eye = np.eye(port.size)
    return state_space(-corner * eye, corner * eye, -eye, eye, [port], [port])


def with_input_filter(system: UncertainSystem, filters: Mapping[str, UncertainSystem]) -> UncertainSystem:
    """Put filters in front of named input ports; port names stay.

    Parameters
    ----------
    system : UncertainSystem
    filters : mapping
        Input port to a system with one input and one output port of that name.
    """
    for name in filters:
        system.input_port(name)
    systems = {"system": system, **{f"filter_{name}": f for name, f in filters.items()}}
    wires: list[tuple[str, str]] = []
    for port in system.inputs:
        if port.name in filters:
            wires += [
                (port.name, f"filter_{port.name}.{port.name}"),
                (f"filter_{port.name}.{port.name}", f"system.{port.name}"),
            ]
        else:
            wires.append((port.name, f"system.{port.name}"))
    return connect(systems, wires, inputs=system.inputs, outputs={p.name: f"system.{p.name}" for p in system.outputs})


def sampled(
    system: UncertainSystem,
    dt: float,
    *,
    method: str = "tustin",
    name: str = "controller",
    provenance: Mapping[str, Any] | None = None,
) -> SampledSystem:
    """Sample a system without parameters.

    Parameters
    ----------
    system : UncertainSystem
        Continuous time; parameters, if any, at their nominal values.
    dt : float
        Period [s].
    method : {"tustin", "hold"}
        Bilinear transformation (for controllers: no extra delay) or zero-order hold (for plants).
    name, provenance
        As in :class:`SampledSystem`.

    Raises
    ------
    ValueError
        Unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"unknown sampling method {method!r}, expected one of: {', '.join(METHODS)}")
    s = system.data_at({})
    if s.A.shape[0] == 0:
        A, B, C, D = s.A, s.B, s.C, s.D
    else:
        kind: Any = METHODS[method]
        A, B, C, D, _ = signal.cont2discrete((s.A, s.B, s.C, s.D), dt, method=kind)
    return SampledSystem(A, B, C, D, s.inputs, s.outputs, dt, name=name, provenance=dict(provenance or {}))
