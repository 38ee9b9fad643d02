"""Check of strips: the inequality of a gain over a box of parameters, at every frequency of a window.

A strip of a proof is a box of the parameters with scalings D > 0 and G at some frequencies, its nodes; between two
nodes they are interpolated linearly, which keeps D > 0. With them the sum ::

    f (s^2 e* e / level^2 - d* W^-2 d) + sum 2 Re (first* D second) + 2 Re (z* j G w)

must be negative definite at *every* frequency of the strip. ``first`` and ``second`` are ``w - low z`` and ``high z -
w`` of a parameter in [low, high], so that their term is not negative for ``w = delta z``, and the last term is zero;
what is left bounds the gain, and shows that no pole is on the axis. An angle theta has ``w cos(a/2) - z sin(a/2)`` and
``z sin(b/2) - w cos(b/2)`` with ``w = tan(theta/2) z``. Between the nodes all functions of the frequency are
polynomials with bounded remainders (:mod:`lftkit.proofs.trusted.polynomials`): nothing is taken from a grid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from lftkit.proofs.trusted.arithmetic import UNIT, Ball, definite_ratio, embedded, positive
from lftkit.proofs.trusted.polynomials import ORDER, Polynomial, constant, linear, span, windows_with
from lftkit.proofs.trusted.proof import (
    COMPLEX,
    REAL,
    Box,
    ComplexArray,
    Each,
    FloatArray,
    Interval,
    ProofError,
    Strip,
    require,
    require_cover,
)

PIECES = 4
"""Parts of a window in which the inequality is checked one after the other."""
SHIFTS = [
    np.array([[math.comb(j, k) * at ** max(j - k, 0) / PIECES**k for j in range(ORDER + 1)] for k in range(ORDER + 1)])
    for at in np.arange(1.0 - PIECES, PIECES, 2.0) / PIECES
]
"""Coefficients in each part, whose variable is in [-1, 1] again, by those of the window."""
DEEPEST = 30
"""Most bisections of the frequencies between two nodes."""
TRIG = 4.0 * UNIT
"""Relative error of sine and cosine."""


class Responses(Protocol):
    """Responses of an uncertain system whose channels are ``w = delta z``, over windows of a variable.

    It is the frequency, or a function of it. All but :meth:`coordinates` is trusted.
    """

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Channels, measurements, errors, disturbances, commands."""
        ...

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Channels of each element."""
        ...

    @property
    def angle(self) -> tuple[bool, ...]:
        """Whether an element is tan(theta / 2) of an angle theta."""
        ...

    @property
    def kinds(self) -> tuple[str, ...]:
        """``real``, ``complex`` or ``full`` for each element."""
        ...

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the output's weight (1,), and of one over the disturbances' amplitudes (d,)."""
        ...

    def responses(self, middle: float, half: float, V: ComplexArray) -> tuple[Polynomial, Polynomial]:
        """``z`` and the bounded output over a window, as maps from the coordinates of V."""
        ...

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square. Nobody trusts them."""
        ...


def is_circle(low: float, high: float) -> bool:
    """Whether an interval of an angle is treated as any angle, with D = 0."""
    return high - low > 6.28


def ends_of(model: Responses, box: Box) -> FloatArray:
    """(ca, sa, cb, sb) of ``first = ca w - sa z`` and ``second = sb z - cb w`` of each channel, (4, q)."""
    found = np.zeros((4, model.sizes[0]))
    for group, angle, (low, high) in zip(model.groups, model.angle, box):
        a, b = 0.5 * low, 0.5 * high
        of_group = (math.cos(a), math.sin(a), math.cos(b), math.sin(b)) if angle else (1.0, low, 1.0, high)
        found[:, list(group)] = np.array(of_group)[:, None]
    return found


def inequality(model: Responses, strip: Strip, number: int, low: float, high: float, level: float) -> Polynomial:
    """The quadratic form over [low, high], between the nodes `number` and `number` + 1.

    Raises
    ------
    ArithmeticError
        The window may contain a pole, or the coordinates in which the form is written down are none. Any will do, as no
        form is negative definite in singular ones.
    """
    q, d = model.sizes[0], model.sizes[3]
    middle, half = span(low, high)
    V = np.asarray(model.coordinates(strip, number, middle, level), dtype=complex)
    if V.shape != (q + d, q + d) or not np.all(np.isfinite(V)):
        raise ArithmeticError("coordinates must be finite, as many as there are signals")
    z, e = model.responses(middle, half, V)
    w, disturbances = constant(V[:q]), constant(V[q:])
    output, inputs = model.performance(middle, half)
    start, length = strip.nodes[number], strip.nodes[number + 1] - strip.nodes[number]
    share = linear((middle - start) / length, half / length, 8.0 * UNIT * high / length)

    def between(values: ComplexArray) -> Polynomial:
        return constant(values[number]) + constant(values[number + 1] - values[number], 2.0 * UNIT) * share

    D, G = (np.zeros((number + 2, q, q), complex) for _ in range(2))
    for k, group in enumerate(model.groups):
        block = np.ix_(range(number, number + 2), group, group)
        D[block], G[block] = strip.D[k][number : number + 2], strip.G[k][number : number + 2]
    ca, sa, cb, sb = (constant(row[:, None], TRIG) for row in ends_of(model, strip.box))
    first, second = ca * w - sa * z, sb * z - cb * w
    half_form = first.adjoint() @ (between(D) @ second) + z.adjoint() @ (between(1j * G) @ w)
    error = e.adjoint() @ e * (output * constant(level**-2.0, 4.0 * UNIT))
    allowed = disturbances.adjoint() @ (inputs[:, None] * disturbances)
    return half_form + half_form.adjoint() + (error - allowed) * between(strip.factor[:, None].astype(complex))


def negative(form: Polynomial) -> bool:
    """Whether a Hermitian polynomial is certainly negative definite for all t in [-1, 1]."""
    size = form.rad + 64.0 * UNIT * form.sizes.sum(axis=0)
    for shift in SHIFTS:
        shifted = -np.tensordot(shift, form.c, 1)
        rest = size + np.abs(shifted[2:]).sum(axis=0)
        if not all(positive(shifted[0] + sign * shifted[1], rest) for sign in (-1.0, 1.0)):
            return False
    return True


def windows_of(model: Responses, strip: Strip, number: int, level: float, deepest: int = DEEPEST) -> int:
    """Windows between two nodes in which the inequality was verified, after bisections; 0 if it was not."""

    def works(low: float, high: float) -> bool:
        return negative(inequality(model, strip, number, low, high, level))

    return windows_with(works, float(strip.nodes[number]), float(strip.nodes[number + 1]), deepest)


def scalings_allowed(strip: Strip, angle: Sequence[bool]) -> bool:
    """Whether every D is positive definite (zero for any angle), D and G are Hermitian, factors positive."""
    for D, G, ends, turns in zip(strip.D, strip.G, strip.box, angle):
        if not all(np.all(np.isfinite(m)) and np.array_equal(m, m.conj().swapaxes(1, 2)) for m in (D, G)):
            return False
        if turns and is_circle(*ends):
            if np.any(D):
                return False
        elif not all(definite_ratio(Ball(embedded(d)), enough=1.0) > 0.0 for d in D):
            return False
    return bool(np.all(np.isfinite(strip.factor)) and np.all(strip.factor > 0.0))


def check_strip(item: tuple[Responses, Strip, float]) -> int | str:
    """Number of windows in which the inequality of a strip was verified, or why the strip is refused."""
    model, strip, level = item
    with np.errstate(all="ignore"):
        allowed = scalings_allowed(strip, model.angle)
    if not allowed:
        return "scalings must be Hermitian, D positive definite and factors positive"
    windows = 0
    for number, (low, high) in enumerate(itertools.pairwise(strip.nodes)):
        count = windows_of(model, strip, number, level)
        if not count:
            return f"the inequality must hold beyond rounding, got no margin from {low:.9g} to {high:.9g} rad/s"
        windows += count
    return windows


def require_strip(number: int, strip: Strip, model: Responses) -> None:
    """Ordered intervals; frequencies that ascend from zero or above; scalings of every element at every one."""
    nodes, shapes = strip.nodes, [(len(strip.nodes), len(group), len(group)) for group in model.groups]
    finite = len(strip.box) == len(shapes) and all(-math.inf < low <= high < math.inf for low, high in strip.box)
    require(finite, f"strip {number} must have a finite interval of each parameter, got {strip.box}")
    numbers = nodes.dtype == np.float64 and nodes.ndim == 1 and len(nodes) >= 2
    ascending = numbers and nodes[0] >= 0.0 and nodes[-1] < math.inf and np.all(np.diff(nodes) > 0.0)
    require(ascending, f"strip {number} must have two frequencies from zero or above that ascend, got {nodes}")
    for name, scalings in (("D", strip.D), ("G", strip.G)):
        own = [array.shape for array in scalings] == shapes and all(m.dtype == np.complex128 for m in scalings)
        require(own, f"strip {number} must have {name} of shapes {shapes}, got others")
    factors = strip.factor.shape == nodes.shape and strip.factor.dtype == np.float64
    require(factors, f"strip {number} must have a factor at each node, got shape {strip.factor.shape}")


def require_disks(number: int, strip: Strip, kinds: Sequence[str]) -> None:
    """Scalings of complex and dynamic elements, whose terms are not negative for any value in the whole disk.

    In an interval [-r, r] the term of a strip is ``2 (r^2 z* D z - w* D w)`` and what G adds. Without G it holds for
    ``w = delta z`` with every complex delta up to r; where D is a number, for ``w = Delta z`` with every matrix of norm
    up to r.
    """
    for kind, (low, high), D, G in zip(kinds, strip.box, strip.D, strip.G):
        single = kind in (REAL, COMPLEX) or np.array_equal(D, D[:, :1, :1] * np.eye(D.shape[-1]))
        own = kind == REAL or (low == -high and not np.any(G) and single)
        require(own, f"strip {number} must have a whole disk, G zero and D of its kind for {kind} elements")


def check_strips(
    model: Responses, strips: Sequence[Strip], box: Box, band: Interval, level: float, each: Each, unit: str
) -> int:
    """Windows with which cover and the inequality of every strip were verified over a box and a band."""
    for number, strip in enumerate(strips):
        require_strip(number, strip, model)
        require_disks(number, strip, model.kinds)
    require_cover(strips, box, band, unit)
    windows = count = 0
    for count, outcome in enumerate(each(check_strip, [(model, strip, level) for strip in strips]), 1):
        if isinstance(outcome, str):
            raise ProofError(f"strip {count - 1}: {outcome}")
        windows += outcome
    require(count == len(strips), f"each of {len(strips)} strips must be checked, got {count}")
    return windows
