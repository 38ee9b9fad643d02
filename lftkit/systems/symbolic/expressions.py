"""Arithmetic with s (or z), uncertain elements, numbers and matrices, from which systems are made.

An expression is kept as the matrix of a linear system of equations that is affine in s and in every deviation delta of
an element from its nominal value,

    0 = E xi + B u,  y = C xi + D u,  [[E, B], [C, D]] = S_0 + s S_s + sum_i delta_i S_i + sum_k L_k Delta_k R_k,

so that sums, products and inverses divide by nothing: only :meth:`Expression.system` solves. An element then needs as
many Delta channels as the rank of its S_i; what is left of repetitions and cancelled states is removed by
:func:`lftkit.minimal_realisation`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import constant_matrix
from lftkit.systems.delta import Value, chosen_values
from lftkit.systems.ports import Port, as_ports
from lftkit.systems.symbolic.fractions import Fraction, controllable_form
from lftkit.systems.symbolic.realisation import Affine, rank_factors, realised
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement, Element, element_table

OPERATOR = ""
"""Key of the coefficient of s or z."""


@dataclass(frozen=True, eq=False)
class Expression:
    """A matrix of rational functions of s (or z) and of uncertain elements.

    It has the operators ``+ - * @ / **`` with expressions, numbers, arrays and systems (with a system the result is a
    :class:`lftkit.System`); ``*`` with one factor of one row and column multiplies every entry, otherwise it is the
    product of matrices, as ``@``. Made by :func:`real`, :func:`complex_gain`, :func:`dynamic`, ``lftkit.s``,
    :func:`z` and :func:`matrix`.

    **An expression is a function: a pole that cancels in it is gone.** Connect systems (:func:`lftkit.close`,
    :func:`lftkit.connect`, :func:`lftkit.feedback`) where hidden states matter.

    Examples
    --------
    >>> from lftkit import real, s
    >>> k, c = real("k", 4.0, 2.0, 6.0), real("c", 0.1, percent=50)
    >>> spring = 1 / (s**2 + c * s + k)
    >>> spring.system().occurrences()
    {'c': 1, 'k': 1}
    >>> round(abs(spring.at(k=2.0, c=0.1)(0)), 12)
    0.5
    """

    constant: FloatArray
    coefficients: Mapping[str, FloatArray] = field(default_factory=dict)
    dynamics: tuple[tuple[str, FloatArray, FloatArray], ...] = ()
    elements: tuple[Element, ...] = ()
    inner: int = 0
    dt: float = 0.0
    fraction: Fraction | None = None

    __array_ufunc__ = None

    def __post_init__(self) -> None:
        kept = {name: C for name, C in self.coefficients.items() if np.any(C)}
        object.__setattr__(self, "coefficients", kept)
        used = {*kept, *(name for name, _, _ in self.dynamics)}
        table = element_table(self.elements)
        object.__setattr__(self, "elements", tuple(e for name, e in table.items() if name in used))

    def __repr__(self) -> str:
        names = [e.name for e in self.elements]
        if OPERATOR in self.coefficients:
            names.insert(0, "z" if self.dt else "s")
        return f"Expression({self.shape[0]} x {self.shape[1]} in {', '.join(names) or 'nothing'})"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.constant.shape
        return rows - self.inner, columns - self.inner

    @property
    def is_constant(self) -> bool:
        """Whether the expression is a matrix of numbers."""
        return not (self.inner or self.coefficients or self.dynamics)

    # values

    @checked
    def __call__(self, point: complex, values: Mapping[str, Value] | None = None, **named: Value) -> Any:
        """Value at s or z and at values of the elements (nominal where none is given); a number where it is 1 x 1.

        Examples
        --------
        >>> from lftkit import real, s
        >>> ((real("a", 1.0, 0.0, 3.0) + s) ** 2)(1j, a=2.0)
        (3+4j)
        """
        chosen = chosen_values(self.elements, {**(values or {}), **named}, beyond_range=False)
        S = self.constant + point * self.coefficients.get(OPERATOR, np.zeros_like(self.constant))
        for element in self.elements:
            if element.name in self.coefficients:
                deviation = chosen[element.name]
                if isinstance(element, DynamicElement):
                    deviation = deviation(point) if isinstance(deviation, System) else deviation[0, 0]
                else:
                    deviation = deviation - element.nominal
                S = S + deviation * self.coefficients[element.name]
        for name, L, R in self.dynamics:
            S = S + L @ (chosen[name](point) if isinstance(chosen[name], System) else chosen[name]) @ R
        n = self.inner
        value = S[n:, n:] - S[n:, :n] @ linalg.solve(S[:n, :n], S[:n, n:]) if n else S
        return complex(value[0, 0]) if value.shape == (1, 1) else np.asarray(value, dtype=complex)

    def system(self, inputs: Any = "u", outputs: Any = "y", name: str = "system") -> System:
        """The system with this transfer matrix: fewest states and occurrences that the minimal realisation finds.

        Parameters
        ----------
        inputs, outputs : str, or sequence of Port, (name, size) or str
            One name: a port of all signals. Several names: ports of one signal each.
        name : str

        Raises
        ------
        ValueError
            An expression that is not proper (a derivative of the input), or that has no value at the nominal elements.

        Examples
        --------
        >>> from lftkit import s
        >>> (2 / (s + 3)).system("force", "speed")
        System 'system': order 1, continuous time
          1 input: force (1)
          1 output: speed (1)
        """
        rows, columns = self.shape
        affine = Affine(
            self.constant,
            self.coefficients.get(OPERATOR, np.zeros_like(self.constant)),
            {e.name: self.coefficients[e.name] for e in self.elements if e.name in self.coefficients},
            self.dynamics,
            self.inner,
        )
        ports = ports_for(inputs, columns), ports_for(outputs, rows)
        fraction = self.fraction if self.fraction is not None and self.fraction.is_proper else None
        try:  # numbers alone have no occurrences to save, and the fraction is more accurate than a shifted s
            realisation = realised(
                affine, self.elements, *ports, self.dt, shift=fraction is None or bool(self.elements)
            )
        except ValueError:
            if fraction is None:
                raise
            named = {e.name: scalar(e) for e in self.elements}
            made: Expression = controllable_form(fraction, variable(self.dt), named, matrix)
            return replace(made, fraction=None).system(inputs, outputs, name)
        return realisation.named(name)

    @checked
    def at(self, values: Mapping[str, Value] | None = None, **named: Value) -> System:
        """:meth:`lftkit.System.at` of the system."""
        return self.system().at(values, **named)

    def nominal(self) -> System:
        """The system at the nominal values of its elements."""
        return self.system().nominal()

    def poles(self) -> ComplexArray:
        """Poles of the nominal system, see :meth:`System.poles`."""
        return self.system().poles()

    def sample(self, rng: np.random.Generator, count: int = 1) -> list[System]:
        """The system at `count` random values of its elements."""
        return self.system().sample(rng, count)

    # arithmetic

    def __add__(self, other: Any) -> Any:
        return _combined(self, other, operator.add, _plus)

    def __radd__(self, other: Any) -> Any:
        return _combined(other, self, operator.add, _plus)

    def __sub__(self, other: Any) -> Any:
        return _combined(self, other, operator.sub, lambda a, b: _plus(a, -b))

    def __rsub__(self, other: Any) -> Any:
        return _combined(other, self, operator.sub, lambda a, b: _plus(a, -b))

    def __neg__(self) -> Expression:
        negative = _multiplied(self, -np.eye(self.shape[0]), np.eye(self.shape[1]))
        return _with_fraction(negative, self, constant(-np.eye(1)), Fraction.times)

    def __mul__(self, other: Any) -> Any:
        return _combined(self, other, operator.mul, _times)

    def __rmul__(self, other: Any) -> Any:
        return _combined(other, self, operator.mul, _times)

    def __matmul__(self, other: Any) -> Any:
        return _combined(self, other, operator.matmul, _times_matrix)

    def __rmatmul__(self, other: Any) -> Any:
        return _combined(other, self, operator.matmul, _times_matrix)

    def __truediv__(self, other: Any) -> Any:
        return _combined(self, other, operator.truediv, lambda a, b: _times(a, b.inverse()))

    def __rtruediv__(self, other: Any) -> Any:
        return _combined(other, self, operator.truediv, lambda a, b: _times(a, b.inverse()))

    def __pow__(self, exponent: int) -> Expression:
        if not isinstance(exponent, int | np.integer):
            raise InputError(f"exponent must be an integer, got {exponent!r}")
        if exponent == 0:
            return constant(np.eye(self.shape[0]), self.dt)
        base = self if exponent > 0 else self.inverse()
        result = base
        for _ in range(abs(int(exponent)) - 1):
            result = _times_matrix(base, result)
        return result

    def inverse(self) -> Expression:
        """Inverse of a square expression.

        Raises
        ------
        ValueError
            Unequal numbers of rows and columns.
        """
        rows, columns = self.shape
        if rows != columns:
            raise InputError(f"inverse must be of a square expression, got {rows} x {columns}")
        n, eye = self.inner, np.eye(rows)
        corner = np.vstack([np.zeros((n, rows)), -eye])
        below = np.hstack([np.zeros((rows, n)), eye])
        place = np.arange(n + rows)
        whole = _placed([(self, place, place)], (n + 2 * rows, n + 2 * rows), n + rows, self.dt)
        S = whole.constant.copy()
        S[: n + rows, n + rows :], S[n + rows :, : n + rows] = corner, below
        return replace(whole, constant=S, fraction=self.fraction and self.fraction.inverse())

    @property
    def T(self) -> Expression:
        """Transpose; a matrix of dynamics, whose transpose is another element, is refused."""
        if self.dynamics:
            raise InputError(f"transpose must be of an expression without matrices of dynamics, got {self!r}")
        turned = {name: C.T.copy() for name, C in self.coefficients.items()}
        return replace(self, constant=self.constant.T.copy(), coefficients=turned)

    def __getitem__(self, key: Any) -> Expression:
        """Entries ``e[rows, columns]`` by index, slice or list."""
        if not isinstance(key, tuple) or len(key) != 2:
            raise InputError(f"index must be [row, column], got {key!r}")
        chosen = [np.atleast_1d(np.arange(size)[k]) for size, k in zip(self.shape, key)]
        left, right = (np.eye(size)[picked] for size, picked in zip(self.shape, chosen))
        return _multiplied(self, left, right.T)


def _combined(
    first: Any,
    second: Any,
    with_system: Callable[[Any, Any], Any],
    rule: Callable[[Expression, Expression], Expression],
) -> Any:
    """Result of an operator: a system where an operand is one."""
    if isinstance(first, System):
        return with_system(first, second.system())
    if isinstance(second, System):
        return with_system(first.system(), second)
    operands = [as_expression(x) for x in (first, second)]
    if any(x is None for x in operands):
        return NotImplemented
    a, b = (x for x in operands if x is not None)
    return rule(a, b)


def _with_fraction(
    result: Expression,
    a: Expression,
    b: Expression,
    rule: Callable[[Fraction, Fraction], Fraction | None],
) -> Expression:
    """The result of an operation with the fraction that those of its operands make."""
    known = a.fraction is not None and b.fraction is not None and result.shape == (1, 1)
    return replace(result, fraction=rule(a.fraction, b.fraction) if known else None)  # type: ignore[arg-type]


def _plus(a: Expression, b: Expression) -> Expression:
    return _with_fraction(_sum(a, b), a, b, Fraction.plus)


def _times(a: Expression, b: Expression) -> Expression:
    return _with_fraction(_product(a, b), a, b, Fraction.times)


def _times_matrix(a: Expression, b: Expression) -> Expression:
    return _with_fraction(_series(a, b), a, b, Fraction.times)


def as_expression(value: Any) -> Expression | None:
    """A number, a matrix (nested lists or an array, also of expressions) or an expression; None: anything else."""
    if isinstance(value, Expression):
        return value
    gain = constant_matrix(value)
    if gain is not None:
        return constant(gain)
    if isinstance(value, np.ndarray | list | tuple) and np.ndim(np.asarray(value, dtype=object)) == 2:
        return matrix(value)
    return None


def constant(gain: FloatArray, dt: float = 0.0) -> Expression:
    """A matrix of numbers."""
    value = np.asarray(gain, dtype=float)
    if not np.all(np.isfinite(value)):
        raise InputError(f"numbers of an expression must be finite, got {gain}")
    return Expression(value, dt=dt, fraction=Fraction.of(value.item()) if value.shape == (1, 1) else None)


def variable(dt: float = 0.0) -> Expression:
    """The variable s, or z of a sampling period [s]."""
    return Expression(np.zeros((1, 1)), {OPERATOR: np.eye(1)}, dt=dt, fraction=Fraction.of(1.0, 1))


def scalar(element: Element) -> Expression:
    """An element of one row and column; that of dynamics has no fraction, as its output has no derivative."""
    fixed = not isinstance(element, DynamicElement)
    nominal = float(element.nominal) if not isinstance(element, DynamicElement) else 0.0
    fraction = Fraction.of(1.0, names=(element.name,)) if fixed else None
    return Expression(np.array([[nominal]]), {element.name: np.eye(1)}, (), (element,), fraction=fraction)


def _period(parts: Sequence[Expression]) -> float:
    periods = {e.dt for e in parts if OPERATOR in e.coefficients or e.dt}
    if len(periods) > 1:
        raise InputError(f"expressions must have the same sampling period, got {', '.join(map(str, sorted(periods)))}")
    return periods.pop() if periods else 0.0


def _placed(parts: Sequence[tuple[Expression, Any, Any]], shape: tuple[int, int], inner: int, dt: float) -> Expression:
    """Sum of the matrices of the parts, each at the given rows and columns of a larger one."""

    def put(M: FloatArray, rows: Any, columns: Any) -> FloatArray:
        whole = np.zeros(shape)
        whole[np.ix_(rows, columns)] = M
        return whole

    constant = sum((put(e.constant, r, c) for e, r, c in parts), np.zeros(shape))
    coefficients: dict[str, FloatArray] = {}
    dynamics = []
    for e, rows, columns in parts:
        for name, C in e.coefficients.items():
            coefficients[name] = coefficients.get(name, np.zeros(shape)) + put(C, rows, columns)
        for name, L, R in e.dynamics:
            left, right = np.zeros((shape[0], L.shape[1])), np.zeros((R.shape[0], shape[1]))
            left[rows], right[:, columns] = L, R
            dynamics.append((name, left, right))
    elements = tuple(x for e, _, _ in parts for x in e.elements)
    return Expression(constant, coefficients, tuple(dynamics), elements, inner, dt)


def _sum(a: Expression, b: Expression) -> Expression:
    if a.shape != b.shape:
        for one, other in ((a, b), (b, a)):
            if one.shape == (1, 1):  # as for systems: added to every entry
                return _sum(_multiplied(one, np.ones((other.shape[0], 1)), np.ones((1, other.shape[1]))), other)
        raise InputError(f"sum must be of expressions of the same size, got {_size(a)} and {_size(b)}")
    (p, m), n = a.shape, a.inner + b.inner
    y, u = n + np.arange(p), n + np.arange(m)
    first, second = np.arange(a.inner), a.inner + np.arange(b.inner)
    parts = [(e, np.r_[states, y], np.r_[states, u]) for e, states in ((a, first), (b, second))]
    return _placed(parts, (n + p, n + m), n, _period([a, b]))


def _series(a: Expression, b: Expression) -> Expression:
    """Product of matrices."""
    if a.shape[1] != b.shape[0]:
        raise InputError(f"product must be of matrices that fit, got {_size(a)} and {_size(b)}")
    if a.is_constant:
        return replace(_multiplied(b, a.constant, np.eye(b.shape[1])), dt=_period([a, b]))
    if b.is_constant:
        return replace(_multiplied(a, np.eye(a.shape[0]), b.constant), dt=_period([a, b]))
    if a.shape == b.shape == (1, 1) and OPERATOR in a.coefficients and OPERATOR not in b.coefficients:
        a, b = b, a  # functions commute, but of s times an element a derivative of the element's output would be made
    p, k, m = a.shape[0], a.shape[1], b.shape[1]
    both = a.inner + b.inner
    n = both + k
    first, second, middle = np.arange(a.inner), a.inner + np.arange(b.inner), both + np.arange(k)
    y, u = n + np.arange(p), n + np.arange(m)
    parts = [(a, np.r_[first, y], np.r_[first, middle]), (b, np.r_[second, middle], np.r_[second, u])]
    whole = _placed(parts, (n + p, n + m), n, _period([a, b]))
    S = whole.constant.copy()
    S[middle, middle] -= 1.0
    return replace(whole, constant=S)


def _product(a: Expression, b: Expression) -> Expression:
    """Product of matrices; a factor of one row and column multiplies every entry."""
    for scalar, other, first in ((a, b, True), (b, a, False)):
        if scalar.shape != (1, 1) or other.shape == (1, 1):
            continue
        if other.is_constant:
            # K = L R of rank r: L (scalar I_r) R has the fewest copies
            L, R = rank_factors(other.constant)
            if scalar.inner == 0 and not scalar.dynamics:
                L, R = other.constant, np.eye(other.shape[1])
                spread = {name: C[0, 0] * L for name, C in scalar.coefficients.items()}
                whole = Expression(scalar.constant[0, 0] * L, spread, (), scalar.elements, 0)
            else:
                whole = _series(_series(constant(L), _copies(scalar, L.shape[1])), constant(R))
            return replace(whole, dt=_period([a, b]))
        size = other.shape[0] if first else other.shape[1]
        return _series(_copies(scalar, size), other) if first else _series(other, _copies(scalar, size))
    return _series(a, b)


def _copies(scalar: Expression, count: int) -> Expression:
    """The expression of one row and column on the diagonal, `count` times."""
    n = scalar.inner
    total = n * count
    parts = [
        (scalar, np.r_[i * n + np.arange(n), total + i], np.r_[i * n + np.arange(n), total + i]) for i in range(count)
    ]
    return _placed(parts, (total + count, total + count), total, scalar.dt)


def _multiplied(e: Expression, left: FloatArray, right: FloatArray) -> Expression:
    """Constant matrices on both sides."""
    L, R = (np.asarray(linalg.block_diag(np.eye(e.inner), M)) for M in (left, right))
    return replace(
        e,
        constant=L @ e.constant @ R,
        coefficients={name: L @ C @ R for name, C in e.coefficients.items()},
        dynamics=tuple((name, L @ inner, other @ R) for name, inner, other in e.dynamics),
    )


def _size(e: Expression) -> str:
    return f"{e.shape[0]} x {e.shape[1]}"


def ports_for(names: Any, size: int) -> tuple[Port, ...]:
    """Ports of `size` signals in all from one name, or from names, pairs and ports."""
    if isinstance(names, str):
        return (Port(names, size),)
    sized = [(p, 1) if isinstance(p, str) else p for p in names] if isinstance(names, Iterable) else names
    ports = as_ports(sized, "ports")
    if sum(p.size for p in ports) != size:
        raise InputError(f"ports must have {size} signals, got {', '.join(f'{p.name}[{p.size}]' for p in ports)}")
    return ports


@checked
def matrix(rows: Any) -> Expression:
    """Expression from rows of expressions, numbers and matrices that fit.

    Raises
    ------
    ValueError
        Entries that are no expressions, or whose sizes do not fit.

    Examples
    --------
    >>> from lftkit import matrix, real
    >>> k = real("k", 2.0, 1.0, 3.0)
    >>> matrix([[k, -k], [-k, k]]).system().occurrences()
    {'k': 1}
    """
    try:
        entries = [[as_expression(e) for e in row] for row in rows]
    except TypeError:
        entries = []
    if not entries or not entries[0] or any(e is None for row in entries for e in row):
        raise InputError(f"matrix must have rows of expressions and numbers, got {rows!r}")
    known = [[e for e in row if e is not None] for row in entries]
    heights, widths = [row[0].shape[0] for row in known], [e.shape[1] for e in known[0]]
    if any([e.shape[1] for e in row] != widths or {e.shape[0] for e in row} != {h} for row, h in zip(known, heights)):
        sizes = "; ".join(", ".join(_size(e) for e in row) for row in known)
        raise InputError(f"entries of a matrix must fit in rows and columns, got {sizes}")
    flat = [e for row in known for e in row]
    n = sum(e.inner for e in flat)
    parts, start = [], 0
    for i, row in enumerate(known):
        for j, e in enumerate(row):
            states = start + np.arange(e.inner)
            y, u = n + sum(heights[:i]) + np.arange(heights[i]), n + sum(widths[:j]) + np.arange(widths[j])
            parts.append((e, np.r_[states, y], np.r_[states, u]))
            start += e.inner
    return _placed(parts, (n + sum(heights), n + sum(widths)), n, _period(flat))
