"""Balanced truncation with a bound of its error: with weights where they matter, and of coprime factors.

The states of poles that are not stable stay as they are. Sources: Enns, CDC 1984 (weights); Liu and Anderson, Int. J.
Control 50 (1989) (equal gain at zero frequency); Wang, Sreeram and Liu, IEEE TAC 44 (1999) (weights on both sides).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import hinf_norm
from lftkit.analysis.riccati import right_coprime_factors
from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.reduction.balancing import Balancing, balancing, gramian_factor, state_parts
from lftkit.support.scalars import as_integer
from lftkit.systems.arguments import checked
from lftkit.systems.connection.feedback import cascade
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampled.image import continuous
from lftkit.systems.system import System

METHODS = ("truncate", "matchdc")


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """A system of lower order, and what it loses.

    Attributes
    ----------
    system : System
        With the ports of the given one.
    hankel_values : ndarray
        Hankel singular values, falling, of what was balanced: the stable part, with its weights if any; the coprime
        factors for :func:`lftkit.reduction.ncfmr`.
    error_bound : float
        Upper bound of the H-infinity norm of the error, weighted where there are weights: the upper end of the norm of
        the difference, at most `tail_bound` to 1e-6 of it. For coprime factors that of their error.
    tail_bound : float
        Twice the sum of the Hankel singular values left out; infinite with weights, where it bounds nothing.
    """

    system: System
    hankel_values: FloatArray
    error_bound: float
    tail_bound: float


@checked
def hankel_singular_values(system: Any) -> FloatArray:
    """Hankel singular values, falling: how much of each state the inputs reach and the outputs see (hsvd in MATLAB).

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
        Certain, continuous or sampled.

    Returns
    -------
    ndarray, shape (n,)
        Infinite for the poles that are not stable, first.

    Examples
    --------
    A lag ``k / (s + a)`` has the value ``k / (2 a)``:

    >>> from lftkit import transfer
    >>> hankel_singular_values(transfer([6.0], [1.0, 1.0])).round(9).tolist()
    [3.0]
    """
    plant = as_system(system)
    parts = state_parts(*plant.matrices[:3], plant.dt)
    values = balancing(*parts.stable, plant.dt).hankel
    return np.concatenate([np.full(len(parts.other[0]), np.inf), values])


@checked
def balred(
    system: Any,
    order: int | None = None,
    *,
    error: float | None = None,
    method: str = "truncate",
    weight_in: System | None = None,
    weight_out: System | None = None,
) -> ReducedSystem:
    """System of lower order by balanced truncation of its stable part, with a bound of the error.

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
        G: certain, continuous or sampled. Poles that are not stable are kept.
    order : int, optional
        At most this number of states; those that are not reached or not seen are left out, too.
    error : float, optional
        In its place: the least order of which twice the sum of the Hankel singular values left out is at most this.
    method : {"truncate", "matchdc"}
        ``truncate`` keeps the gain at infinite frequency, ``matchdc`` that at zero frequency (of the stable part).
    weight_in, weight_out : System, optional
        Wi and Wo, stable: ``Wo (G - Gr) Wi`` is made small, with :attr:`ReducedSystem.error_bound` as its norm.

    Raises
    ------
    ValueError
        Not one of `order` and `error`, an order below the number of poles that are not stable, weights that are not
        stable or do not fit, `error` with weights.

    Examples
    --------
    A resonance and a fast lag, which is left out:

    >>> from lftkit import s
    >>> found = balred((1 / (s**2 + s + 1) + 0.01 / (0.01 * s + 1)).system("u", "y"), 2)
    >>> found.system.order, bool(found.error_bound <= 1.000001 * found.tail_bound < 0.021)
    (2, True)
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if (order is None) == (error is None):
        raise InputError(f"one of order and error must be given, got {order} and {error}")
    if error is not None and not error >= 0.0:
        raise InputError(f"error must be at least 0, got {error}")
    plant = as_system(system)
    A, B, C, D = plant.matrices
    parts = state_parts(A, B, C, plant.dt)
    weights = _weight(weight_in, "weight_in", plant), _weight(weight_out, "weight_out", plant)
    part = _StablePart(System(*parts.stable, D, plant.inputs, plant.outputs, plant.name, plant.dt), *weights)
    if error is not None and part.weighted:
        raise InputError(f"order must be given where there are weights, got error {error}")
    first = part.balancings[0]
    tails = 2.0 * np.append(np.cumsum(first.hankel[::-1])[::-1], 0.0)  # by the number of states that are kept
    fixed = len(parts.other[0])
    if error is not None:
        kept = int(np.argmax(tails <= error))
    else:
        kept = as_integer(order, "order") - fixed
        if kept < 0:
            raise InputError(f"order must be at least {fixed}, the number of poles that are not stable, got {order}")
    if kept >= part.system.order:
        return ReducedSystem(plant, first.hankel, 0.0, np.inf if part.weighted else 0.0)
    reduced = part.reduced(kept, method)
    tail = np.inf if part.weighted else float(tails[min(kept, first.order)])
    whole = linalg.block_diag(reduced.A, parts.other[0]), np.vstack([reduced.B, parts.other[1]])
    observed = np.hstack([reduced.C, parts.other[2]])
    system = System(*whole, observed, reduced.D, plant.inputs, plant.outputs, plant.name, plant.dt)
    return ReducedSystem(system, first.hankel, error_bound(part.error(reduced), tail), tail)


def error_bound(error: System, tail: float, rounding: float = 1e-6) -> float:
    """Upper end of the norm of an error; where it cannot be told, `tail`, its bound of theory.

    To the latter its relative `rounding` is added, that of a sum of Hankel singular values.
    """
    try:
        norm = hinf_norm(error)
    except ArithmeticError:
        return (1.0 + rounding) * tail
    return (1.0 + rounding) * tail if norm.certificate == "none" else norm.upper


@dataclass(frozen=True, eq=False)
class _StablePart:
    """Stable system that is reduced, and the weights of the error."""

    system: System
    before: System | None
    after: System | None

    @property
    def weighted(self) -> bool:
        return self.before is not None or self.after is not None

    @cached_property
    def balancings(self) -> list[Balancing]:
        """One; with weights that of Enns, and one that leaves every truncated system stable."""
        A, B, C, _ = self.system.matrices
        dt, n = self.system.dt, self.system.order
        if not self.weighted:
            return [balancing(A, B, C, dt)]
        reached, seen = gramian_factor(A, B, dt), gramian_factor(A.T, C.T, dt)
        if self.before is not None:
            driven = cascade(self.before, self.system)
            reached = _square(gramian_factor(driven.A, driven.B, dt)[-n:] if n else reached)
        if self.after is not None:
            observed = cascade(self.system, self.after)
            seen = _square(gramian_factor(observed.A.T, observed.C.T, dt)[:n])
        return [Balancing.of(reached, seen), Balancing.of(_definite(A, reached, dt), _definite(A.T, seen, dt))]

    def reduced(self, order: int, method: str) -> System:
        """The truncated system, of the first balancing that leaves it stable."""
        A, B, C, D = self.system.matrices
        dt = self.system.dt
        for balanced in self.balancings:
            kept = min(order, balanced.order)
            if method == "truncate":
                matrices: Matrices = (*balanced.coordinates(A, B, C, kept), D)
            else:
                matrices = _matched((*balanced.coordinates(A, B, C), D), kept, dt)
            system = System(*matrices, self.system.inputs, self.system.outputs, self.system.name, dt)
            if not len(state_parts(*matrices[:3], dt).other[0]):
                break
        return system

    def error(self, reduced: System) -> System:
        """The difference, with the weights."""
        difference = self.system - reduced
        if self.before is not None:
            difference = difference @ self.before
        return difference if self.after is None else self.after @ difference


def _weight(weight: System | None, name: str, of: System) -> System | None:
    if weight is None:
        return None
    system = as_system(weight)
    there, needed = (system.D.shape[0], of.D.shape[1]) if name == "weight_in" else (system.D.shape[1], of.D.shape[0])
    if there != needed:
        side = "outputs" if name == "weight_in" else "inputs"
        raise InputError(f"{name} must have {needed} {side}, got {there}")
    if len(state_parts(*system.matrices[:3], system.dt).other[0]):
        raise InputError(f"{name} must be stable, got poles {system.poles()}")
    return system


def _matched(full: Matrices, order: int, dt: float) -> Matrices:
    """The first states, with the others at rest at zero frequency."""
    A, B, C, D = full
    k, rest = slice(0, order), slice(order, len(A))
    loop = (np.eye(len(A) - order) if dt else 0.0) - A[rest, rest]
    inner = linalg.solve(loop, np.hstack([A[rest, k], B[rest]]))
    X, U = inner[:, :order], inner[:, order:]
    return A[k, k] + A[k, rest] @ X, B[k] + A[k, rest] @ U, C[:, k] + C[:, rest] @ X, D + C[:, rest] @ U


def _square(factor: FloatArray) -> FloatArray:
    """Square factor with the same product ``L L'``."""
    return np.asarray(linalg.qr(factor.T, mode="r")[0][: len(factor)].T)


def _definite(A: FloatArray, factor: FloatArray, dt: float) -> FloatArray:
    """Factor of a Gramian whose driving term is the positive part and minus the negative part of the given one's."""
    P = factor @ factor.T
    driving = P - A @ P @ A.T if dt else -(A @ P + P @ A.T)
    values, vectors = linalg.eigh(0.5 * (driving + driving.T))
    return gramian_factor(A, vectors * np.sqrt(np.abs(values)), dt)


@checked
def ncfmr(system: Any, order: int) -> ReducedSystem:
    """System of lower order by balanced truncation of its normalised right coprime factors (ncfmr in MATLAB).

    A bound that closed loops understand, also of unstable systems. Source: McFarlane and Glover, Robust Controller
    Design Using Normalized Coprime Factor Plant Descriptions (1990); Meyer, IEEE TAC 35 (1990). Sampled systems go
    through the bilinear map, which keeps gains and the gap metric.

    With ``G = N M^-1`` and ``N~N + M~M = 1`` the stable system ``[N; M]`` is reduced to ``[Nr; Mr]``, which is
    normalised again, and ``Gr = Nr Mr^-1``. The error is at least the gap and the nu-gap between G and Gr. **A
    controller whose margin for G is above the error bound stabilises Gr, too**, and the other way round; the margin is
    ``1 / value`` of :func:`lftkit.synthesis.ncfsyn`.

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
        G: certain, continuous or sampled, stable or not, stabilisable and detectable.
    order : int
        At most this number of states.

    Returns
    -------
    ReducedSystem
        `hankel_values` and `error_bound` are those of the coprime factors.

    Raises
    ------
    ValueError
        A negative order; a mode that is not stable and not reached or not seen.

    Examples
    --------
    A double integrator with a fast lag:

    >>> from lftkit import s
    >>> found = ncfmr((1 / (s**2 * (0.01 * s + 1))).system("u", "y"), 2)
    >>> found.system.order, bool(found.error_bound < 0.02)
    (2, True)
    """
    plant = as_system(system)
    number = as_integer(order, "order")
    if number < 0:
        raise InputError(f"order must be at least 0, got {number}")
    A, B, C, D = continuous(plant).matrices
    factors = right_coprime_factors((A, B, C, D), plant.name)
    balanced_factors = balancing(*factors[:3])
    kept = min(number, balanced_factors.order)
    if kept >= plant.order:
        return ReducedSystem(plant, balanced_factors.hankel, 0.0, 0.0)
    reduced = (*balanced_factors.coordinates(*factors[:3], kept), factors[3])
    ports = plant.inputs, (Port("factors", sum(D.shape)),)
    error = System(*factors, *ports) - System(*reduced, *ports)
    tail = 2.0 * float(balanced_factors.hankel[kept:].sum())
    a, b, c, d = reduced
    drive, feedback, seen = linalg.solve(d[len(C) :].T, b.T).T, c[len(C) :], c[: len(C)]
    matrices = a - drive @ feedback, drive, seen - D @ feedback, D
    if plant.dt:
        matrices = to_discrete(*matrices, plant.dt)
    lower = System(*matrices, plant.inputs, plant.outputs, plant.name, plant.dt)
    return ReducedSystem(lower, balanced_factors.hankel, error_bound(error, tail), tail)
