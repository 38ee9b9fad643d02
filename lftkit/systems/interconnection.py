"""Connecting uncertain systems by port names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port, port_indices, port_slices
from lftkit.systems.uncertain_system import UncertainSystem, _solve

Source = str | tuple[str, ...]
Connection = tuple[Source, str]


def connect(
    systems: Mapping[str, UncertainSystem],
    connections: Iterable[Connection],
    *,
    inputs: Sequence[Port] = (),
    outputs: Mapping[str, Source],
) -> UncertainSystem:
    """Connect systems into one.

    Parameters
    ----------
    systems : mapping
        Instance name to system; a port is then called ``"instance.port"``.
    connections : iterable of (source, target)
        Target: an input port. Source: an output port or a port of `inputs` (by its bare name), or a
        tuple of such names, which is their sum; a leading ``-`` changes the sign.
    inputs : sequence of Port
        External inputs.
    outputs : mapping
        External output name to its source (same form as above).

    Returns
    -------
    UncertainSystem
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
    wiring = _Wiring(systems, inputs)
    drivers: dict[str, Source] = {}
    for source, target in connections:
        wiring.target(target)
        if target in drivers:
            raise ValueError(f"input {target!r} must have one driver, got two: {drivers[target]} and {source}")
        drivers[target] = source
    free = [t for t in wiring.targets if t not in drivers]
    if free:
        raise ValueError(
            f"every input must have a driver, got none for {', '.join(free)} (sources: {', '.join(wiring.sources)})"
        )
    whole = _side_by_side(systems)
    S, E = wiring.matrices([(drivers[t], t) for t in wiring.targets], wiring.targets)
    out_ports = tuple(Port(name, *wiring.shape_of(source)) for name, source in outputs.items())
    So, Eo = wiring.selection(list(outputs.values()), out_ports)
    return _close_loop(whole, S, E, So, Eo, tuple(inputs), out_ports)


class _Wiring:
    """Names and indices of all sources and targets of one `connect` call."""

    def __init__(self, systems: Mapping[str, UncertainSystem], external: Sequence[Port]) -> None:
        for name in systems:
            if "." in name or name.startswith("-"):
                raise ValueError(f"name of a system must not contain a dot or start with a minus sign, got {name!r}")
        self.targets = {f"{s}.{p.name}": p for s, system in systems.items() for p in system.inputs}
        inner = {f"{s}.{p.name}": p for s, system in systems.items() for p in system.outputs}
        self.sources = {**inner, **{p.name: p for p in external}}
        self._inner = port_slices([replace(p, name=name) for name, p in inner.items()])
        self._external = port_slices(external)
        self._y = sum(p.size for p in inner.values())
        self._u = sum(p.size for p in external)

    def target(self, name: str) -> Port:
        if name not in self.targets:
            raise ValueError(f"input must be one of {', '.join(self.targets)}, got {name!r}")
        return self.targets[name]

    def terms(self, source: Source) -> list[tuple[float, str, Port]]:
        parts = (source,) if isinstance(source, str) else source
        result = []
        for part in parts:
            name = part.removeprefix("-")
            if name not in self.sources:
                raise ValueError(f"source must be one of {', '.join(self.sources)}, got {name!r}")
            result.append((-1.0 if part.startswith("-") else 1.0, name, self.sources[name]))
        if not result:
            raise ValueError("sum must have at least one source, got an empty tuple")
        return result

    def shape_of(self, source: Source) -> tuple[int, str]:
        terms = self.terms(source)
        first = terms[0][2]
        for _, name, port in terms[1:]:
            _check_same(first, port, f"sum of {terms[0][1]} and {name}")
        return first.size, first.unit

    def matrices(
        self, pairs: Sequence[tuple[Source, str]], targets: Mapping[str, Port]
    ) -> tuple[FloatArray, FloatArray]:
        for source, target in pairs:
            for _, name, port in self.terms(source):
                _check_same(port, targets[target], f"{name} -> {target}")
        return self.selection([s for s, _ in pairs], [targets[t] for _, t in pairs])

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
        raise ValueError(f"{where}: ports must have the same size, got {source.size} and {target.size}")
    if source.unit != target.unit:
        raise ValueError(f"{where}: ports must have the same unit, got {source.unit!r} and {target.unit!r}")


def _side_by_side(systems: Mapping[str, UncertainSystem]) -> UncertainSystem:
    """All systems in one, unconnected; Delta channels first, ports named ``instance.port``."""
    parts = list(systems.values())
    q = [len(s.channels) for s in parts]

    def split(matrices: list[FloatArray], by_rows: bool, by_columns: bool) -> FloatArray:
        block = linalg.block_diag(*matrices) if matrices else np.zeros((0, 0))
        rows = _delta_first([m.shape[0] for m in matrices], q) if by_rows else slice(None)
        columns = _delta_first([m.shape[1] for m in matrices], q) if by_columns else slice(None)
        return np.asarray(block)[rows][:, columns]

    return UncertainSystem(
        split([s.A for s in parts], False, False),
        split([s.B for s in parts], False, True),
        split([s.C for s in parts], True, False),
        split([s.D for s in parts], True, True),
        tuple(replace(p, name=f"{n}.{p.name}") for n, s in systems.items() for p in s.inputs),
        tuple(replace(p, name=f"{n}.{p.name}") for n, s in systems.items() for p in s.outputs),
        tuple(c for s in parts for c in s.channels),
        tuple(p for s in parts for p in s.parameters),
    )


def _delta_first(sizes: Sequence[int], delta: Sequence[int]) -> list[int]:
    starts = [sum(sizes[:i]) for i in range(len(sizes))]
    first = [s + i for s, q in zip(starts, delta) for i in range(q)]
    rest = [s + i for s, q, size in zip(starts, delta, sizes) for i in range(q, size)]
    return first + rest


def _close_loop(
    whole: UncertainSystem,
    S: FloatArray,
    E: FloatArray,
    So: FloatArray,
    Eo: FloatArray,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
) -> UncertainSystem:
    """Close ``u = S y + E u_ext``, read ``So y + Eo u_ext``."""
    q, n = len(whole.channels), whole.order
    Bu, Cy = whole.B[:, q:], whole.C[q:]
    D = whole.D
    Dyy, Dyd, Ddy = D[q:, q:], D[q:, :q], D[:q, q:]
    # u as a function of [x, w_delta, u_ext]
    right = np.hstack([S @ Cy, S @ Dyd, E])
    U = _solve(np.eye(S.shape[0]) - S @ Dyy, right, "these connections must be well posed")
    Ux, Uw, Ue = U[:, :n], U[:, n : n + q], U[:, n + q :]
    Yx, Yw, Ye = Cy + Dyy @ Ux, Dyd + Dyy @ Uw, Dyy @ Ue
    return UncertainSystem(
        whole.A + Bu @ Ux,
        np.hstack([whole.B[:, :q] + Bu @ Uw, Bu @ Ue]),
        np.vstack([whole.C[:q] + Ddy @ Ux, So @ Yx]),
        np.block([[D[:q, :q] + Ddy @ Uw, Ddy @ Ue], [So @ Yw, So @ Ye + Eo]]),
        inputs,
        outputs,
        whole.channels,
        whole.parameters,
    )


def series(first: UncertainSystem, second: UncertainSystem, via: Mapping[str, str]) -> UncertainSystem:
    """`first` drives `second`: `via` maps outputs of the first to inputs of the second.

    All inputs of the second must be driven; the result has the inputs of the first and the outputs
    of the second.
    """
    return connect(
        {"first": first, "second": second},
        [(p.name, f"first.{p.name}") for p in first.inputs] + [(f"first.{a}", f"second.{b}") for a, b in via.items()],
        inputs=first.inputs,
        outputs={p.name: f"second.{p.name}" for p in second.outputs},
    )


def parallel(first: UncertainSystem, second: UncertainSystem, sign: float = 1.0) -> UncertainSystem:
    """Sum (or with ``sign=-1.0`` difference) of two systems with the same ports."""
    if sign not in (1.0, -1.0):
        raise ValueError(f"sign must be 1.0 or -1.0, got {sign}")
    if first.inputs != second.inputs or first.outputs != second.outputs:
        ports = [[[p.name for p in side] for side in (s.inputs, s.outputs)] for s in (first, second)]
        raise ValueError(f"parallel systems must have the same ports, got {ports[0]} and {ports[1]}")
    minus = "-" if sign < 0 else ""
    return connect(
        {"first": first, "second": second},
        [(p.name, f"{s}.{p.name}") for s in ("first", "second") for p in first.inputs],
        inputs=first.inputs,
        outputs={p.name: (f"first.{p.name}", f"{minus}second.{p.name}") for p in first.outputs},
    )


def star(upper: UncertainSystem, lower: UncertainSystem, via: Mapping[str, str]) -> UncertainSystem:
    """Redheffer star product: connected ports are removed, all other ports of both systems stay.

    `via` maps outputs to inputs, each written ``upper.port`` or ``lower.port``.

    Raises
    ------
    ValueError
        As :func:`connect`; also when a free port name is in both systems.
    """
    systems = {"upper": upper, "lower": lower}
    driven = set(via.values())
    free_in = [(n, p) for n, s in systems.items() for p in s.inputs if f"{n}.{p.name}" not in driven]
    free_out = [(n, p) for n, s in systems.items() for p in s.outputs if f"{n}.{p.name}" not in via]
    names = [p.name for _, p in free_out]
    if len(set(names)) < len(names):
        raise ValueError(f"free output names of upper and lower must differ, got {sorted(names)}: rename a port")
    return connect(
        systems,
        [*via.items(), *((p.name, f"{n}.{p.name}") for n, p in free_in)],
        inputs=[p for _, p in free_in],
        outputs={p.name: f"{n}.{p.name}" for n, p in free_out},
    )


def close(plant: UncertainSystem, controller: UncertainSystem, via: Mapping[str, str]) -> UncertainSystem:
    """Lower LFT: close a controller around a plant.

    `via` maps the plant's measurement ports to the controller's input ports and the controller's
    output ports to the plant's command ports, by bare names. **Positive feedback: a negative
    feedback gain has its sign in the controller.**
    """
    plant_out = {p.name for p in plant.outputs}
    wires = {
        (f"upper.{a}" if a in plant_out else f"lower.{a}"): (f"lower.{b}" if a in plant_out else f"upper.{b}")
        for a, b in via.items()
    }
    return star(plant, controller, wires)


def transform(
    system: UncertainSystem,
    *,
    inputs: Mapping[str, tuple[FloatArray, Port]] | None = None,
    outputs: Mapping[str, tuple[FloatArray, Port]] | None = None,
) -> UncertainSystem:
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
            raise ValueError(f"matrix of input {old.name!r} must be {old.size} x {new.size}, got {np.shape(T)}")
    for old, (T, new) in zip(system.outputs, left):
        if np.shape(T) != (new.size, old.size):
            raise ValueError(f"matrix of output {old.name!r} must be {new.size} x {old.size}, got {np.shape(T)}")
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


def invert(system: UncertainSystem, channels: Mapping[str, str]) -> UncertainSystem:
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
            raise ValueError(f"channel {a.name} -> {b.name} must be square to be inverted, got {b.size} x {a.size}")
    q = len(system.channels)
    i, o = (
        q + port_indices(system.inputs, channels, "input"),
        q + port_indices(system.outputs, channels.values(), "output"),
    )
    D11 = system.D[np.ix_(o, i)]
    where = ", ".join(f"{a} -> {b}" for a, b in channels.items())
    Dinv = _solve(D11, np.eye(i.size), f"channel {where} must be invertible")
    keep_i = np.setdiff1d(np.arange(system.D.shape[1]), i)
    keep_o = np.setdiff1d(np.arange(system.D.shape[0]), o)
    Bi, Co = system.B[:, i], system.C[o]
    K, X = Dinv @ Co, Dinv @ system.D[np.ix_(o, keep_i)]
    B, C, D = system.B.copy(), system.C.copy(), system.D.copy()
    D_ki = system.D[np.ix_(keep_o, i)]
    B[:, i], B[:, keep_i] = Bi @ Dinv, system.B[:, keep_i] - Bi @ X
    C[o], C[keep_o] = -K, system.C[keep_o] - D_ki @ K
    D[np.ix_(o, i)], D[np.ix_(o, keep_i)] = Dinv, -X
    D[np.ix_(keep_o, i)] = D_ki @ Dinv
    D[np.ix_(keep_o, keep_i)] = system.D[np.ix_(keep_o, keep_i)] - D_ki @ X
    swap_in = {a.name: b for a, b in zip(ins, outs)}
    swap_out = {b.name: a for a, b in zip(ins, outs)}
    return UncertainSystem(
        system.A - Bi @ K,
        B,
        C,
        D,
        tuple(swap_in.get(p.name, p) for p in system.inputs),
        tuple(swap_out.get(p.name, p) for p in system.outputs),
        system.channels,
        system.parameters,
    )
