"""Linear models with named ports: what the tuner works on.

A :class:`Model` is a plant, a weight or a controller. Signals are chosen by port name, never by position.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import control
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from robust_design.norms import checked
from uncertain_systems.delay import pade_matrices
from uncertain_systems.runtime import Port, SampledSystem, port_slices, read_only
from uncertain_systems.system import StateSpaceData

FloatArray = NDArray[np.float64]
sl: Any = scipy.linalg


@dataclass(frozen=True)
class Model:
    """Continuous-time linear system ``x' = A x + B u, y = C x + D u`` with named ports.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m); n may be 0.
    inputs, outputs : sequence of Port (or of (name, size))
        Sizes add up to m and p; names are unique on each side.
    name : str
        What the model is, for messages and results (for instance the parameter values).

    Raises
    ------
    ValueError
        Shapes that do not fit the ports, a name used twice, numbers that are not finite.

    Examples
    --------
    >>> mass = Model([[0, 1], [0, 0]], [[0], [0.5]], [[1, 0]], [[0]], [("force", 1)], [("position", 1)], "2 kg")
    >>> mass.order, mass.channel(["force"], ["position"]).B.ravel().tolist()
    (2, [0.0, 0.5])
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    name: str = "model"

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            ports = tuple(p if isinstance(p, Port) else Port(*p) for p in getattr(self, side))
            names = [p.name for p in ports]
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise ValueError(f"{self.name}: port names must be unique among the {side}, got {twice} twice")
            object.__setattr__(self, side, ports)
        try:
            matrices = checked(self.A, self.B, self.C, self.D)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        expected = (sum(p.size for p in self.outputs), sum(p.size for p in self.inputs))
        if matrices[3].shape != expected:
            raise ValueError(
                f"{self.name}: the ports make {expected[0]} outputs and {expected[1]} inputs, "
                f"matrix D is {matrices[3].shape[0]} x {matrices[3].shape[1]}"
            )
        for key, matrix in zip("ABCD", matrices):
            object.__setattr__(self, key, read_only(matrix))

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(A, B, C, D)."""
        return self.A, self.B, self.C, self.D

    def input_indices(self, names: Iterable[str]) -> NDArray[np.intp]:
        """Columns of the ports `names`, in the order asked for."""
        return _indices(self.inputs, names, f"{self.name}: input")

    def output_indices(self, names: Iterable[str]) -> NDArray[np.intp]:
        """Rows of the ports `names`, in the order asked for."""
        return _indices(self.outputs, names, f"{self.name}: output")

    def channel(self, inputs: Sequence[str], outputs: Sequence[str]) -> Model:
        """The part from the ports `inputs` to the ports `outputs`; all states are kept."""
        cols, rows = self.input_indices(inputs), self.output_indices(outputs)
        by_in = {p.name: p for p in self.inputs}
        by_out = {p.name: p for p in self.outputs}
        return Model(
            self.A,
            self.B[:, cols],
            self.C[rows],
            self.D[np.ix_(rows, cols)],
            tuple(by_in[n] for n in inputs),
            tuple(by_out[n] for n in outputs),
            self.name,
        )

    def renamed(self, name: str) -> Model:
        """Same model under another name."""
        return replace(self, name=name)

    @classmethod
    def from_data(cls, data: StateSpaceData, name: str = "model") -> Model:
        """Model of an uncertain system's numbers at given parameter values; the ports stay."""
        return cls(data.A, data.B, data.C, data.D, data.inputs, data.outputs, name)

    @classmethod
    def from_control(cls, system: Any, units: Mapping[str, str] | None = None, name: str = "") -> Model:
        """Model of a `control.StateSpace`; signals ``port[0], port[1], ...`` become one port each.

        Parameters
        ----------
        system : control.StateSpace
            Continuous time (dt 0 or None).
        units : mapping, optional
            SI unit of each port by name.
        name : str, optional
            Taken from the system otherwise.
        """
        if not isinstance(system, control.StateSpace):
            raise ValueError(f"expected a control.StateSpace, got {type(system).__name__}")
        if system.dt:
            raise ValueError(f"expected a continuous-time system, got sampling period {system.dt}")
        units = units or {}
        return cls(
            system.A,
            system.B,
            system.C,
            system.D,
            _ports(system.input_labels, units),
            _ports(system.output_labels, units),
            name or str(system.name),
        )

    def to_control(self) -> Any:
        """`control.StateSpace` with the signal names of the ports."""
        return control.ss(
            self.A,
            self.B,
            self.C,
            self.D,
            inputs=[s for p in self.inputs for s in p.signals],
            outputs=[s for p in self.outputs for s in p.signals],
            name=self.name,
        )

    def sampled(self, dt: float, provenance: Mapping[str, Any] | None = None) -> SampledSystem:
        """Discretised by Tustin's rule at period `dt` [s]: same ports, stability kept."""
        n = self.order
        if not dt > 0:
            raise ValueError(f"{self.name}: sampling period must be positive, got {dt}")
        left = np.eye(n) - 0.5 * dt * self.A
        a = sl.solve(left, np.eye(n) + 0.5 * dt * self.A) if n else self.A
        b = sl.solve(left, self.B) * dt if n else self.B
        c = sl.solve(left.T, self.C.T).T if n else self.C
        d = self.D + 0.5 * self.C @ b
        return SampledSystem(a, b, c, d, self.inputs, self.outputs, dt, self.name, dict(provenance or {}))


def series(first: Model, second: Model, name: str = "") -> Model:
    """`second` after `first`: y = second(first(u)); sizes must match, the ports of both ends are kept."""
    if first.D.shape[0] != second.D.shape[1]:
        raise ValueError(
            f"series: {first.name} has {first.D.shape[0]} outputs, {second.name} takes {second.D.shape[1]} inputs"
        )
    A = np.block([[first.A, np.zeros((first.order, second.order))], [second.B @ first.C, second.A]])
    B = np.vstack([first.B, second.B @ first.D])
    C = np.hstack([second.D @ first.C, second.C])
    return Model(A, B, C, second.D @ first.D, first.inputs, second.outputs, name or first.name)


def static_gain(gain: ArrayLike, inputs: Sequence[Any], outputs: Sequence[Any], name: str = "gain") -> Model:
    """Model without states, ``y = gain u``."""
    d = np.atleast_2d(np.asarray(gain, dtype=float))
    return Model(
        np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((len(d), 0)), d, tuple(inputs), tuple(outputs), name
    )


def transfer(num: ArrayLike, den: ArrayLike, size: int = 1, name: str = "filter") -> Model:
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
        raise ValueError(
            f"{name}: expected a proper transfer function with leading denominator coefficient other than 0, "
            f"got {numerator.tolist()} / {denominator.tolist()}"
        )
    n = len(denominator) - 1
    a = denominator / denominator[0]
    b = np.concatenate([np.zeros(n + 1 - len(numerator)), numerator]) / denominator[0]
    A = np.diag(np.ones(max(n - 1, 0)), 1) if n else np.zeros((0, 0))
    if n:
        A[-1] = -a[:0:-1]
    B = np.zeros((n, 1))
    B[n - 1 :] = 1.0
    C = (b[1:] - a[1:] * b[0])[::-1][None]
    eye: FloatArray = np.eye(size)
    return Model(
        np.asarray(np.kron(eye, A), dtype=float),
        np.asarray(np.kron(eye, B), dtype=float),
        np.kron(eye, C),
        eye * b[0],
        (Port("in", size),),
        (Port("out", size),),
        name,
    )


def pade_delay(delay: float, order: int, size: int = 1) -> Model:
    """Padé form of ``exp(-s delay)`` on `size` signals (see :func:`uncertain_systems.delay.pade_matrices`)."""
    return Model(*pade_matrices(delay, order, size), (Port("in", size),), (Port("out", size),), f"delay {delay} s")


def close_loop(plant: Model, controller: Model, inputs: Sequence[str], outputs: Sequence[str]) -> Model:
    """Closed loop from `inputs` to `outputs` with the controller between the plant's ports of the same names.

    **Sign: u = + K y.** The controller's inputs are plant outputs, its outputs plant inputs, by name.

    Raises
    ------
    ValueError
        A port that the plant does not have, sizes that differ, a loop that is not well posed.
    """
    y, u = [p.name for p in controller.inputs], [p.name for p in controller.outputs]
    cu, ry = plant.input_indices(u), plant.output_indices(y)
    cw, rz = plant.input_indices(inputs), plant.output_indices(outputs)
    if (len(cu), len(ry)) != controller.D.shape:
        raise ValueError(
            f"{controller.name} is {controller.D.shape[0]} x {controller.D.shape[1]}, the plant's ports "
            f"{u} and {y} need {len(cu)} x {len(ry)}"
        )
    A, B, C, D = plant.matrices
    Ak, Bk, Ck, Dk = controller.matrices
    loop = np.eye(len(cu)) - Dk @ D[np.ix_(ry, cu)]
    if np.abs(sl.det(loop)) < 1e-12:
        raise ValueError(f"the loop of {plant.name} and {controller.name} is not well posed (I - D_K D_22 singular)")
    E = sl.inv(loop)
    B2, C2, D12, D21, D22 = B[:, cu], C[ry], D[np.ix_(rz, cu)], D[np.ix_(ry, cw)], D[np.ix_(ry, cu)]
    X, U, W = E @ Dk @ C2, E @ Ck, E @ Dk @ D21  # u = X x + U x_K + W w
    Acl = np.block([[A + B2 @ X, B2 @ U], [Bk @ (C2 + D22 @ X), Ak + Bk @ D22 @ U]])
    Bcl = np.vstack([B[:, cw] + B2 @ W, Bk @ (D21 + D22 @ W)])
    Ccl = np.hstack([C[rz] + D12 @ X, D12 @ U])
    ports_in = {p.name: p for p in plant.inputs}
    ports_out = {p.name: p for p in plant.outputs}
    return Model(
        Acl,
        Bcl,
        Ccl,
        D[np.ix_(rz, cw)] + D12 @ W,
        tuple(ports_in[n] for n in inputs),
        tuple(ports_out[n] for n in outputs),
        f"{plant.name} with {controller.name}",
    )


def _indices(ports: tuple[Port, ...], names: Iterable[str], what: str) -> NDArray[np.intp]:
    slices = port_slices(ports)
    chosen: list[int] = []
    for name in names:
        if name not in slices:
            raise ValueError(f"{what} port {name!r} does not exist; there are {', '.join(slices) or 'none'}")
        chosen.extend(range(slices[name].start, slices[name].stop))
    return np.array(chosen, dtype=np.intp)


def _ports(labels: Sequence[str], units: Mapping[str, str]) -> tuple[Port, ...]:
    sizes: dict[str, int] = {}
    for label in labels:
        base = re.sub(r"\[\d+\]$", "", label)
        sizes[base] = sizes.get(base, 0) + 1
    return tuple(Port(name, size, units.get(name, "1")) for name, size in sizes.items())
