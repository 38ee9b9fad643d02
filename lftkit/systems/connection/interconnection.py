"""Connecting systems by port names; whatever :func:`lftkit.as_system` takes is taken."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import common_period, same_size
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port, as_ports, port_indices, port_slices, total_size
from lftkit.systems.system import System

Source = str | tuple[str, ...]
Connection = tuple[Source, str]


@checked
def connect(
    systems: Mapping[str, System],
    connections: Iterable[Connection],
    *,
    inputs: Sequence[Port | tuple[str, int]] = (),
    outputs: Mapping[str, Source],
) -> System:
    """Connect systems into one.

    Parameters
    ----------
    systems : mapping
        Instance name to system; a port is then called ``"instance.port"``.
    connections : iterable of (source, target)
        Target: an input port. Source: an output port or a port of `inputs` (by its bare name), or a
        tuple of such names, which is their sum; a leading ``-`` changes the sign.
    inputs : sequence of Port (or of (name, size))
        External inputs.
    outputs : mapping
        External output name to its source (same form as above).

    Returns
    -------
    System
        Ports as declared; states and Delta channels of all systems in the order of `systems`.

    Raises
    ------
    ValueError
        Unknown name, a target with two drivers, an input without a driver, sizes or units that
        differ, an algebraic loop that is not well posed. The message lists the existing names.

    Examples
    --------
    A mass on a spring: ``force -> velocity`` with the spring force fed back.

    >>> from lftkit import Port, connect, state_space
    >>> mass = state_space([[0.0]], [[0.5]], [[1.0]], [[0.0]], [Port("f", 1, "N")], [Port("v", 1, "m/s")])
    >>> spring = state_space([[0.0]], [[1.0]], [[8.0]], [[0.0]], [Port("v", 1, "m/s")], [Port("f", 1, "N")])
    >>> loop = connect(
    ...     {"mass": mass, "spring": spring},
    ...     [(("f", "-spring.f"), "mass.f"), ("mass.v", "spring.v")],
    ...     inputs=[Port("f", 1, "N")],
    ...     outputs={"v": "mass.v"},
    ... )
    >>> [round(float(abs(p)), 12) for p in loop.nominal().poles()]  # sqrt(8 N/m / 2 kg)
    [2.0, 2.0]
    """
    systems = {name: as_system(system) for name, system in systems.items()}
    external = as_ports(inputs, "connect, inputs")
    wiring = _Wiring(systems, external)
    drivers: dict[str, Source] = {}
    for source, target in connections:
        if target not in wiring.targets:
            raise InputError(f"input must be one of {', '.join(wiring.targets)}, got {target!r}")
        if target in drivers:
            raise InputError(f"input {target!r} must have one driver, got two: {drivers[target]} and {source}")
        drivers[target] = source
    free = [t for t in wiring.targets if t not in drivers]
    if free:
        raise InputError(
            f"every input must have a driver, got none for {', '.join(free)} (sources: {', '.join(wiring.sources)})"
        )
    whole = _side_by_side(systems)
    for target, port in wiring.targets.items():
        for _, name, source_port in wiring.terms(drivers[target]):
            _check_same(source_port, port, f"{name} -> {target}")
    S, E = wiring.selection([drivers[t] for t in wiring.targets], list(wiring.targets.values()))
    out_ports = tuple(Port(name, *wiring.shape_of(source)) for name, source in outputs.items())
    So, Eo = wiring.selection(list(outputs.values()), out_ports)
    closed = lft.close_loop(whole.lft, len(whole.channels), S, E, So, Eo)
    return whole.with_lft(closed, inputs=external, outputs=out_ports)


class _Wiring:
    """Names and indices of all sources and targets of one `connect` call."""

    def __init__(self, systems: Mapping[str, System], external: Sequence[Port]) -> None:
        for name in systems:
            if "." in name or name.startswith("-"):
                raise InputError(f"name of a system must not contain a dot or start with a minus sign, got {name!r}")
        self.targets = {f"{s}.{p.name}": p for s, system in systems.items() for p in system.inputs}
        inner = {f"{s}.{p.name}": p for s, system in systems.items() for p in system.outputs}
        self.sources = {**inner, **{p.name: p for p in external}}
        self._inner = port_slices([replace(p, name=name) for name, p in inner.items()])
        self._external = port_slices(external)
        self._y = sum(p.size for p in inner.values())
        self._u = sum(p.size for p in external)

    def terms(self, source: Source) -> list[tuple[float, str, Port]]:
        parts = (source,) if isinstance(source, str) else source
        result = []
        for part in parts:
            name = part.removeprefix("-")
            if name not in self.sources:
                raise InputError(f"source must be one of {', '.join(self.sources)}, got {name!r}")
            result.append((-1.0 if part.startswith("-") else 1.0, name, self.sources[name]))
        if not result:
            raise InputError("sum must have at least one source, got an empty tuple")
        return result

    def shape_of(self, source: Source) -> tuple[int, str]:
        terms = self.terms(source)
        first = terms[0][2]
        for _, name, port in terms[1:]:
            _check_same(first, port, f"sum of {terms[0][1]} and {name}")
        return first.size, first.unit

    def selection(self, sources: Sequence[Source], ports: Sequence[Port]) -> tuple[FloatArray, FloatArray]:
        rows = sum(p.size for p in ports)
        S, E = np.zeros((rows, self._y)), np.zeros((rows, self._u))
        start = 0
        for source, port in zip(sources, ports):
            for sign, name, _ in self.terms(source):
                matrix, columns = (S, self._inner[name]) if name in self._inner else (E, self._external[name])
                matrix[start : start + port.size, columns] += sign * np.eye(port.size)
            start += port.size
        return S, E


def _check_same(source: Port, target: Port, where: str) -> None:
    if source.size != target.size:
        raise InputError(f"{where}: ports must have the same size, got {source.size} and {target.size}")
    if source.unit != target.unit:
        raise InputError(f"{where}: ports must have the same unit, got {source.unit!r} and {target.unit!r}")


def _side_by_side(systems: Mapping[str, System]) -> System:
    """All systems in one, unconnected; Delta channels first, ports named ``instance.port``."""
    parts = list(systems.values())
    return System(
        *lft.side_by_side([s.lft for s in parts], [len(s.channels) for s in parts]),
        tuple(replace(p, name=f"{n}.{p.name}") for n, s in systems.items() for p in s.inputs),
        tuple(replace(p, name=f"{n}.{p.name}") for n, s in systems.items() for p in s.outputs),
        dt=common_period(parts),
        channels=tuple(c for s in parts for c in s.channels),
        elements=tuple(e for s in parts for e in s.elements),
    )


@checked
def append(*systems: System) -> System:
    """Systems side by side, unconnected; port names must be unique on each side.

    Examples
    --------
    >>> from lftkit import Port, static_gain
    >>> two = append(*(static_gain([[g]], [Port(f"u{g}", 1)], [Port(f"y{g}", 1)]) for g in (2, 3)))
    >>> two.D.tolist()
    [[2.0, 0.0], [0.0, 3.0]]
    """
    systems = tuple(as_system(s) for s in systems)
    whole = _side_by_side({str(i): s for i, s in enumerate(systems)})
    inputs = tuple(p for s in systems for p in s.inputs)
    return replace(whole, inputs=inputs, outputs=tuple(p for s in systems for p in s.outputs))


@checked
def feedback(forward: Any, backward: Any = None, *, sign: float = -1.0) -> System:
    """``(I - sign G K)^-1 G`` with G forward and K backward, by position; K is 1 where none is given.

    **Negative feedback unless sign is 1.** The ports are those of G; the inputs of K are the outputs of G, and its
    outputs are added to the inputs of G. Each is a :class:`System` or what
    :func:`lftkit.systems.exchange.as_system` takes; a number is that times the identity of the other's size.

    Raises
    ------
    ValueError
        Sizes that differ, a sign other than 1 and -1, or a loop that is not well posed.

    Examples
    --------
    >>> from lftkit import transfer
    >>> lag = feedback(transfer([4.0], [1.0, 0.0]))
    >>> lag.poles().real.tolist()
    [-4.0]
    >>> sensitivity = feedback(1, lag)
    >>> abs(sensitivity(1j) * (1 + lag(1j)) - 1) < 1e-12
    True
    """
    if sign not in (1.0, -1.0):
        raise InputError(f"sign must be 1.0 or -1.0, got {sign}")
    if isinstance(forward, Real) and backward is not None and not isinstance(backward, Real):
        backward = as_system(backward)
        forward = forward * np.eye(total_size(backward.inputs))
    forward = as_system(forward)
    if backward is None:
        same_size(forward.inputs, forward.outputs, "feedback without a second system: inputs and outputs")
        backward = 1.0
    if isinstance(backward, Real):
        backward = backward * np.eye(total_size(forward.inputs), total_size(forward.outputs))
    backward = as_system(backward)
    same_size(forward.outputs, backward.inputs, "feedback: outputs forward and inputs backward")
    same_size(backward.outputs, forward.inputs, "feedback: outputs backward and inputs forward")
    m, p = total_size(forward.inputs), total_size(forward.outputs)
    parts = forward, backward
    q = [len(s.channels) for s in parts]
    S = np.block([[np.zeros((m, p)), sign * np.eye(m)], [np.eye(p), np.zeros((p, m))]])
    E, So = np.eye(m + p)[:, :m], np.eye(p + m)[:p]
    matrices = lft.close_loop(lft.side_by_side([s.lft for s in parts], q), sum(q), S, E, So, np.zeros((p, m)))
    return System(
        *matrices,
        forward.inputs,
        forward.outputs,
        forward.name,
        common_period(parts),
        tuple(c for s in parts for c in s.channels),
        tuple(e for s in parts for e in s.elements),
    )


@checked
def series(first: System, second: System, via: Mapping[str, str]) -> System:
    """`first` drives `second`: `via` maps outputs of the first to inputs of the second.

    All inputs of the second must be driven; the result has the inputs of the first and the outputs
    of the second.
    """
    first, second = as_system(first), as_system(second)
    return connect(
        {"first": first, "second": second},
        [(p.name, f"first.{p.name}") for p in first.inputs] + [(f"first.{a}", f"second.{b}") for a, b in via.items()],
        inputs=first.inputs,
        outputs={p.name: f"second.{p.name}" for p in second.outputs},
    )


@checked
def parallel(first: System, second: System, sign: float = 1.0) -> System:
    """Sum (or with ``sign=-1.0`` difference) of two systems with the same ports."""
    if sign not in (1.0, -1.0):
        raise InputError(f"sign must be 1.0 or -1.0, got {sign}")
    first, second = as_system(first), as_system(second)
    if first.inputs != second.inputs or first.outputs != second.outputs:
        ports = [[[p.name for p in side] for side in (s.inputs, s.outputs)] for s in (first, second)]
        raise InputError(f"parallel systems must have the same ports, got {ports[0]} and {ports[1]}")
    minus = "-" if sign < 0 else ""
    return connect(
        {"first": first, "second": second},
        [(p.name, f"{s}.{p.name}") for s in ("first", "second") for p in first.inputs],
        inputs=first.inputs,
        outputs={p.name: (f"first.{p.name}", f"{minus}second.{p.name}") for p in first.outputs},
    )


@checked
def star(upper: System, lower: System, via: Mapping[str, str]) -> System:
    """Redheffer star product: connected ports are removed, all other ports of both systems stay.

    `via` maps outputs to inputs, each written ``upper.port`` or ``lower.port``.

    Raises
    ------
    ValueError
        As :func:`connect`; also when a free port name is in both systems.
    """
    systems = {"upper": as_system(upper), "lower": as_system(lower)}
    driven = set(via.values())
    free_in = [(n, p) for n, s in systems.items() for p in s.inputs if f"{n}.{p.name}" not in driven]
    free_out = [(n, p) for n, s in systems.items() for p in s.outputs if f"{n}.{p.name}" not in via]
    names = [p.name for _, p in free_out]
    if len(set(names)) < len(names):
        raise InputError(f"free output names of upper and lower must differ, got {sorted(names)}: rename a port")
    return connect(
        systems,
        [*via.items(), *((p.name, f"{n}.{p.name}") for n, p in free_in)],
        inputs=[p for _, p in free_in],
        outputs={p.name: f"{n}.{p.name}" for n, p in free_out},
    )


@checked
def close(plant: System, controller: System, via: Mapping[str, str]) -> System:
    """Lower LFT: close a controller around a plant.

    `via` maps the plant's measurement ports to the controller's input ports and the controller's
    output ports to the plant's command ports, by bare names. **Positive feedback: a negative
    feedback gain has its sign in the controller.**
    """
    plant = as_system(plant)
    plant_out = {p.name for p in plant.outputs}
    wires = {
        (f"upper.{a}" if a in plant_out else f"lower.{a}"): (f"lower.{b}" if a in plant_out else f"upper.{b}")
        for a, b in via.items()
    }
    return star(plant, controller, wires)


@checked
def transform(
    system: System,
    *,
    inputs: Mapping[str, tuple[FloatArray, Port]] | None = None,
    outputs: Mapping[str, tuple[FloatArray, Port]] | None = None,
) -> System:
    """Replace ports by linear images of them; the order of the ports stays.

    Parameters
    ----------
    inputs : mapping
        Port name to (T, new port): the old signal is ``T @ new``, T of shape (old size, new size).
    outputs : mapping
        Port name to (T, new port): the new signal is ``T @ old``, T of shape (new size, old size).

    Raises
    ------
    ValueError
        Unknown port, or a matrix that does not fit.
    """
    q = len(system.channels)
    inputs, outputs = dict(inputs or {}), dict(outputs or {})
    for name in inputs:
        system.input_port(name)
    for name in outputs:
        system.output_port(name)
    right = [inputs.get(p.name, (np.eye(p.size), p)) for p in system.inputs]
    left = [outputs.get(p.name, (np.eye(p.size), p)) for p in system.outputs]
    for old, (T, new) in zip(system.inputs, right):
        if np.shape(T) != (old.size, new.size):
            raise InputError(f"matrix of input {old.name!r} must be {old.size} x {new.size}, got {np.shape(T)}")
    for old, (T, new) in zip(system.outputs, left):
        if np.shape(T) != (new.size, old.size):
            raise InputError(f"matrix of output {old.name!r} must be {new.size} x {old.size}, got {np.shape(T)}")
    R = np.asarray(linalg.block_diag(np.eye(q), *(T for T, _ in right)))
    Lm = np.asarray(linalg.block_diag(np.eye(q), *(T for T, _ in left)))
    return replace(
        system,
        B=system.B @ R,
        C=Lm @ system.C,
        D=Lm @ system.D @ R,
        inputs=tuple(new for _, new in right),
        outputs=tuple(new for _, new in left),
    )


@checked
def invert(system: System, channels: Mapping[str, str]) -> System:
    """Exchange inputs and outputs of chosen channels.

    Each input port `u` in `channels` becomes an output, and the output port `y` that it maps to becomes an
    input of the same size: the new system gives the `u` that produces a given `y`. The direct feedthrough
    of all the channels together must be invertible.

    Raises
    ------
    ValueError
        Unknown port, different sizes, a channel that is not invertible.

    Examples
    --------
    The inverse of a mass seen as acceleration -> force is force -> acceleration:

    >>> from lftkit import static_gain
    >>> mass = static_gain([[2.0]], [Port("a", 1)], [Port("f", 1)])
    >>> float(invert(mass, {"a": "f"}).D[0, 0])
    0.5
    """
    ins = [system.input_port(a) for a in channels]
    outs = [system.output_port(b) for b in channels.values()]
    for a, b in zip(ins, outs):
        if a.size != b.size:
            raise InputError(f"channel {a.name} -> {b.name} must be square to be inverted, got {b.size} x {a.size}")
    q = len(system.channels)
    i, o = (
        q + port_indices(system.inputs, channels, "input"),
        q + port_indices(system.outputs, channels.values(), "output"),
    )
    where = ", ".join(f"{a} -> {b}" for a, b in channels.items())
    matrices = lft.exchanged(system.lft, i, o, f"channel {where} must be invertible")
    swap_in = {a.name: b for a, b in zip(ins, outs)}
    swap_out = {b.name: a for a, b in zip(ins, outs)}
    return system.with_lft(
        matrices,
        inputs=tuple(swap_in.get(p.name, p) for p in system.inputs),
        outputs=tuple(swap_out.get(p.name, p) for p in system.outputs),
    )
