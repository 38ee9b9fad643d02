"""Systems from matrices that are affine in s (or z) and in uncertain elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray, Matrices
from lftkit.systems import lft
from lftkit.systems.minimal import minimal_realisation
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.uncertainty.elements import Element, RealParameter, width


@dataclass(frozen=True)
class Affine:
    """``[[E, B], [C, D]] = S_0 + s S_s + sum delta_i S_i + sum L_k Delta_k R_k`` with `inner` rows and columns of E.

    Parameters
    ----------
    constant, operator : ndarray
        S_0 and S_s.
    coefficients : mapping
        S_i of each scalar element.
    dynamics : tuple of (name, L, R)
        Occurrences of matrices of dynamics.
    inner : int
    """

    constant: FloatArray
    operator: FloatArray
    coefficients: Mapping[str, FloatArray]
    dynamics: tuple[tuple[str, FloatArray, FloatArray], ...]
    inner: int


def rank_factors(M: FloatArray) -> tuple[FloatArray, FloatArray]:
    """L (p, r) and R (r, m) with ``M = L R`` and the fewest columns, by elimination with complete pivoting.

    Matrices of simple numbers have simple factors.
    """
    rest = np.array(M, dtype=float)
    size = np.abs(rest).max(initial=0.0)
    left, right = [], []
    while rest.size and np.abs(rest).max() > 1e-13 * size:  # below it is rounding
        i, j = np.unravel_index(np.argmax(np.abs(rest)), rest.shape)
        column, row = rest[:, j] / rest[i, j], rest[i].copy()
        left.append(column)
        right.append(row)
        rest = rest - np.outer(column, row)
        rest[i], rest[:, j] = 0.0, 0.0
    L = np.array(left).reshape(-1, M.shape[0]).T
    return L, np.array(right).reshape(-1, M.shape[1])


def realised(
    e: Affine,
    elements: Sequence[Element],
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    dt: float,
    *,
    shift: bool = True,
) -> System:
    """The system of ``y = (D - C E^-1 B) u``.

    Raises
    ------
    ValueError
        It is not proper, or has no value at the nominal elements; without `shift` also where s occurs more often than
        there are states.
    """
    # The coefficients of s and of the elements in factors of least rank, and the element of each row of Delta
    e = _eliminated(e)
    rows, columns = e.constant.shape
    left: list[FloatArray] = [np.zeros((rows, 0))]
    right: list[FloatArray] = [np.zeros((0, columns))]
    names: list[str] = []
    for element in elements:
        pairs = [rank_factors(e.coefficients[element.name])] if element.name in e.coefficients else []
        for _, L, R in (d for d in e.dynamics if d[0] == element.name):
            d = width(element)
            pairs.append((np.pad(L, ((0, 0), (0, d - L.shape[1]))), np.pad(R, ((0, d - R.shape[0]), (0, 0)))))
        for L, R in pairs:
            left.append(L)
            right.append(R)
            names += [element.name] * L.shape[1]
    factored, channels = (e, *rank_factors(e.operator), np.hstack(left), np.vstack(right)), tuple(names)
    try:
        made = System(*_direct(factored), inputs, outputs, dt=dt, channels=channels, elements=tuple(elements))
    except ValueError:
        if not shift:
            raise
        made = _shifted(factored, channels, elements, inputs, outputs, dt)
    return minimal_realisation(made).system


def _eliminated(e: Affine) -> Affine:
    """The same without the variables of xi that an equation of constants gives, or that enter with constants only."""
    n = e.inner
    stack = np.array([e.constant, e.operator, *e.coefficients.values()])
    lefts, rights = [L for _, L, _ in e.dynamics], [R for _, _, R in e.dynamics]
    while n:
        moving = np.any(stack[1:] != 0, axis=0)
        busy_rows = np.any(moving, axis=1) | np.any([np.any(L != 0, axis=1) for L in lefts], axis=0)
        busy_columns = np.any(moving, axis=0) | np.any([np.any(R != 0, axis=0) for R in rights], axis=0)
        free = np.abs(stack[0, :n, :n]) * (~busy_rows[:n, None] | ~busy_columns[None, :n])
        # the largest entry of its row: what is substituted does not grow
        free = free * (free >= np.abs(stack[0, :n]).max(axis=1, keepdims=True))
        i, j = np.unravel_index(np.argmax(free), free.shape)
        if free[i, j] == 0.0:
            break
        if not busy_rows[i]:
            row = stack[0, i] / stack[0, i, j]
            stack = stack - stack[:, :, [j]] * row
            rights = [R - R[:, [j]] * row for R in rights]
        else:
            factor = stack[0, :, j] / stack[0, i, j]
            stack = stack - factor[None, :, None] * stack[:, [i], :]
            lefts = [L - factor[:, None] * L[[i]] for L in lefts]
        stack = np.delete(np.delete(stack, i, axis=1), j, axis=2)
        lefts, rights = [np.delete(L, i, axis=0) for L in lefts], [np.delete(R, j, axis=1) for R in rights]
        n -= 1
    dynamics = tuple((name, L, R) for (name, _, _), L, R in zip(e.dynamics, lefts, rights))
    return Affine(stack[0], stack[1], dict(zip(e.coefficients, stack[2:])), dynamics, n)


Factored = tuple[Affine, FloatArray, FloatArray, FloatArray, FloatArray]
"""``S_0 + s L_s R_s + L Delta R`` as S, L_s, R_s, L and R."""


def _direct(f: Factored) -> Matrices:
    """States ``x = R_s [xi; u]``: solved for xi and x' as functions of x, the Delta channels and u."""
    e, Ls, Rs, L, R = f
    n, r, q = e.inner, Ls.shape[1], L.shape[1]
    m = e.constant.shape[1] - n
    E, B, C, D = e.constant[:n, :n], e.constant[:n, n:], e.constant[n:, :n], e.constant[n:, n:]
    T = np.block([[E, Ls[:n]], [Rs[:, :n], np.zeros((r, r))]])
    right = np.block([[np.zeros((n, r)), -L[:n], -B], [np.eye(r), np.zeros((r, q)), -Rs[:, n:]]])
    X = lft.solve_loop(T, right, "expression must be proper")
    xi, rate = X[:n], X[n:]
    through = np.hstack([np.zeros((m, r + q)), np.eye(m)])  # u
    delta = np.hstack([np.zeros((q, r)), np.eye(q), np.zeros((q, m))])
    out = np.vstack([R[:, :n] @ xi + R[:, n:] @ through, C @ xi + D @ through + Ls[n:] @ rate + L[n:] @ delta])
    rate, out = rate + 0.0, out + 0.0  # no negative zeros
    return rate[:, :r], rate[:, r:], out[:, :r], out[:, r:]


def _shifted(
    f: Factored,
    channels: tuple[str, ...],
    elements: Sequence[Element],
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    dt: float,
) -> System:
    """By ``sigma = s - s_0`` as one more repeated element, whose superfluous repetitions are removed first.

    Where s occurs more often than there are states, the equations of :func:`_direct` are singular.
    """
    e, Ls, Rs, L, R = f
    n, r, q = e.inner, Ls.shape[1], L.shape[1]
    sizes = [np.abs(M).max(initial=0.0) for M in (e.constant, e.operator)]
    shift = 0.7390851332151607 * (sizes[0] / sizes[1] if sizes[0] and sizes[1] else 1.0)  # at no special place
    S = e.constant + shift * e.operator
    E, B, C, D = S[:n, :n], S[:n, n:], S[n:, :n], S[n:, n:]
    left, right = np.hstack([Ls, L]), np.vstack([Rs, R])
    xi = lft.solve_loop(E, -np.hstack([left[:n], B]), "expression must have a value at the nominal elements")
    k = r + q
    M = np.vstack([right[:, :n] @ xi, C @ xi])
    M[:k, k:] += right[:, n:]
    M[k:, :k] += left[n:]
    M[k:, k:] += D
    none = np.zeros((0, 0))
    sigma = RealParameter("\0s", 0.0, -1.0, 1.0)
    names = (*[sigma.name] * r, *channels)
    whole = System(none, none, none, M, inputs, outputs, channels=names, elements=(sigma, *elements))
    small = minimal_realisation(whole).system
    r = small.occurrences().get(sigma.name, 0)
    M11, M12, M21, M22 = small.D[:r, :r], small.D[:r, r:], small.D[r:, :r], small.D[r:, r:]
    proper = "expression must be proper: no derivative of its input" + ", nor of an element's output" * bool(elements)
    advice = "; form each fraction before a matrix, or a product with dynamics, is made of them" * bool(elements)
    inverse = lft.solve_loop(M11, np.hstack([np.eye(r), M12]), proper + advice)
    A, B = shift * np.eye(r) + inverse[:, :r], -inverse[:, r:]
    return System(
        A,
        B,
        M21 @ inverse[:, :r],
        M22 - M21 @ inverse[:, r:],
        inputs,
        outputs,
        dt=dt,
        channels=small.channels[r:],
        elements=tuple(elements),
    )
