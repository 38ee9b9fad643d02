"""Structures of controllers: from a parameter vector to state-space matrices, with exact derivatives.

A controller ``x_K' = A_K x_K + B_K y, u = C_K x_K + D_K y`` is one matrix ``[[A_K, B_K], [C_K, D_K]]``, its *gain matrix*.
A structure gives it from the parameters and pulls a gradient with respect to the gain matrix back to the parameters.
Anything with these methods is a structure (:class:`Structure`): users bring their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from robust_design.model import Model
from uncertain_systems.runtime import Port, read_only

FloatArray = NDArray[np.float64]
sl: Any = scipy.linalg


@runtime_checkable
class Structure(Protocol):
    """What the tuner needs of a controller structure.

    `inputs` are the measurements y, `outputs` the commands u, `order` the number of states, `size` the number of
    parameters. ``gain_matrix(x)`` (order + u, order + y) is differentiable in x (size,); ``pullback(x, G)`` is the gradient
    with respect to x of ``sum(G * gain_matrix(x))`` for a constant G; ``start(rng)`` a random first guess.
    """

    @property
    def inputs(self) -> tuple[Port, ...]: ...
    @property
    def outputs(self) -> tuple[Port, ...]: ...
    @property
    def order(self) -> int: ...
    @property
    def size(self) -> int: ...
    def gain_matrix(self, x: FloatArray) -> FloatArray: ...
    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray: ...
    def start(self, rng: np.random.Generator) -> FloatArray: ...


def controller(structure: Structure, x: ArrayLike, name: str = "K") -> Model:
    """Controller of `structure` at the parameters `x` (size,)."""
    n = structure.order
    K = structure.gain_matrix(np.asarray(x, dtype=float))
    return Model(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], structure.inputs, structure.outputs, name)


def gain_matrix_of(model: Model) -> FloatArray:
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
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    order: int
    base: FloatArray
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    parameters: NDArray[np.intp]
    coefficients: FloatArray
    spread: float = 1.0

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

    def parameters_of(self, model: Model) -> FloatArray:
        """Parameters that give `model`, which must have this structure.

        Raises
        ------
        ValueError
            Other ports or order, or entries that the structure cannot take.
        """
        K = gain_matrix_of(model)
        if K.shape != self.base.shape or model.order != self.order:
            raise ValueError(
                f"{model.name} has order {model.order} and gain matrix {K.shape}, "
                f"the structure has order {self.order} and {self.base.shape}"
            )
        selection = np.zeros((K.size, self.size))
        flat = self.rows * K.shape[1] + self.columns
        np.add.at(selection, (flat, self.parameters), self.coefficients)
        x = sl.lstsq(selection, (K - self.base).ravel())[0] if self.size else np.zeros(0)
        residual = np.abs(self.gain_matrix(x) - K).max(initial=0.0)
        if residual > 1e-9 * max(1.0, np.abs(K).max(initial=0.0)):
            raise ValueError(f"{model.name} does not have this structure: an entry differs by {residual:.3g}")
        return np.asarray(x, dtype=float)

    def with_fixed(self, entries: Mapping[tuple[int, int], float]) -> AffineStructure:
        """Same structure with entries (row, column) of the gain matrix held at given values."""
        base, keep = self.base.copy(), np.ones(len(self.rows), dtype=bool)
        for (row, column), value in entries.items():
            if not (0 <= row < base.shape[0] and 0 <= column < base.shape[1]):
                raise ValueError(f"entry ({row}, {column}) is outside the {base.shape[0]} x {base.shape[1]} gain matrix")
            keep &= ~((self.rows == row) & (self.columns == column))
            base[row, column] = value
        used, parameters = np.unique(self.parameters[keep], return_inverse=True)
        return replace(
            self,
            base=read_only(base),
            rows=self.rows[keep],
            columns=self.columns[keep],
            parameters=parameters.reshape(-1).astype(np.intp),
            coefficients=self.coefficients[keep],
        )


def _affine(
    inputs: Sequence[Any], outputs: Sequence[Any], order: int, free: NDArray[np.bool_], spread: float = 1.0
) -> AffineStructure:
    ins = tuple(p if isinstance(p, Port) else Port(*p) for p in inputs)
    outs = tuple(p if isinstance(p, Port) else Port(*p) for p in outputs)
    rows, columns = np.nonzero(free)
    return AffineStructure(
        ins, outs, order, read_only(np.zeros(free.shape)), rows, columns, np.arange(len(rows)), np.ones(len(rows)), spread
    )


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
        Form of A_K: all entries free; three diagonals; independent 2 x 2 blocks ``[[a, b], [c, d]]`` (any pair of poles);
        one companion matrix. Each of them reaches every controller of this order with distinct poles.
    feedthrough : bool
        Whether D_K is free (True) or zero.

    Examples
    --------
    >>> state_space([("y", 22)], [("u", 2)], 4, form="tridiagonal").size
    150
    """
    ny, nu = _total(inputs), _total(outputs)
    if order < 0:
        raise ValueError(f"the order of a controller must be zero or positive, got {order}")
    free = np.ones((order + nu, order + ny), dtype=bool)
    i, j = np.indices((order, order))
    forms = {
        "full": np.ones((order, order), dtype=bool),
        "tridiagonal": np.abs(i - j) <= 1,
        "modal": i // 2 == j // 2,
        "companion": i == order - 1,
    }
    if form not in forms:
        raise ValueError(f"form must be one of {', '.join(forms)}, got {form!r}")
    free[:order, :order] = forms[form]
    free[order:, order:] = feedthrough
    structure = _affine(inputs, outputs, order, free)
    if form == "companion" and order > 1:
        base = structure.base.copy()
        base[np.arange(order - 1), np.arange(1, order)] = 1.0
        structure = replace(structure, base=read_only(base))
    return structure


def gain(inputs: Sequence[Any], outputs: Sequence[Any]) -> AffineStructure:
    """Static output feedback ``u = D_K y`` with a full matrix."""
    return state_space(inputs, outputs, 0)


def pid(
    measurement: str, command: str, *, derivative_filter: float, terms: str = "PID"
) -> AffineStructure:
    """``u = (Kp + Ki / s + Kd s / (derivative_filter s + 1)) y`` with parameters (Kp, Ki, Kd), those in `terms`.

    Examples
    --------
    >>> controller(pid("e", "u", derivative_filter=0.01), [2.0, 0.5, 0.1]).D.item()
    12.0
    """
    if not derivative_filter > 0:
        raise ValueError(f"derivative_filter must be a positive time constant [s], got {derivative_filter}")
    if not terms or set(terms) - set("PID"):
        raise ValueError(f"terms must be letters of 'PID', got {terms!r}")
    tau = derivative_filter
    # states: integral of y, filtered y; Kd s / (tau s + 1) = Kd / tau (1 - 1 / (tau s + 1))
    base = np.array([[0.0, 0.0, 1.0], [0.0, -1.0 / tau, 1.0 / tau], [0.0, 0.0, 0.0]])
    entries = {"P": [(2, 2, 1.0)], "I": [(2, 0, 1.0)], "D": [(2, 2, 1.0 / tau), (2, 1, -1.0 / tau)]}
    listed = [(r, c, k, v) for k, t in enumerate(terms) for r, c, v in entries[t]]
    rows, columns, parameters = (np.array([e[i] for e in listed], dtype=np.intp) for i in range(3))
    keep = [s for s, term in ((0, "I"), (1, "D")) if term in terms]
    index = np.array([*keep, 2])
    place = {old: new for new, old in enumerate(index.tolist())}
    return AffineStructure(
        (Port(measurement, 1),),
        (Port(command, 1),),
        len(keep),
        read_only(base[np.ix_(index, index)]),
        np.array([place[r] for r in rows.tolist()], dtype=np.intp),
        np.array([place[c] for c in columns.tolist()], dtype=np.intp),
        parameters,
        np.array([e[3] for e in listed]),
    )


@dataclass(frozen=True)
class StableStateSpace:
    """Controller of fixed order that is stable at every parameter value.

    ``A_K = S - S' - L L' - min_decay I`` with S strictly lower and L lower triangular: A_K + A_K' is negative definite. Every stable
    controller with abscissa below -min_decay has such a realisation (change coordinates by its Lyapunov matrix).

    Parameters
    ----------
    inputs, outputs : tuple of Port
    order : int
    min_decay : float
        Every pole has real part at most -min_decay [rad/s].
    feedthrough : bool
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    order: int
    min_decay: float = 1e-3
    feedthrough: bool = True

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            ports = tuple(p if isinstance(p, Port) else Port(*p) for p in getattr(self, side))
            object.__setattr__(self, side, ports)
        if self.order < 1 or not self.min_decay > 0:
            raise ValueError(
                f"order must be at least 1 and min_decay positive, got {self.order} and {self.min_decay}"
            )

    @property
    def _sizes(self) -> tuple[int, int, int, int, int]:
        n, ny, nu = self.order, _total(self.inputs), _total(self.outputs)
        return n * (n - 1) // 2, n * (n + 1) // 2, n * ny, nu * n, nu * ny if self.feedthrough else 0

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(self._sizes)

    def _split(self, x: FloatArray) -> list[FloatArray]:
        return np.split(x, np.cumsum(self._sizes)[:-1])

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        n, nu, ny = self.order, _total(self.outputs), _total(self.inputs)
        s, l, b, c, d = self._split(x)
        S, L = np.zeros((n, n)), np.zeros((n, n))
        S[np.tril_indices(n, -1)], L[np.tril_indices(n)] = s, l
        A = S - S.T - L @ L.T - self.min_decay * np.eye(n)
        D = d.reshape(nu, ny) if self.feedthrough else np.zeros((nu, ny))
        return np.block([[A, b.reshape(n, ny)], [c.reshape(nu, n), D]])

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        n = self.order
        L = np.zeros((n, n))
        L[np.tril_indices(n)] = self._split(x)[1]
        GA = G[:n, :n]
        parts = [
            (GA - GA.T)[np.tril_indices(n, -1)],
            (-(GA + GA.T) @ L)[np.tril_indices(n)],
            G[:n, n:].ravel(),
            G[n:, :n].ravel(),
        ]
        if self.feedthrough:
            parts.append(G[n:, n:].ravel())
        return np.concatenate(parts)

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return rng.standard_normal(self.size)

    def parameters_of(self, model: Model) -> FloatArray:
        """Parameters of a stable `model`, after a change of state coordinates (same transfer function).

        Raises
        ------
        ValueError
            The model's poles do not all decay faster than min_decay.
        """
        n = self.order
        shifted = model.A + self.min_decay * np.eye(n)
        if model.order != n or np.any(sl.eigvals(shifted).real >= 0.0):
            raise ValueError(
                f"{model.name}: expected order {n} and every pole left of -{self.min_decay} rad/s, got order "
                f"{model.order} and poles {np.round(sl.eigvals(model.A), 6).tolist()}"
            )
        P = sl.solve_continuous_lyapunov(shifted, -np.eye(n))
        T = sl.cholesky(P, lower=True)
        A = sl.solve_triangular(T, model.A @ T, lower=True)
        L = sl.cholesky(-0.5 * (A + A.T) - self.min_decay * np.eye(n), lower=True)
        B = sl.solve_triangular(T, model.B, lower=True)
        S = 0.5 * (A - A.T)
        parts = [S[np.tril_indices(n, -1)], L[np.tril_indices(n)], B.ravel(), (model.C @ T).ravel()]
        return np.concatenate([*parts, model.D.ravel()] if self.feedthrough else parts)


@dataclass(frozen=True)
class Decentralised:
    """Several controllers side by side, each seeing its own measurements only.

    Parameters
    ----------
    parts : tuple of Structure
        Their ports must not overlap.
    """

    parts: tuple[Structure, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        for side in ("inputs", "outputs"):
            names = [p.name for part in self.parts for p in getattr(part, side)]
            if len(set(names)) < len(names):
                raise ValueError(f"decentralised parts must not share {side}, got {names}")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measurements of all parts."""
        return tuple(p for part in self.parts for p in part.inputs)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Commands of all parts."""
        return tuple(p for part in self.parts for p in part.outputs)

    @property
    def order(self) -> int:
        """Sum of the orders."""
        return sum(part.order for part in self.parts)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(part.size for part in self.parts)

    def _pieces(self) -> list[tuple[Structure, slice, Any]]:
        found, at, x, y, u = [], 0, 0, self.order, self.order
        for part in self.parts:
            ny, nu = _total(part.inputs), _total(part.outputs)
            rows = np.r_[x : x + part.order, u : u + nu]
            columns = np.r_[x : x + part.order, y : y + ny]
            found.append((part, slice(at, at + part.size), np.ix_(rows, columns)))
            at, x, y, u = at + part.size, x + part.order, y + ny, u + nu
        return found

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        K = np.zeros((self.order + _total(self.outputs), self.order + _total(self.inputs)))
        for part, piece, place in self._pieces():
            K[place] = part.gain_matrix(x[piece])
        return K

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        return np.concatenate([part.pullback(x[piece], G[place]) for part, piece, place in self._pieces()])

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return np.concatenate([part.start(rng) for part in self.parts])


def _total(ports: Sequence[Any]) -> int:
    return sum(p.size if isinstance(p, Port) else int(p[1]) for p in ports)
