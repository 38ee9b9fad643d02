"""Filters: rational weights, the washout, and filters in front of a controller."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.connection.interconnection import connect
from lftkit.systems.control_conversion import rational
from lftkit.systems.ports import Port
from lftkit.systems.system import System, state_space


@checked
def transfer(num: ArrayLike, den: ArrayLike, size: int = 1, name: str = "filter") -> System:
    """Diagonal weight: `size` copies of num(s) / den(s), coefficients from the highest power down.

    Examples
    --------
    A washout passes fast signals and blocks constants:

    >>> washout = transfer([1, 0], [1, 0.1])
    >>> (washout.D - washout.C / washout.A * washout.B).item()
    0.0
    """
    numerator = np.atleast_1d(np.asarray(num, dtype=float))
    denominator = np.atleast_1d(np.asarray(den, dtype=float))
    if len(numerator) > len(denominator) or denominator[0] == 0.0:
        raise InputError(
            f"{name}: expected a proper transfer function with leading denominator coefficient other than 0, "
            f"got {numerator.tolist()} / {denominator.tolist()}"
        )
    A, b, c, d = rational(numerator, denominator)
    eye: FloatArray = np.eye(size)
    A, B, C = (np.asarray(np.kron(eye, M), dtype=float) for M in (A, b[:, None], c[None]))
    return System(A, B, C, eye * d, (Port("in", size),), (Port("out", size),), name)


@checked
def high_pass(port: Port, corner: float) -> System:
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
        raise InputError(f"washout corner must be positive, got {corner} rad/s")
    eye = np.eye(port.size)
    return state_space(-corner * eye, corner * eye, -eye, eye, [port], [port])


def with_input_filter(system: System, filters: Mapping[str, System]) -> System:
    """Put filters in front of named input ports; port names stay.

    Parameters
    ----------
    system : System
    filters : mapping
        Input port to a system with one input and one output port of that name.
    """
    for name in filters:
        system.input_port(name)
    systems = {"system": system, **{f"filter_{name}": f for name, f in filters.items()}}
    wires: list[tuple[str, str]] = []
    for port in system.inputs:
        if port.name in filters:
            filtered = f"filter_{port.name}.{port.name}"
            wires += [(port.name, filtered), (filtered, f"system.{port.name}")]
        else:
            wires.append((port.name, f"system.{port.name}"))
    return connect(systems, wires, inputs=system.inputs, outputs={p.name: f"system.{p.name}" for p in system.outputs})
