"""Linear systems with named ports that depend on real parameters (upper LFT)."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.systems.control_conversion import continuous_only, ports_and_matrices
from lftkit.systems.ports import Port, port_indices
from lftkit.systems.state_space import StateSpace, real_array
from lftkit.systems.system_summary import html, one_line, text
from lftkit.uncertainty.parameters import RealParameter, checked_values, parameter_table

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class UncertainSystem:
    """Upper linear fractional transformation (LFT) ``F_u(M, Delta)`` with named ports.

    ``Delta = diag(value - nominal)``, a parameter repeated as often as it occurs.

    The stored matrices are those of M: the first inputs and outputs are the Delta channels, one for
    each entry of `channels`; the ports follow in their order. **Delta = 0 is the nominal system.**

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, q + m), (q + p, n), (q + p, q + m) with q Delta channels.
    inputs, outputs : tuple of Port
        Sizes add up to m and p.
    channels : tuple of str
        Parameter name of each Delta channel.
    parameters : tuple of RealParameter
        Definitions of all the names in `channels`.

    Raises
    ------
    ValueError
        Shapes that do not fit, entries that are not finite, a port name used twice, a channel
        without a parameter.

    Examples
    --------
    A gain k in [1, 3], nominal 2, as ``y = 2 u + w`` with ``w = (k - 2) u``:

    >>> k = RealParameter("k", 2.0, 1.0, 3.0)
    >>> u, y = (Port("u", 1),), (Port("y", 1),)
    >>> gain = UncertainSystem([], [], [], [[0.0, 1.0], [1.0, 2.0]], u, y, ("k",), (k,))
    >>> float(gain.at({"k": 3.0}).D[0, 0])
    3.0
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    channels: tuple[str, ...] = ()
    parameters: tuple[RealParameter, ...] = ()

    def __post_init__(self) -> None:
        delta = (Port("Delta", len(self.channels)),) if self.channels else ()
        lft = StateSpace(self.A, self.B, self.C, self.D, (*delta, *self.inputs), (*delta, *self.outputs))
        for key, matrix in zip("ABCD", lft.matrices):
            object.__setattr__(self, key, matrix)
        table = parameter_table(self.parameters)
        missing = sorted(set(self.channels) - set(table))
        if missing:
            raise ValueError(f"every Delta channel must have a RealParameter, got none for {missing[0]!r}")
        used = tuple(p for p in dict.fromkeys(self.parameters) if p.name in set(self.channels))
        object.__setattr__(self, "parameters", used)

    def __repr__(self) -> str:
        used = ", ".join(f"{name} ({n})" for name, n in self.occurrences().items())
        return one_line(self, f"parameters {used}" if used else "certain")

    def _repr_html_(self) -> str:
        return html(self)

    def summary(self) -> str:
        """Order, ports with sizes and units, parameters with ranges and occurrences, as text of several lines."""
        return text(self)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    def occurrences(self) -> dict[str, int]:
        """Number of repetitions of each parameter in Delta, in the order of `parameters`."""
        count = Counter(self.channels)
        return {parameter.name: count[parameter.name] for parameter in self.parameters}

    def parameter(self, name: str) -> RealParameter:
        """Definition of a parameter.

        Raises
        ------
        ValueError
            Unknown parameter; the message lists the existing ones.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(p.name for p in self.parameters)
        raise ValueError(f"parameter must be one of {known or '(none)'}, got {name!r}")

    def data_at(self, values: Mapping[str, float], *, beyond_range: bool = False) -> StateSpace:
        """Matrices at the given parameter values (nominal where none is given).

        Raises
        ------
        ValueError
            Unknown parameter, value outside its range (unless `beyond_range`), or an LFT that is
            not well posed at these values.
        """
        q = len(self.channels)
        table = {p.name: p for p in self.parameters}
        chosen = checked_values(table, values, beyond_range=beyond_range)
        delta = np.array([chosen[c] - table[c].nominal for c in self.channels])
        active = np.flatnonzero(delta)
        A, B, C, D = self.A, self.B[:, q:], self.C[q:], self.D[q:, q:]
        if active.size:
            loop = np.eye(active.size) - self.D[np.ix_(active, active)] * delta[active]
            right = np.hstack([self.C[active], self.D[active, q:]])
            w = delta[active, None] * _solve(loop, right, f"the LFT must be well posed at {dict(values)}")
            n = self.order
            A = A + self.B[:, active] @ w[:, :n]
            B = B + self.B[:, active] @ w[:, n:]
            C = C + self.D[q:, active] @ w[:, :n]
            D = D + self.D[q:, active] @ w[:, n:]
        return StateSpace(A, B, C, D, self.inputs, self.outputs)

    def at(self, values: Mapping[str, float]) -> control.StateSpace:
        """The system at the given parameter values (others nominal), as `control.StateSpace`."""
        return self.data_at(values).to_control()

    def nominal(self) -> control.StateSpace:
        """The system at the nominal parameter values, as `control.StateSpace`."""
        return self.data_at({}).to_control()

    def sample_values(self, rng: np.random.Generator, count: int = 1) -> list[dict[str, float]]:
        """`count` draws of all parameters, uniform in their ranges and independent."""
        return [{p.name: float(rng.uniform(p.lower, p.upper)) for p in self.parameters} for _ in range(count)]

    def sample(self, rng: np.random.Generator, count: int = 1) -> list[control.StateSpace]:
        """The system at `count` random parameter values."""
        return [self.at(values) for values in self.sample_values(rng, count)]

    def __getitem__(self, key: tuple[str | Sequence[str], str | Sequence[str]]) -> UncertainSystem:
        """Sub-system ``system[outputs, inputs]`` by port names; all states and channels stay."""
        if not isinstance(key, tuple) or len(key) != 2:
            raise ValueError(f"index must be [output ports, input ports], for example P['los', 'u'], got {key!r}")
        return self.select(outputs=_names(key[0]), inputs=_names(key[1]))

    def select(self, *, outputs: Iterable[str] | None = None, inputs: Iterable[str] | None = None) -> UncertainSystem:
        """Keep the named ports, in the order given; the other inputs are zero.

        Raises
        ------
        ValueError
            Unknown port; the message lists the existing ones.
        """
        q = len(self.channels)
        keep_in = tuple(self.inputs if inputs is None else (self.input_port(n) for n in inputs))
        keep_out = tuple(self.outputs if outputs is None else (self.output_port(n) for n in outputs))
        columns = np.r_[np.arange(q), q + port_indices(self.inputs, (p.name for p in keep_in), "input")]
        rows = np.r_[np.arange(q), q + port_indices(self.outputs, (p.name for p in keep_out), "output")]
        return replace(
            self,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            inputs=keep_in,
            outputs=keep_out,
        )

    def renamed(
        self, ports: Mapping[str, str] | None = None, parameters: Mapping[str, str] | None = None
    ) -> UncertainSystem:
        """The same system with other port and parameter names (a name that is not given stays).

        Raises
        ------
        ValueError
            A name to be replaced that does not exist.
        """
        ports, parameters = dict(ports or {}), dict(parameters or {})
        known = {p.name for p in self.inputs + self.outputs}
        for name in ports:
            if name not in known:
                raise ValueError(f"port must be one of {', '.join(sorted(known))}, got {name!r}")
        for name in parameters:
            self.parameter(name)
        return replace(
            self,
            inputs=tuple(replace(p, name=ports.get(p.name, p.name)) for p in self.inputs),
            outputs=tuple(replace(p, name=ports.get(p.name, p.name)) for p in self.outputs),
            channels=tuple(parameters.get(c, c) for c in self.channels),
            parameters=tuple(replace(p, name=parameters.get(p.name, p.name)) for p in self.parameters),
        )

    def input_port(self, name: str) -> Port:
        """Input port of this name; a ValueError lists the existing ones."""
        return _find(self.inputs, name, "input")

    def output_port(self, name: str) -> Port:
        """Output port of this name; a ValueError lists the existing ones."""
        return _find(self.outputs, name, "output")

    def sorted_channels(self, order: Sequence[str] | None = None) -> UncertainSystem:
        """The same LFT with the channels of each parameter adjacent, in the order of `order` (default: as stored)."""
        names = list(order) if order is not None else [p.name for p in self.parameters]
        q = len(self.channels)
        rank = {name: i for i, name in enumerate(names)}
        permutation = np.array(sorted(range(q), key=lambda i: rank[self.channels[i]]), dtype=int)
        columns = np.r_[permutation, np.arange(q, self.D.shape[1])].astype(int)
        rows = np.r_[permutation, np.arange(q, self.D.shape[0])].astype(int)
        return replace(
            self,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            channels=tuple(self.channels[i] for i in permutation),
            parameters=tuple(self.parameter(name) for name in names if name in self.channels),
        )

    def normalised(self) -> UncertainSystem:
        """The same uncertain system with every parameter in [-1, 1] and nominal value 0.

        A symmetric range is scaled; an asymmetric one uses the bilinear map of
        :attr:`RealParameter.bilinear`, which adds no occurrence. A normalised value nu
        corresponds to the physical value ``parameter.from_normalised(nu)``.
        """
        q = len(self.channels)
        table = {p.name: p for p in self.parameters}
        ab = np.array([table[c].bilinear for c in self.channels]).reshape(q, 2)
        B, D = self.B.copy(), self.D.copy()
        B[:, :q] *= ab[:, 0]
        D[:, :q] *= ab[:, 0]
        D[np.arange(q), np.arange(q)] -= ab[:, 1]
        unit = tuple(RealParameter(p.name, 0.0, -1.0, 1.0, "1", p.description) for p in self.parameters)
        return replace(self, B=B, D=D, parameters=unit)


def static_gain(matrix: ArrayLike, inputs: Sequence[Port], outputs: Sequence[Port]) -> UncertainSystem:
    """Gain without states or parameters: ``y = matrix u``."""
    return UncertainSystem(_EMPTY, _EMPTY, _EMPTY, real_array("D", matrix), tuple(inputs), tuple(outputs))


def state_space(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, inputs: Sequence[Port], outputs: Sequence[Port]
) -> UncertainSystem:
    """System without parameters from its matrices."""
    a, b, c, d = (real_array(key, matrix) for key, matrix in zip("ABCD", (A, B, C, D)))
    return UncertainSystem(a, b, c, d, tuple(inputs), tuple(outputs))


def from_control(
    system: Any, inputs: Sequence[Port] | None = None, outputs: Sequence[Port] | None = None
) -> UncertainSystem:
    """A `control.StateSpace` in continuous time as a system without parameters.

    Parameters
    ----------
    system : control.StateSpace
        Continuous time (dt 0 or None).
    inputs, outputs : sequence of Port, optional
        Ports whose signals are the labels of the system in some order, or which name its signals anew. Otherwise the
        signals ``w[0], w[1], ...`` become one port ``w``, wherever they stand.

    Raises
    ------
    ValueError
        Another type, a system in discrete time (:meth:`SampledSystem.from_control` takes it), or labels from which
        the ports do not follow.

    Examples
    --------
    >>> import control
    >>> w = control.ss([[-1]], [[1, 2, 3]], [[1]], [[0, 0, 0]], inputs=["w[0]", "v", "w[1]"], outputs=["z"])
    >>> from_control(w)["z", "w"].B.tolist()
    [[1.0, 3.0]]
    """
    matrices, ports_in, ports_out = ports_and_matrices(system, None, inputs, outputs)
    continuous_only(system)
    return state_space(*matrices, ports_in, ports_out)


_EMPTY = np.zeros((0, 0))


def _names(key: str | Sequence[str]) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else tuple(key)


def _find(ports: Sequence[Port], name: str, kind: str) -> Port:
    for port in ports:
        if port.name == name:
            return port
    raise ValueError(f"{kind} port must be one of {', '.join(p.name for p in ports) or '(none)'}, got {name!r}")


def _solve(matrix: FloatArray, right: FloatArray, requirement: str) -> FloatArray:
    """Solve; a singular matrix is a ValueError that begins with `requirement`."""
    if matrix.size == 0:
        return np.zeros_like(right)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", linalg.LinAlgWarning)  # the pivots are checked below
        lu, pivots = linalg.lu_factor(matrix, check_finite=False)
        smallest = np.min(np.abs(np.diag(lu)))
    if not smallest > 1e-14 * np.max(np.abs(matrix)):
        raise ValueError(f"{requirement}, got a singular algebraic loop")
    x = linalg.lu_solve((lu, pivots), right, check_finite=False)
    # One step of iterative refinement makes the solution accurate row by row when the rows differ in scale (Skeel
    # 1980). Slow motion of a free spacecraft needs it: the net force is a small difference of large forces.
    return np.asarray(x + linalg.lu_solve((lu, pivots), right - matrix @ x, check_finite=False))
