"""Delays as rational systems."""

from __future__ import annotations

from math import factorial

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, is_number
from lftkit.support.state_units import in_balanced_units
from lftkit.systems.arguments import checked
from lftkit.systems.ports import Port
from lftkit.systems.system import System, state_space, static_gain


def pade_matrices(delay: float, order: int, size: int = 1) -> Matrices:
    """State space of the Padé form of ``exp(-s delay)`` on `size` signals; all-pass, so it loses phase and no gain.

    The realisation is the balanced one, with coefficients of order 1 / delay, so that it does not spoil the
    conditioning of a model it is connected to.

    Parameters
    ----------
    delay : float
        s; 0 or an order below 1: no delay, no states.
    order : int
    size : int

    Raises
    ------
    ValueError
        A delay that is negative or not finite.

    Examples
    --------
    >>> A, B, C, D = pade_matrices(0.1, 3)
    >>> response = C @ np.linalg.solve(2j * np.eye(3) - A, B) + D
    >>> round(float(abs(response.item() - np.exp(-0.2j))), 9)
    0.0
    """
    if not (is_number(delay) and 0 <= delay < np.inf):
        raise InputError(f"delay must be zero or positive, got {delay!r} s")
    order = as_integer(order, "order")
    if as_integer(size, "size") < 0:
        raise InputError(f"size must be at least 0, got {size}")
    each: FloatArray = np.eye(size)
    if order < 1 or delay == 0.0:
        return np.zeros((0, 0)), np.zeros((0, size)), np.zeros((size, 0)), each
    k = np.arange(order + 1)
    weight = [
        factorial(2 * order - i) * factorial(order) / (factorial(2 * order) * factorial(i) * factorial(order - i))
        for i in k
    ]
    # monic, in units of the delay, so that the coefficients stay near one; lowest power first
    den = np.array(weight) / weight[-1]
    num = den * (-1.0) ** k
    through = num[-1]
    companion = np.diag(np.ones(order - 1), 1)
    companion[-1] = -den[:-1]
    A, units = in_balanced_units(companion)
    B, C = np.eye(order)[:, -1:] / units[:, None], (num - through * den)[None, :-1] * units
    level = np.sqrt(linalg.norm(C) / linalg.norm(B))
    return (
        np.asarray(np.kron(each, A) / delay, dtype=float),
        np.kron(each, B * level) / delay,
        np.kron(each, C / level),
        np.asarray(each * through, dtype=float),
    )


@checked
def pade_delay(delay: float, order: int, size: int = 1) -> System:
    """Padé form of ``exp(-s delay)`` on `size` signals, from port ``in`` to port ``out``: :func:`pade_matrices`."""
    return System(*pade_matrices(delay, order, size), (Port("in", size),), (Port("out", size),), f"delay {delay} s")


def delayed_port(port: Port, delay: float, order: int) -> System:
    """Padé form of a delay [s] on every signal of a port; input and output have its name."""
    A, B, C, D = pade_matrices(delay, order, port.size)
    if not len(A):
        return static_gain(D, [port], [port])
    return state_space(A, B, C, D, [port], [port])


def delay_radius(delay: float, order: int) -> float:
    """Circle [rad/s] outside which poles of a loop are taken for those of the Padé approximation."""
    return 0.7 * float(np.abs(linalg.eigvals(pade_matrices(delay, order)[0])).min())
