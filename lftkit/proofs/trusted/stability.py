"""Stability of the members of a sampled loop: of the nominal one; no crossing above half of the sampling rate.

*The nominal member* (:func:`nominal_windows`), by the winding number of its return difference. Plant and controller are
stable by their poles; the loop is then stable if ``det(I - K G)`` does not pass zero on the unit circle and its
argument comes back to where it was (Nyquist). Frequency zero and half of the sampling rate have real matrices, so that
the change between them is a multiple of pi. In a window ``R(t) = R(0) X(t)``, and all eigenvalues of X are within
`share` of 1; the argument of ``det X`` is then the sum of the arguments of the eigenvalues, which can't pass pi.

*Above* (:func:`windows_above`) no scalings are needed. In a part of the box ``z = cz z' + sz w'`` and ``w = cw z' + sw
w'`` with ``w' = t z'``, -1 <= t <= 1, for each channel. From ``z = M w`` follows ``z' = N w'``, and no member has a
pole on the axis where the spectral radius of |N| is below 1. M is enclosed over windows of frequency, and beyond the
last one by its value at infinity with a bound of the rest; windows and box are bisected where that is not enough. With
infinity in the last window all members are well posed, so that no pole comes from there.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, UNIT
from lftkit.proofs.trusted.loop import ONE, Loop
from lftkit.proofs.trusted.polynomials import ORDER, Polynomial, constant, inverse, span, weighted_share, windows_with
from lftkit.proofs.trusted.proof import Box, ComplexArray, FloatArray, Interval
from lftkit.proofs.trusted.strips import TRIG, ends_of

LOOSE = 3e-5
"""Largest remainder of a window."""
DEEPEST = 50
"""Most bisections of the frequencies."""
PARTS = 32
"""Most bisections of the box in a window of frequency."""
OCTAVES = 12
"""Most doublings of the frequency from which the value at infinity is used."""
WIDEST = 3.0
"""Widest interval of an angle [rad] that is not bisected."""


def whole_axis(band: Interval, dt: float) -> bool:
    """Whether a band [rad/s] reaches from zero to half of the sampling rate ``1/dt``."""
    return band[0] == 0.0 and band[1] >= math.pi / dt


def stable_below(model: Loop, band: Interval, box: Box) -> float:
    """Frequency [rad/s] up to which no pole of a member crosses the axis, if its gain is bounded over `band`.

    Poles move continuously with the parameters. Infinite if every member was proven stable; half of the sampling rate
    if the nominal loop is, but poles may cross above; zero if that was not proven or the band is a part.
    """
    with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
        if not (whole_axis(band, model.dt) and nominal_windows(model)):
            return 0.0
        return math.inf if windows_above(model, box) else math.pi / model.dt


def nominal_windows(model: Loop) -> int:
    """Windows of frequency with which the nominal loop was proven stable; 0 if it was not.

    Zero too without a controller: such a plant's axis has no end at half of the sampling rate.
    """
    stable = np.all(model.poles.real < 0.0) and np.all(np.abs(model.K_poles) < 1.0 - 8.0 * UNIT)
    real = is_real(model.poles, model.B, model.C) and is_real(model.K_poles, model.K_B, model.K_C)
    if not (len(model.K_C) and stable and real):
        return 0
    changes = []

    def works(low: float, high: float) -> bool:
        changes.append(argument_change(model, low, high))
        return True

    count = windows_with(works, 0.0, math.pi / model.dt, DEEPEST)
    turned, doubt = (sum(column) for column in zip(*changes)) if count else (math.inf, 0.0)
    return count if abs(turned) + INFLATE * doubt < 3.0 else 0


def is_real(poles: ComplexArray, B: ComplexArray, C: ComplexArray) -> bool:
    """Whether the modes are real or pairs, one after the other, so that negative frequencies are conjugate."""
    k = 0
    while k < len(poles):
        other = k + 1 if poles[k].imag else k
        if other == len(poles) or poles[other] != poles[k].conjugate():
            return False
        if not (np.array_equal(B[other], B[k].conj()) and np.array_equal(C[:, other], C[:, k].conj())):
            return False
        k = other + 1
    return True


def argument_change(model: Loop, low: float, high: float) -> tuple[float, float]:
    """Change of the argument of ``det(I - K G)`` from `low` to `high` [rad/s], and a bound of its error [rad].

    Raises
    ------
    ArithmeticError
        The window is too wide, or the determinant may be zero in it.
    """
    middle, half = span(low, high)
    R = model.return_difference(middle, half)
    one = np.eye(len(R.rad))
    X, n = constant(linalg.solve(R.c[0], one)) @ R, len(one)
    share, size = weighted_share((X - constant(one)).bound())
    beyond = 16.0 * UNIT * high / half  # t of low and high is 1 to this
    slopes = sum(k * X.sizes[k] for k in range(1, ORDER + 1))
    loose = INFLATE * float(((X.rad + beyond * slopes) @ size / size).max()) / (1.0 - share)
    if not (share < min(0.9, math.sin(1.5 / n)) and loose < LOOSE):
        raise ArithmeticError("the window is too wide, or rounding too large")
    # the determinants are near 1, in units of `size` X(t) is close to I: their eigenvalues' arguments add up
    ends = [linalg.det(sum(c * t**k for k, c in enumerate(X.c)) * size / size[:, None]) for t in (-1.0, 1.0)]
    before, after = (math.atan2(end.imag, end.real) for end in ends)
    return after - before, 2.0 * n * (2.0 * loose + 1e3 * n * n * UNIT)


def windows_above(model: Loop, box: Box) -> int:
    """Windows from half of the sampling rate on in which no member has a pole on the axis; 0 if not proven.

    Above the last one, up to infinity, there is none either. The nominal loop must have been proven stable by
    :func:`nominal_windows`.
    """
    low, commands = math.pi / model.dt, commands_bound(model)
    for octave in range(1, OCTAVES + 1):
        high, parts = low * 2.0**octave, [box]
        if regular(model, beyond(model, high, commands), parts):
            break
    else:
        return 0
    return windows_with(lambda a, b: regular(model, channels(model, a, b), parts), low, high, DEEPEST)


def channels(model: Loop, low: float, high: float) -> Polynomial:
    """``M``: z by w, the nominal loop closed, over a window [rad/s]."""
    q, d = model.sizes[0], model.sizes[3]
    return model.responses(*span(low, high), np.eye(q + d, q, dtype=complex))[0]


def commands_bound(model: Loop) -> FloatArray:
    """Bound of the commands' changes from tick to tick, ``(1 - 1/z) u``, by what is added to the measurements.

    Shape (u, y). It holds at all frequencies, as functions of z are periodic.

    Raises
    ------
    ArithmeticError
        The nominal loop may have a pole on the axis.
    """
    largest: FloatArray = np.zeros((model.sizes[4], model.sizes[1]))

    def works(low: float, high: float) -> bool:
        nonlocal largest
        window = span(low, high)
        loop = inverse(model.return_difference(*window)) @ model.controller(*window) * (ONE - model.shift(*window))
        largest = np.maximum(largest, loop.bound())
        return True

    if not windows_with(works, 0.0, math.pi / model.dt, DEEPEST):
        raise ArithmeticError("the nominal loop may have a pole on the axis")
    return largest


def beyond(model: Loop, omega: float, commands: FloatArray) -> Polynomial:
    """``M`` at all frequencies from `omega` [rad/s] to infinity: its value there, and a bound of the rest.

    Modes are below ``1 / |j w - p|``; the hold is ``(1 - 1/z) / (j w dt)``, and `commands` has its numerator.
    """
    q, y, _, d, _ = model.sizes
    far = np.maximum(np.abs(model.poles.real), omega - model.poles.imag)
    C, B, D = np.abs(model.C[: q + y]) / far, np.abs(model.B), np.abs(model.D)
    felt = C[:q] @ B[:, q + d :] + D[:q, q + d :]
    measured = C[q:] @ B[:, :q] + D[q : q + y, :q]
    rest = C[:q] @ B[:, :q] + 1.0 / (omega * model.dt) * (felt @ (commands @ measured))
    return Polynomial(model.D[None, :q, :q].astype(complex), INFLATE * rest + TINY)


def regular(model: Loop, M: Polynomial, parts: list[Box]) -> bool:
    """Whether no member has a pole on the axis where its channels are M; parts of the box are bisected as needed."""
    whole = Polynomial(M.c[:1], INFLATE * (M.sizes[1:].sum(axis=0) + M.rad))
    waiting, done, left = parts.copy(), [], PARTS
    while waiting:
        part = waiting.pop()
        if deviation_share(model, whole, part) < 1.0:
            done.append(part)
            continue
        axis, left = model.to_bisect(M, part), left - 1
        if axis is None or not left:
            return False  # a narrower window is what helps
        low, high = part[axis]
        at = 0.5 * (low + high)
        waiting += [(*part[:axis], half, *part[axis + 1 :]) for half in ((low, at), (at, high))]
    parts[:] = done
    return True


def deviation_share(model: Loop, M: Polynomial, part: Box) -> float:
    """Bound of the spectral radius of |N|; infinite where the middle of the part may have a pole."""
    if any(angle and high - low > WIDEST for angle, (low, high) in zip(model.angle, part)):
        return math.inf
    # between the ends of an interval (z, w) is (1 - t) z' times the lower one plus (1 + t) z' times the upper one
    z_low, w_low, z_high, w_high = (constant(row, TRIG) for row in ends_of(model, part))
    cz, sz, cw, sw = z_low + z_high, z_high - z_low, w_low + w_high, w_high - w_low
    one = constant(np.eye(model.sizes[0]))
    try:
        N = inverse(one * cz - M * cw) @ (M * sw - one * sz)
    except (ArithmeticError, linalg.LinAlgError):
        return math.inf
    return weighted_share(N.bound())[0]
