"""Operators of systems, by position of the signals, and what they and connections ask of their operands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import is_number
from lftkit.systems import lft
from lftkit.systems.ports import Port, total_size
from lftkit.uncertainty.elements import Element

S = TypeVar("S", bound="Arithmetic")


def common_period(systems: Iterable[Arithmetic]) -> float:
    """Sampling period [s] of systems that are combined; gains without states fit every period.

    Raises
    ------
    ValueError
        Different periods, or continuous and discrete time.
    """
    periods = sorted({s.dt for s in systems if s.order or s.dt})
    if len(periods) > 1 and not (periods[0] and periods[-1] - periods[0] <= 1e-12 * periods[-1]):
        shown = ", ".join(f"{dt:g} s" if dt else "continuous time" for dt in periods)
        raise InputError(f"systems must have the same sampling period, got {shown}")
    return periods[0] if periods else 0.0


def same_size(first: Sequence[Port], second: Sequence[Port], where: str) -> None:
    """Raise a ValueError with the ports and sizes of both sides where their signals differ in number."""
    if total_size(first) != total_size(second):
        sides = (", ".join(f"{p.name}[{p.size}]" for p in side) or "none" for side in (first, second))
        raise InputError(f"{where} must have the same number of signals, got {' and '.join(sides)}")


def constant_matrix(value: Any) -> FloatArray | None:
    """A number or a matrix of numbers as an array (p, m); None for anything else."""
    if is_number(value):
        return np.array([[float(value)]])
    if isinstance(value, np.ndarray | list | tuple):
        array = np.asarray(value)
        if array.dtype.kind in "biuf" and array.ndim == 2:
            return array.astype(float)
    return None


class Arithmetic:
    """The operators ``+ - * @ / **`` and the inverse of :class:`lftkit.System`, which is the one class with them.

    Signals go by position; sums keep the ports of the first system, products the inputs of the last factor and the
    outputs of the first. Elements of both operands stay, of the same name as the same element.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    name: str
    dt: float
    channels: tuple[str, ...]
    elements: tuple[Element, ...]

    __array_ufunc__ = None  # an array beside an operator is a gain, not a list of systems

    @property
    def lft(self) -> Matrices:
        """(A, B, C, D) of M, with the Delta channels first."""
        raise NotImplementedError

    @property
    def order(self) -> int:
        """Number of states."""
        raise NotImplementedError

    def with_lft(self: S, matrices: Matrices, **changes: Any) -> S:
        """The same system with other matrices of M and other fields."""
        raise NotImplementedError

    def _operand(self: S, other: Any) -> S | None:
        """The other operand as a system; a number is a gain of one input and one output."""
        if isinstance(other, type(self)):
            return other
        gain = constant_matrix(other)
        return None if gain is None else self._static(gain, Port("in", gain.shape[1]), Port("out", gain.shape[0]))

    def _static(self: S, gain: FloatArray, into: Port, out: Port) -> S:
        none = np.zeros((0, 0)), np.zeros((0, into.size)), np.zeros((out.size, 0)), gain
        return self.with_lft(none, inputs=(into,), outputs=(out,), dt=0.0, channels=(), elements=())

    def _sum(self: S, other: Any, signs: tuple[float, float]) -> S:
        second = self._operand(other)
        if second is None:
            return NotImplemented  # type: ignore[no-any-return]
        p, m = total_size(self.outputs), total_size(self.inputs)
        if is_number(other):  # as in MATLAB and python-control: to every entry
            second = self._static(float(other) * np.ones((p, m)), Port("in", m), Port("out", p))
        same_size(self.inputs, second.inputs, "sum: inputs")
        same_size(self.outputs, second.outputs, "sum: outputs")
        left = np.hstack([signs[0] * np.eye(p), signs[1] * np.eye(p)])
        M = lft.side_by_side([self.lft, second.lft], [len(self.channels), len(second.channels)])
        q = len(self.channels) + len(second.channels)
        return self._made([self, second], lft.mapped(M, q, left, np.vstack([np.eye(m)] * 2)), self, self)

    def _made(self: S, parts: Sequence[S], matrices: Matrices, first: S, last: S) -> S:
        return self.with_lft(
            matrices,
            inputs=first.inputs,
            outputs=last.outputs,
            dt=common_period(parts),
            channels=tuple(c for part in parts for c in part.channels),
            elements=tuple(e for part in parts for e in part.elements),
        )

    def __add__(self: S, other: Any) -> S:
        """Sum; a number is added to every entry of the transfer matrix."""
        return self._sum(other, (1.0, 1.0))

    __radd__ = __add__

    def __sub__(self: S, other: Any) -> S:
        return self._sum(other, (1.0, -1.0))

    def __rsub__(self: S, other: Any) -> S:
        return self._sum(other, (-1.0, 1.0))

    def __neg__(self: S) -> S:
        return self._scaled(-1.0)

    def _scaled(self: S, factor: float) -> S:
        q = len(self.channels)
        left, right = factor * np.eye(total_size(self.outputs)), np.eye(total_size(self.inputs))
        return self.with_lft(lft.mapped(self.lft, q, left, right))

    def __matmul__(self: S, other: Any) -> S:
        """Series: ``(G @ H)(s) = G(s) H(s)``, H first; inputs of H, outputs of G."""
        first = self._operand(other)
        return NotImplemented if first is None else self._after(first)

    def __rmatmul__(self: S, other: Any) -> S:
        second = self._operand(other)
        return NotImplemented if second is None else second._after(self)

    def _after(self: S, first: S) -> S:
        same_size(first.outputs, self.inputs, "series: outputs of the first and inputs of the second system")
        q = len(first.channels) + len(self.channels)
        M = lft.side_by_side([first.lft, self.lft], [len(first.channels), len(self.channels)])
        m, k, p = total_size(first.inputs), total_size(self.inputs), total_size(self.outputs)
        S = np.zeros((m + k, k + p))
        S[m:, :k] = np.eye(k)
        E, So = np.vstack([np.eye(m), np.zeros((k, m))]), np.hstack([np.zeros((p, k)), np.eye(p)])
        return self._made([first, self], lft.close_loop(M, q, S, E, So, np.zeros((p, m))), first, self)

    def __mul__(self: S, other: Any) -> S:
        """As ``@``; a number, or a system of one input and one output, multiplies every entry."""
        if is_number(other):
            return self._scaled(float(other))
        second = self._operand(other)
        return NotImplemented if second is None else _product(self, second)

    def __rmul__(self: S, other: Any) -> S:
        if is_number(other):
            return self._scaled(float(other))
        first = self._operand(other)
        return NotImplemented if first is None else _product(first, self)

    def inverse(self: S) -> S:
        """The system from outputs to inputs; D must be invertible.

        Raises
        ------
        ValueError
            Unequal numbers of inputs and outputs, or a direct feedthrough that is singular.
        """
        same_size(self.inputs, self.outputs, "inverse: inputs and outputs")
        q = len(self.channels)
        ports = q + np.arange(total_size(self.inputs))
        M = lft.exchanged(self.lft, ports, ports, f"{self.name}: direct feedthrough must be invertible")
        return self.with_lft(M, inputs=self.outputs, outputs=self.inputs)

    def __truediv__(self: S, other: Any) -> S:
        if is_number(other):
            return self._scaled(1.0 / float(other))
        divisor = self._operand(other)
        return NotImplemented if divisor is None else self * divisor.inverse()

    def __rtruediv__(self: S, other: Any) -> S:
        return NotImplemented if self._operand(other) is None else self.inverse().__rmul__(other)

    def __pow__(self: S, exponent: int) -> S:
        if not isinstance(exponent, int | np.integer) or exponent == 0:
            raise InputError(f"exponent must be an integer other than 0, got {exponent!r}")
        base = self if exponent > 0 else self.inverse()
        result = base
        for _ in range(abs(int(exponent)) - 1):
            result = result @ base
        return result


def _product(left: S, right: S) -> S:
    """Product in which an operand of one input and one output multiplies every entry of the other."""
    one, other = ((total_size(s.inputs), total_size(s.outputs)) == (1, 1) for s in (left, right))
    if one and not other:
        return _repeated(left, right.outputs)._after(right)
    if other and not one:
        return left._after(_repeated(right, left.inputs))
    return left._after(right)


def _repeated(scalar: S, ports: tuple[Port, ...]) -> S:
    """The system of one input and one output on every signal of the ports."""
    count, q = total_size(ports), len(scalar.channels)
    M = lft.side_by_side([scalar.lft] * count, [q] * count)
    return scalar.with_lft(M, inputs=ports, outputs=ports, channels=scalar.channels * count)
