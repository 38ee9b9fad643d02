"""That no pole of a member crosses the axis above half of the sampling rate.

Part of what is trusted, as :mod:`lftkit.proofs.sampled_loop.checker`; no scalings are needed. In a part of the box
``z = cz z' + sz w'`` and ``w = cw z' + sw w'`` with ``w' = t z'``, -1 <= t <= 1, for each channel. From ``z = M w``
follows ``z' = N w'``, and no member has a pole on the axis where the spectral radius of |N| is below 1. M is enclosed
over windows of frequency, and beyond the last one by its value at infinity with a bound of the rest; windows and box
are bisected where that is not enough. With infinity in the last window all members are well posed, so that no pole
comes from there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.polynomials import (
    INFLATE,
    TINY,
    UNIT,
    Polynomial,
    constant,
    exponential,
    inverse,
    weighted_share,
)
from lftkit.proofs.strips import Interval

Box = tuple[Interval, ...]
PARTS = 32
"""Most bisections of the box in a window of frequency."""
ENOUGH = 0.7
"""Share at the middle of a window below which its width is what has to be less."""
DEEPEST = 50
"""Most bisections of the frequencies."""
OCTAVES = 12
"""Most doublings of the frequency from which the value at infinity is used."""
WIDEST = 3.0
"""Widest interval of an angle [rad] that is not bisected."""


def windows_above(model: LoopModel, box: Box) -> int:
    """Windows from half of the sampling rate to infinity in which no member has a pole on the axis; 0 if not proven.

    The nominal loop must have been proven stable by :func:`lftkit.proofs.sampled_loop.nominal.nominal_windows`.
    """
    nyquist = math.pi / model.dt
    try:
        commands = commands_bound(model)
    except ArithmeticError:
        return 0
    for end in nyquist * 2.0 ** np.arange(OCTAVES + 1):
        parts = regular(model, beyond(model, float(end), commands), [box])
        if parts:
            break
    else:
        return 0
    waiting, done = ([(nyquist, float(end), 0)] if end > nyquist else []), 1
    while waiting:
        low, high, depth = waiting.pop()
        try:
            finer = regular(model, channels(model, low, high), parts)
        except (ArithmeticError, linalg.LinAlgError):
            finer = []
        if finer:
            done, parts = done + 1, finer
            continue
        if depth == DEEPEST:
            return 0
        middle = 0.5 * (low + high)
        waiting += [(middle, high, depth + 1), (low, middle, depth + 1)]
    return done


def span(low: float, high: float) -> tuple[float, float]:
    """Middle and half of a window that contains [low, high], whatever the rounding."""
    return 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 4.0 * UNIT) + 4.0 * UNIT * high


def channels(model: LoopModel, low: float, high: float) -> Polynomial:
    """``M``: z by w, the nominal loop closed, over a window [rad/s]."""
    q, d = model.sizes[0], model.sizes[3]
    return model.responses(*span(low, high), np.eye(q + d, q, dtype=complex))[0]


def commands_bound(model: LoopModel) -> FloatArray:
    """Bound of the commands' changes from tick to tick, ``(1 - 1/z) u``, by what is added to the measurements.

    Shape (u, y). It holds at all frequencies, as functions of z are periodic.

    Raises
    ------
    ArithmeticError
        The nominal loop may have a pole on the axis.
    """
    y, u = model.sizes[1], model.sizes[4]
    largest: FloatArray = np.zeros((u, y))
    waiting = [(0.0, math.pi / model.dt, 0)] if u else []
    while waiting:
        low, high, depth = waiting.pop()
        middle, half = span(low, high)
        z = exponential(np.array([middle * model.dt]), np.array([half * model.dt]))
        try:
            loop = inverse(model.return_difference(middle, half)) @ model.controller(z, middle, half)
            back = exponential(np.array([-middle * model.dt]), np.array([-half * model.dt]))
            loop = loop * (constant(np.ones(1)) - back)
        except ArithmeticError:
            if depth == DEEPEST:
                raise
            at = 0.5 * (low + high)
            waiting += [(at, high, depth + 1), (low, at, depth + 1)]
            continue
        largest = np.maximum(largest, loop.bound())
    return largest


def beyond(model: LoopModel, omega: float, commands: FloatArray) -> Polynomial:
    """``M`` at all frequencies from `omega` [rad/s] to infinity: its value there, and a bound of the rest.

    Modes are below ``1 / |j w - p|``; the hold is ``(1 - 1/z) / (j w dt)``, and `commands` has its numerator.
    """
    q, y, _, d, _ = model.sizes
    far = np.maximum(np.abs(model.poles.real), omega - model.poles.imag)
    C, B, D = np.abs(model.C[: q + y]) / far, np.abs(model.B), np.abs(model.D)
    rest = C[:q] @ B[:, :q]
    felt = C[:q] @ B[:, q + d :] + D[:q, q + d :]
    measured = C[q:] @ B[:, :q] + D[q : q + y, :q]
    rest = rest + 1.0 / (omega * model.dt) * (felt @ (commands @ measured))
    return Polynomial(model.D[None, :q, :q].astype(complex), INFLATE * rest + TINY)


def regular(model: LoopModel, M: Polynomial, parts: Sequence[Box]) -> list[Box]:
    """Parts of the box, bisected as needed, in which no member has a pole on the axis where its channels are M.

    Empty if that was not proven.
    """
    whole = Polynomial(M.c[:1], INFLATE * (M.sizes()[1:].sum(axis=0) + M.rad))
    waiting, done, left = list(parts), [], PARTS
    while waiting:
        part = waiting.pop()
        wide = [k for k, (low, high) in enumerate(part) if model.angle[k] and high - low > WIDEST]
        if not wide and deviation_share(model, whole, part) < 1.0:
            done.append(part)
            continue
        left -= 1
        if not left or not (wide or deviation_share(model, constant(M.c[0]), part) > ENOUGH):
            return []  # a narrower window is what helps
        axis = wide[0] if wide else widest(model, constant(M.c[0]), part)
        low, high = part[axis]
        at = 0.5 * (low + high)
        waiting += [(*part[:axis], half, *part[axis + 1 :]) for half in ((low, at), (at, high))]
    return done


def deviation_share(model: LoopModel, M: Polynomial, part: Box) -> float:
    """Bound of the spectral radius of |N|; infinite where the middle of the part may have a pole."""
    cz, sz, cw, sw = deviations(model, part)
    try:
        N = inverse(diagonal(cz) - M * cw) @ (M * sw - diagonal(sz))
    except (ArithmeticError, linalg.LinAlgError):
        return math.inf
    return weighted_share(N.bound() + TINY)[0]


def diagonal(values: Polynomial) -> Polynomial:
    """Diagonal matrix of a constant vector."""
    return Polynomial(np.diag(values.c[0])[None], np.diag(values.rad))


def deviations(model: LoopModel, part: Box) -> tuple[Polynomial, Polynomial, Polynomial, Polynomial]:
    """(cz, sz, cw, sw) of each channel, (q,): the values of t include all of the part, whatever the rounding."""
    q = model.sizes[0]
    cz, sz, cw, sw = np.ones(q), np.zeros(q), np.zeros(q), np.zeros(q)
    for group, angle, (low, high) in zip(map(list, model.groups), model.angle, part):
        at = 0.5 * (low + high)
        width = max(high - at, at - low) * (1.0 + 4.0 * UNIT)
        cw[group], sw[group] = at, width
        if angle:
            t = math.tan(0.5 * width) * (1.0 + 16.0 * UNIT)
            cz[group], sz[group] = math.cos(0.5 * at), -t * math.sin(0.5 * at)
            cw[group], sw[group] = math.sin(0.5 * at), t * math.cos(0.5 * at)
    error = 8.0 * UNIT  # of sine and cosine, and a product
    return constant(cz, error), constant(sz, error), constant(cw, error), constant(sw, error)


def widest(model: LoopModel, M: Polynomial, part: Box) -> int:
    """Parameter whose interval alone has the largest share."""
    shares = []
    for k, (low, high) in enumerate(part):
        middle = [(0.5 * (a + b),) * 2 for a, b in part]
        middle[k] = (low, high)
        shares.append(deviation_share(model, M, tuple(middle)) if high > low else 0.0)
    return int(np.argmax(shares))
