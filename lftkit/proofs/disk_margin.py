"""Worst-case disk margin of an uncertain loop, and the disk margins of several loops at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lftkit.analysis.margins import DiskMargin, as_skew, disk_gains, disk_phase, margin_of_shifted
from lftkit.analysis.margins import sensitivity as closed_sensitivity
from lftkit.arrays import Matrices
from lftkit.errors import InputError
from lftkit.proofs.options import BoundOptions
from lftkit.proofs.robustness import robust_stability, worst_case_gain
from lftkit.proofs.state_space.bounds import ProvenBounds
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.bilinear import to_continuous
from lftkit.systems.system import System
from lftkit.uncertainty.elements import DynamicElement


@dataclass(frozen=True)
class DiskMarginBounds:
    """Bounds of the smallest disk margin of all members.

    Parameters
    ----------
    lower : float
        Proven; zero where nothing was proven or a member is unstable.
    upper : float
        That of the member at `gain_bounds.point`.
    gain_margins : (low, high)
        Gains by which the loop of every member may be multiplied, from `lower`.
    phase_margin : float
        Phase [deg] by which it may be turned, either way, from `lower`.
    gain_bounds : ProvenBounds
        What was proven, with its proof: of the norm of ``S + (skew - 1) / 2``, one over the margin; of several loops
        at once of the margin itself, with dynamics ``d0, d1, ...`` at its point.
    """

    lower: float
    upper: float
    gain_margins: tuple[float, float]
    phase_margin: float
    gain_bounds: ProvenBounds


@checked
def worst_case_disk_margin(
    loop: Any,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    skew: float = 0.0,
    options: BoundOptions | None = None,
) -> DiskMarginBounds:
    """Smallest disk margin of a loop with one signal over a box of its parameters (wcdiskmargin of the toolbox).

    With ``S = 1 / (1 + L)`` the margin is one over the largest gain of ``S + (skew - 1) / 2`` (Seiler, Packard and
    Gahinet, IEEE Control Systems 40 (2020), 78-95). **The loop is closed with negative feedback.**

    Parameters
    ----------
    loop : System or expression
        L, one input and one output; whatever :func:`lftkit.as_system` takes.
    box : mapping of str to (lowest, highest), optional
        Intervals inside the ranges of the parameters.
    skew : float
        0: gain may rise and fall alike; 1: disks about S; -1: about T. Of magnitude 1e6 at most.
    options : BoundOptions, optional
        As for :func:`lftkit.proofs.worst_case_gain`.

    Raises
    ------
    ValueError
        Not one input and one output; a loop that is not well posed; as for :func:`lftkit.proofs.worst_case_gain`.

    Examples
    --------
    An integrator has S - 1/2 of gain 1/2 everywhere, whatever its gain k:

    >>> from lftkit import Port, RealParameter
    >>> k, u, y = RealParameter("k", 2.0, 1.0, 3.0), (Port("u", 1),), (Port("y", 1),)
    >>> D = [[0.0, 1.0], [0.0, 0.0]]
    >>> L = System([[0.0]], [[1.0, 2.0]], [[0.0], [1.0]], D, u, y, channels=("k",), elements=(k,))
    >>> found = worst_case_disk_margin(L)
    >>> round(found.upper, 6), found.upper <= 1.05 * found.lower
    (2.0, True)
    """
    skew = as_skew(skew)
    shifted = sensitivity(as_system(loop), 0.5 * (skew - 1.0))
    bounds = worst_case_gain(shifted, box, options=options)
    lower = 1.0 / bounds.upper if bounds.upper > 0.0 else math.inf
    upper = 1.0 / bounds.lower if bounds.lower > 0.0 else math.inf
    return DiskMarginBounds(lower, upper, disk_gains(lower, skew), disk_phase(lower, skew), bounds)


@dataclass(frozen=True)
class DiskMargins:
    """Disk margins of a loop with several channels.

    Parameters
    ----------
    each : tuple of DiskMargin
        Of every channel with the others closed.
    together : DiskMarginBounds
        Of all channels at once, each with a factor of its own.
    """

    each: tuple[DiskMargin, ...]
    together: DiskMarginBounds


@checked
def disk_margins(
    loop: Any, skew: float = 0.0, *, options: BoundOptions | None = None, most: float = 1e3
) -> DiskMargins:
    """Disk margins of a square loop, of each channel and of all at once (diskmargin of the toolbox).

    Each channel has a factor ``f = (2 + (1 - skew) d) / (2 - (1 + skew) d)`` with ``|d| < margin``. The margin of all
    at once is one over the structured singular value of ``S + (skew - 1) / 2`` for a diagonal d (Seiler, Packard and
    Gahinet, IEEE Control Systems 40 (2020), 78-95), bounded over the whole axis: its lower side is proven.

    Parameters
    ----------
    loop : System, or what :func:`lftkit.as_system` takes
        L of negative feedback, certain: **the loop is closed by** ``u = -y``. A sampled one goes through the bilinear
        map, and the frequencies of `together` are those of the map, ``2 / dt tan(omega dt / 2)``.
    skew : float
        0: gain may rise and fall alike; 1: disks about S; -1: about T. Of magnitude 1e6 at most.
    options : BoundOptions, optional
        Of the margin at once; the gap is 1 % by default.
    most : float
        Largest margin at once that is looked at.

    Raises
    ------
    ValueError
        A loop that is uncertain, not square or not well posed.

    Examples
    --------
    Two equal loops without coupling: together they bear what each of them does.

    >>> from lftkit import append, s
    >>> L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    >>> found = disk_margins(append(L.system("u1", "y1"), L.system("u2", "y2")))
    >>> [round(one.size, 3) for one in found.each], round(found.together.upper, 3), found.together.lower > 0.45
    ([0.458, 0.458], 0.458, True)
    """
    L, skew = as_system(loop), as_skew(skew)
    L.require_certain()
    A, B, C, D = closed_sensitivity(L)
    S: Matrices = A, B, C, D + 0.5 * (skew - 1.0) * np.eye(len(D))
    each = tuple(margin_of_shifted((A, B[:, [i]], C[[i]], S[3][[i]][:, [i]]), L.dt, skew) for i in range(len(D)))
    if min(one.size for one in each) == 0.0:
        nothing = ProvenBounds(0.0, 0.0, {}, 0.0, None, "unstable")
        return DiskMargins(each, DiskMarginBounds(0.0, 0.0, (1.0, 1.0), 0.0, nothing))
    matrices = to_continuous(*S, L.dt) if L.dt else S
    elements = tuple(DynamicElement(f"d{i}") for i in range(len(D)))
    names = tuple(e.name for e in elements)
    closed = System(*matrices, (), (), L.name, channels=names, elements=elements)
    least = min(*(one.size for one in each), most)
    largest = (1.0 + 1e-3) * least  # a little beyond
    bounds = robust_stability(closed, largest=largest, options=options or BoundOptions(gap=0.01))
    lower = min(bounds.lower, least)
    gains, phase = disk_gains(lower, skew), disk_phase(lower, skew)
    return DiskMargins(each, DiskMarginBounds(lower, min(bounds.upper, least), gains, phase, bounds))


def sensitivity(loop: System, offset: float) -> System:
    """``1 / (1 + L) + offset`` of a loop with one signal, with the loop's ports.

    Raises
    ------
    ValueError
        Not one input and one output; ``1 + L`` is singular at infinite frequency for the nominal member.
    """
    q = len(loop.channels)
    if loop.D.shape != (q + 1, q + 1):
        sizes = loop.D.shape[1] - q, loop.D.shape[0] - q
        raise InputError(f"loop must have one input and one output, got {sizes[0]} and {sizes[1]}")
    back = 1.0 + float(loop.D[q, q])
    if back == 0.0:
        raise InputError("loop must be well posed under negative feedback, got a gain of -1 at infinite frequency")
    # the input of the loop is u = (r - C2 x - D21 w) / (1 + D22), which is the output of S
    by_x, by_w, by_r = -loop.C[q] / back, -loop.D[q, :q] / back, 1.0 / back
    A = loop.A + np.outer(loop.B[:, q], by_x)
    B = np.hstack([loop.B[:, :q] + np.outer(loop.B[:, q], by_w), loop.B[:, q:] * by_r])
    C = np.vstack([loop.C[:q] + np.outer(loop.D[:q, q], by_x), by_x])
    inner = np.hstack([loop.D[:q, :q] + np.outer(loop.D[:q, q], by_w), loop.D[:q, q:] * by_r])
    D = np.vstack([inner, np.append(by_w, by_r + offset)])
    return replace(loop, A=A, B=B, C=C, D=D)
