"""Structures of controllers: from a parameter vector to state-space matrices, with exact derivatives.

A controller ``x_K' = A_K x_K + B_K y, u = C_K x_K + D_K y`` is one matrix ``[[A_K, B_K], [C_K, D_K]]``, its
*gain matrix*.
A structure gives it from the parameters and pulls a gradient with respect to the gain matrix back to the parameters.
Anything with these methods is a structure (:class:`Structure`): users bring their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import BoolArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.scalars import as_number
from lftkit.systems.arguments import checked
from lftkit.systems.ports import Port, as_ports, read_only
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.system import System
from lftkit.tuning.structures.bounds import Bounds, bounds_by_name, number_of


@runtime_checkable
class Structure(Protocol):
    """What the tuner needs of a controller structure.

    `inputs` are the measurements y, `outputs` the commands u, `order` the number of states, `size` the number of
    parameters. ``gain_matrix(x)`` (order + u, order + y) is differentiable in x (size,); ``pullback(x, G)``
    is the gradient
    with respect to x of ``sum(G * gain_matrix(x))`` for a constant G; ``start(rng)`` a random first guess.
    """

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Ports of the controller's inputs."""
        ...

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Ports of the controller's outputs."""
        ...

    @property
    def order(self) -> int:
        """Number of states."""
        ...

    @property
    def size(self) -> int:
        """Number of parameters."""
        ...

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Matrix [[A, B], [C, D]] of the controller with the parameters `x`."""
        ...

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient with respect to `x` of a function whose gradient by the gain matrix is `G`."""
        ...

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Parameters of a random start."""
        ...


@checked
def controller(structure: Structure, x: ArrayLike, name: str = "K") -> System:
    """Controller of `structure` at the parameters `x` (size,)."""
    n = structure.order
    K = structure.gain_matrix(np.asarray(x, dtype=float))
    return System(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], structure.inputs, structure.outputs, name)


def gain_matrix_of(model: System) -> FloatArray:
    """``[[A, B], [C, D]]`` of a model."""
    return np.block([[model.A, model.B], [model.C, model.D]])


@dataclass(frozen=True)
class AffineStructure:
    """Gain matrix affine in the parameters: ``base + sum_k coefficient_k x[parameter_k] e_row_k e_column_k'``.

    Parameters
    ----------
    inputs, outputs : tuple of Port
    order : int
    base : ndarray, shape (order + u, order + y)
        Fixed part.
    rows, columns, parameters : ndarray of int, shape (k,)
        Entry k of the gain matrix and the parameter it depends on; a parameter may appear more than once.
    coefficients : ndarray, shape (k,)
    spread : float
        Standard deviation of random starts.
    names : tuple of str
        Names of the parameters; default: those of the first entries that they stand in, ``A[0,1]``, ``D[0,0]``.
    bounds : Bounds, optional
        Of the parameters; default: none.
    dt : float, optional
        Sampling period [s] that the entries are made for, 0 for continuous time; default: they are as good for any.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    order: int
    base: FloatArray
    rows: IntArray
    columns: IntArray
    parameters: IntArray
    coefficients: FloatArray
    spread: float = 1.0
    names: tuple[str, ...] = ()
    bounds: Bounds | None = None
    dt: float | None = None

    def __post_init__(self) -> None:
        if not self.names:
            named = {k: f"x[{k}]" for k in range(self.size)}
            for k, row, column in zip(self.parameters[::-1], self.rows[::-1], self.columns[::-1]):
                named[int(k)] = _entry_name(int(row), int(column), self.order)
            object.__setattr__(self, "names", tuple(named.values()))
        if len(self.names) != self.size or len(set(self.names)) < self.size:
            raise InputError(f"names must be {self.size} different ones, got {self.names}")

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.parameters.max(initial=-1)) + 1

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        K = self.base.copy()
        np.add.at(K, (self.rows, self.columns), self.coefficients * x[self.parameters])
        return K

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        weights = self.coefficients * G[self.rows, self.columns]
        return np.bincount(self.parameters, weights=weights, minlength=self.size).astype(float)

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return self.spread * rng.standard_normal(self.size)

    def values(self, x: ArrayLike) -> dict[str, float]:
        """Parameters (size,) by name."""
        return dict(zip(self.names, np.asarray(x, dtype=float).tolist(), strict=True))

    def parameters_of(self, model: System) -> FloatArray:
        """Parameters that give `model`, which must have this structure.

        Raises
        ------
        ValueError
            Other ports or order, or entries that the structure cannot take.
        """
        K = gain_matrix_of(model)
        if K.shape != self.base.shape or model.order != self.order:
            raise InputError(
                f"{model.name} has order {model.order} and gain matrix {K.shape}, "
                f"the structure has order {self.order} and {self.base.shape}"
            )
        selection = np.zeros((K.size, self.size))
        flat = self.rows * K.shape[1] + self.columns
        np.add.at(selection, (flat, self.parameters), self.coefficients)
        x = linalg.lstsq(selection, (K - self.base).ravel())[0] if self.size else np.zeros(0)
        residual = np.abs(self.gain_matrix(x) - K).max(initial=0.0)
        if residual > 1e-9 * max(1.0, np.abs(K).max(initial=0.0)):
            raise InputError(f"{model.name} does not have this structure: an entry differs by {residual:.3g}")
        return np.asarray(x, dtype=float)

    @checked
    def with_fixed(self, entries: Mapping[str | tuple[int, int], float]) -> AffineStructure:
        """Same structure with parameters, by name, or entries (row, column) of the gain matrix held at given values.

        A parameter that an entry depends on is held in all entries that it stands in.

        Raises
        ------
        ValueError
            Another name or entry than those of the structure, an entry that depends on several parameters, or two
            values for one parameter.

        Examples
        --------
        >>> pi = pid("e", "u", derivative_filter=0.1).with_fixed({"Kd": 0.0})
        >>> pi.names, gain([("y", 2)], [("u", 1)]).with_fixed({(0, 1): -3.0}).names
        (('Kp', 'Ki'), ('D[0,0]',))
        """
        base, held = self.base.copy(), dict[int, float]()
        for key, number in entries.items():
            value = as_number(number, f"value of {key}")
            if isinstance(key, str):
                self._hold(held, number_of(key, self.names), value)
                continue
            row, column = key
            if not (0 <= row < base.shape[0] and 0 <= column < base.shape[1]):
                raise InputError(
                    f"entry ({row}, {column}) is outside the {base.shape[0]} x {base.shape[1]} gain matrix"
                )
            entry = np.flatnonzero((self.rows == row) & (self.columns == column))
            if len(entry) > 1:
                names = " and ".join(self.names[k] for k in self.parameters[entry])
                raise InputError(f"entry ({row}, {column}) depends on {names}: fix parameters by name")
            if len(entry):
                difference = (value - self.base[row, column]) / self.coefficients[entry[0]]
                self._hold(held, int(self.parameters[entry[0]]), float(difference))
            else:
                base[row, column] = value
        x, fixed = np.zeros(self.size), np.isin(self.parameters, list(held))
        x[list(held)] = list(held.values())
        np.add.at(base, (self.rows[fixed], self.columns[fixed]), self.coefficients[fixed] * x[self.parameters[fixed]])
        return replace(self.with_entries(~fixed), base=read_only(base))

    def _hold(self, held: dict[int, float], number: int, value: float) -> None:
        if not np.isfinite(value):
            raise InputError(f"value of {self.names[number]} must be finite, got {value}")
        if abs(held.get(number, value) - value) > 1e-12 * abs(value):
            raise InputError(f"{self.names[number]} must be fixed once, got {held[number]:g} and {value:g}")
        held[number] = value

    def with_entries(self, kept: BoolArray) -> AffineStructure:
        """Same structure without some of the tuned entries, shape (k,), and the parameters that only they depend on."""
        left, parameters = np.unique(self.parameters[kept], return_inverse=True)
        return replace(
            self,
            rows=self.rows[kept],
            columns=self.columns[kept],
            parameters=parameters.reshape(-1).astype(np.intp),
            coefficients=self.coefficients[kept],
            names=tuple(self.names[k] for k in left),
            bounds=None if self.bounds is None else self.bounds.of(left),
        )

    @checked
    def with_bounds(self, limits: Mapping[str, tuple[float, float]]) -> AffineStructure:
        """Same structure with parameters, by name, kept between (lowest, highest); either may be infinite.

        Raises
        ------
        ValueError
            An unknown name, or a lowest value that is not below the highest.

        Examples
        --------
        >>> pid("e", "u", derivative_filter=0.1).with_bounds({"Kp": (0.0, 5.0), "Ki": (0.0, np.inf)}).bounds.upper
        array([ 5., inf, inf])
        """
        return replace(self, bounds=bounds_by_name(self.names, self.bounds, limits))


def _entry_name(row: int, column: int, order: int) -> str:
    """Of an entry of the gain matrix, in the part where it stands: ``A[0,1]``, ``B[..]``, ``C[..]``, ``D[..]``."""
    part = ("A", "B", "C", "D")[2 * (row >= order) + (column >= order)]
    return f"{part}[{row - order * (row >= order)},{column - order * (column >= order)}]"


@checked
def state_space(
    inputs: Sequence[Any], outputs: Sequence[Any], order: int, *, form: str = "full", feedthrough: bool = True
) -> AffineStructure:
    """Controller of fixed order, all entries of B_K, C_K (and D_K) free.

    Parameters
    ----------
    inputs, outputs : sequence of Port or (name, size)
        Measurements and commands by the names of the plant's ports.
    order : int
    form : {"full", "tridiagonal", "modal", "companion"}
        Form of A_K: all entries free; three diagonals; independent 2 x 2 blocks ``[[a, b], [c, d]]`` (any
        pair of poles);
        one companion matrix. Each of them reaches every controller of this order with distinct poles.
    feedthrough : bool
        Whether D_K is free (True) or zero.

    Examples
    --------
    >>> state_space([("y", 22)], [("u", 2)], 4, form="tridiagonal").size
    150
    """
    ny, nu = total_size(inputs), total_size(outputs)
    if order < 0:
        raise InputError(f"the order of a controller must be zero or positive, got {order}")
    free = np.ones((order + nu, order + ny), dtype=bool)
    i, j = np.indices((order, order))
    forms = {
        "full": np.ones((order, order), dtype=bool),
        "tridiagonal": np.abs(i - j) <= 1,
        "modal": i // 2 == j // 2,
        "companion": i == order - 1,
    }
    if form not in forms:
        raise InputError(f"form must be one of {', '.join(forms)}, got {form!r}")
    free[:order, :order] = forms[form]
    free[order:, order:] = feedthrough
    ins = tuple(p if isinstance(p, Port) else Port(*p) for p in inputs)
    outs = tuple(p if isinstance(p, Port) else Port(*p) for p in outputs)
    base = np.zeros(free.shape)
    if form == "companion" and order > 1:
        base[np.arange(order - 1), np.arange(1, order)] = 1.0
    rows, columns = np.nonzero(free)
    return AffineStructure(
        ins,
        outs,
        order,
        read_only(base),
        rows,
        columns,
        np.arange(len(rows)),
        np.ones(len(rows)),
        1.0,
    )


@checked
def gain(inputs: Sequence[Any], outputs: Sequence[Any]) -> AffineStructure:
    """Static output feedback ``u = D_K y`` with a full matrix."""
    return state_space(inputs, outputs, 0)


@checked
def pid(
    measurement: str, command: str, *, derivative_filter: float | None = None, terms: str = "PID", dt: float = 0.0
) -> AffineStructure:
    """``u = (Kp + Ki / s + Kd s / (derivative_filter s + 1)) y`` with parameters Kp, Ki, Kd, those in `terms`.

    The time constant `derivative_filter` [s] is that of the term D. With a sampling period `dt` [s] the structure is
    discrete, by the trapezoidal rule: ``s = (2 / dt) (z - 1) / (z + 1)``.

    Examples
    --------
    >>> controller(pid("e", "u", derivative_filter=0.01), [2.0, 0.5, 0.1]).D.item()
    12.0
    """
    if not terms or set(terms) - set("PID"):
        raise InputError(f"terms must be letters of 'PID', got {terms!r}")
    if derivative_filter is None and "D" not in terms:
        derivative_filter = 1.0
    if derivative_filter is None or not derivative_filter > 0:
        raise InputError(f"derivative_filter must be a positive time constant [s], got {derivative_filter}")
    if not (dt >= 0 and np.isfinite(dt)):
        raise InputError(f"dt must be a sampling period [s], or 0 for continuous time, got {dt}")
    rate = 1.0 / derivative_filter
    # states: integral of y; filtered y, of which Kd s / (tau s + 1) = Kd / tau (1 - 1 / (tau s + 1))
    A, B = np.diag([0.0, -rate]), np.array([[1.0], [rate]])
    C, D = np.diag([1.0, -rate]), np.array([[0.0], [rate]])  # of the terms I and D, which have the gains 1
    if dt:
        A, B, C, D = to_discrete(A, B, C, D, dt)
    base = np.block([[A, B], [np.zeros((1, 3))]])
    integral, derivative = ([(2, k, C[k, k]), (2, 2, D[k, 0])] for k in range(2))
    entries = {"P": [(2, 2, 1.0)], "I": integral if dt else integral[:1], "D": derivative}
    listed = [(r, c, k, v) for k, t in enumerate(terms) for r, c, v in entries[t]]
    rows, columns, parameters = (np.array([e[i] for e in listed], dtype=np.intp) for i in range(3))
    keep = [s for s, term in ((0, "I"), (1, "D")) if term in terms]
    index = np.array([*keep, 2])
    position = {old: new for new, old in enumerate(index.tolist())}
    return AffineStructure(
        (Port(measurement, 1),),
        (Port(command, 1),),
        len(keep),
        read_only(base[np.ix_(index, index)]),
        np.array([position[r] for r in rows.tolist()], dtype=np.intp),
        np.array([position[c] for c in columns.tolist()], dtype=np.intp),
        parameters,
        np.array([e[3] for e in listed]),
        names=tuple(f"K{term.lower()}" for term in terms),
        dt=dt,
    )


def total_size(ports: Sequence[Any]) -> int:
    """Sum of the sizes of ports, given as Port or (name, size)."""
    return sum(p.size for p in as_ports(ports, "ports"))


def jacobian(structure: Structure, x: FloatArray) -> FloatArray:
    """Derivative of the gain matrix's entries (row by row) with respect to the parameters: shape (entries, size)."""
    shape = structure.gain_matrix(x).shape
    unit = np.zeros(shape)
    rows = []
    for index in np.ndindex(shape):
        unit[index] = 1.0
        rows.append(structure.pullback(x, unit))
        unit[index] = 0.0
    return np.array(rows)


def gain_sizes(K: FloatArray, n: int) -> FloatArray:
    """Size of each entry of the gain matrix `K` of order `n`, for steps in proportion.

    That of A, of a column of B, of a row of C, and their product or that of D; infinite where a whole part is zero.
    """
    D = np.abs(K[n:, n:])
    if n == 0:
        return _or_infinite(np.maximum(D, float(np.sqrt(np.mean(D**2)))))
    inner = max(float(np.sqrt(np.mean(K[:n, :n] ** 2))), 1e-12)
    columns, rows = (np.sqrt(np.mean(part**2, axis=k)) for k, part in enumerate((K[:n, n:], K[n:, :n])))
    columns, rows = (np.maximum(v, 1e-3 * float(v.max(initial=0.0))) for v in (columns, rows))
    direct = np.maximum(np.outer(rows, columns) / inner, D)
    columns, rows = _or_infinite(columns), _or_infinite(rows)
    left = np.vstack([np.full((n, n), inner), np.tile(rows[:, None], (1, n))])
    return np.hstack([left, np.vstack([np.tile(columns, (n, 1)), _or_infinite(direct)])])


def _or_infinite(sizes: FloatArray) -> FloatArray:
    return np.asarray(np.where(sizes > 0.0, sizes, np.inf))
