"""Check of a proof over the frequency axis: a gain, or stability, for a box of parameters.

The inequality of a strip (:mod:`lftkit.proofs.trusted.strips`) is negative definite at every frequency of the strip: it
bounds the gain there, and shows that no member has a pole on the axis. Strips over the inverse of the frequency include
infinity, where it shows that all members are well posed. With a stable nominal member in the box every member is then
stable, as poles move continuously.

Responses are those of the system's own matrices. Frequencies up to a border are themselves the variable, ``s = j x``;
those beyond it, infinity included, are ``s = j / x``. With any matrices T and X, X T = I + E and X A T = L + F with L
diagonal, ::

    (j x - A)^-1 = T (j x - L + j x E - F)^-1 X,    (j / x - A)^-1 = x T (j - x L + j E - x F)^-1 X,

and a Neumann series bounds what E and F, which are rounding, make of the inverse of the diagonal matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, UNIT
from lftkit.proofs.trusted.digests import plant_digest
from lftkit.proofs.trusted.polynomials import Polynomial, constant, reciprocal, weighted_share
from lftkit.proofs.trusted.proof import (
    COMPLEX,
    FULL,
    REAL,
    Box,
    CheckedProof,
    ComplexArray,
    Each,
    FloatArray,
    Interval,
    Strip,
    indices,
    refusing,
    require,
)
from lftkit.proofs.trusted.strips import check_strips


def neumann(share: FloatArray) -> FloatArray:
    """Bound of ``(I + S)^-1 - I`` for all matrices S whose entries are below `share`.

    Raises
    ------
    ArithmeticError
        ``I + S`` may be singular.
    """
    if not len(share):
        return share
    radius, size = weighted_share(share)
    if not radius < 0.9:
        raise ArithmeticError("the nominal member may have a pole in the window")
    return np.asarray(INFLATE * (share + radius**2 / (1.0 - radius) * size[:, None] / size) + TINY)


@dataclass(frozen=True)
class AxisSystem:
    """An uncertain system over one part of the frequency axis.

    Parameters
    ----------
    A, B, C, D : ndarray
        Shapes (n, n), (n, q + d), (q + e, n), (q + e, q + d): the channels of the parameters first.
    poles : ndarray, complex, shape (n,)
        L, about the poles of A.
    T, X : ndarray, complex, shape (n, n)
        About the eigenvectors of A and their inverse.
    groups : tuple of tuple of int
        Channels of each element.
    kinds : tuple of str
        ``real``, ``complex`` (a number) or ``full`` (a matrix) for each element; the latter two are bounded by the ends
        of an interval about zero.
    beyond : bool
        Whether the variable is the inverse of the frequency.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    poles: ComplexArray
    T: ComplexArray
    X: ComplexArray
    groups: tuple[tuple[int, ...], ...]
    kinds: tuple[str, ...]
    beyond: bool

    @cached_property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Channels, measurements (none), errors, disturbances, commands (none)."""
        q = sum(len(group) for group in self.groups)
        return q, 0, len(self.D) - q, self.D.shape[1] - q, 0

    @property
    def angle(self) -> tuple[bool, ...]:
        """No parameter is an angle."""
        return (False,) * len(self.groups)

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the errors' weight (1,) and of one over the disturbances' amplitudes (d,): ones."""
        return constant(np.ones(1)), constant(np.ones(self.sizes[3]))

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """As of :class:`~lftkit.proofs.trusted.strips.Responses`, of who searches proofs."""
        raise NotImplementedError

    def responses(self, middle: float, half: float, V: ComplexArray) -> tuple[Polynomial, Polynomial]:
        """``z`` and the errors over a window ``middle + half t`` of the variable, as maps from the coordinates of V.

        Parameters
        ----------
        middle, half : float
        V : ndarray, complex, shape (q + d, N)
            (w, d) of the coordinates.

        Raises
        ------
        ArithmeticError
            The window may contain a pole of the nominal member.
        """
        q = self.sizes[0]
        x = Polynomial(np.array([[middle], [half]], dtype=complex))
        rounding = INFLATE * (abs(middle) + abs(half))
        one, E, F = constant(np.array([1j])), *self._errors
        if self.beyond:
            modes, off = reciprocal(one - x * constant(self.poles)), E + rounding * F
        else:
            modes, off = reciprocal(one * x - constant(self.poles)), rounding * E + F
        out, into = self._observed, self._excited @ constant(V)
        states = modes[:, None] * into
        size = modes.bound()
        rest = out.bound() @ (neumann(size[:, None] * off) @ (size[:, None] * into.bound()))
        whole = out @ states
        whole = Polynomial(whole.c, INFLATE * (whole.rad + rest) + TINY)
        if self.beyond:
            whole = whole * x[:, None]
        whole = whole + constant(self.D) @ constant(V)
        return whole[:q], whole[q:]

    @cached_property
    def _observed(self) -> Polynomial:
        """``C T``."""
        return constant(self.C) @ constant(self.T)

    @cached_property
    def _excited(self) -> Polynomial:
        """``X B``."""
        return constant(self.X) @ constant(self.B)

    @cached_property
    def _errors(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the entries of E and F."""
        E = constant(self.X) @ constant(self.T) - constant(np.eye(len(self.A)))
        F = constant(self.X) @ (constant(self.A) @ constant(self.T)) - constant(np.diag(self.poles))
        return E.bound(), F.bound()

    def nominal_stable(self) -> bool:
        """Whether all poles of A are certainly in the open left half plane.

        There ``|s| / |s - l| <= 1 + |l| / |Re l|``, so that E and F cannot make the pencil singular.
        """
        if not len(self.A):
            return True
        decay = -self.poles.real * (1.0 - 4.0 * UNIT)
        if not np.all(decay > 0.0):
            return False
        E, F = self._errors
        share = ((1.0 + np.abs(self.poles) / decay)[:, None] * E + F / decay[:, None]) * INFLATE
        return bool(weighted_share(share)[0] < 1.0)


@dataclass(frozen=True)
class AxisClaim:
    """What is claimed and the strips that prove it.

    Parameters
    ----------
    kind : str
        ``gain`` or ``stability``.
    level : float or None
        The gain from all inputs to all outputs is below it; None for stability.
    names : tuple of str
        Of the parameters and of complex and dynamic elements.
    nominal : tuple of float
        Their nominal values; zero for complex and dynamic elements.
    box : tuple of (low, high)
        Their intervals, physical values; minus and plus the radius of complex numbers, the bound of dynamics.
    band : (low, high)
        Frequencies [rad/s]; high may be infinite.
    system : AxisSystem
        With ``w = (value - nominal) z`` for each channel; without inputs and outputs for stability.
    border : float
        Power of two: frequency [rad/s] from which strips are over the inverse of the frequency.
    below, above : tuple of Strip
        Boxes are deviations from the nominal values.
    """

    kind: str
    level: float | None
    names: tuple[str, ...]
    nominal: tuple[float, ...]
    box: Box
    band: Interval
    system: AxisSystem
    border: float
    below: tuple[Strip, ...] = field(default=())
    above: tuple[Strip, ...] = field(default=())

    @property
    def deviations(self) -> Box:
        """Intervals of the deviations from the nominal values, rounded outwards."""
        return deviations_of(self.box, self.nominal)


def deviations_of(box: Box, nominal: tuple[float, ...]) -> Box:
    """Intervals of ``value - nominal``, rounded outwards."""

    def away(value: float, middle: float, towards: float) -> float:
        return 0.0 if value == middle else math.nextafter(value - middle, towards)

    return tuple((away(low, at, -math.inf), away(high, at, math.inf)) for (low, high), at in zip(box, nominal))


def check_axis_proof(proof: AxisClaim, each: Each = map) -> CheckedProof:
    """Verify a proof; a ProofError says why it is refused.

    Parameters
    ----------
    proof : AxisClaim
    each : callable
        Maps a function over the strips; they may be checked in several processes.

    Returns
    -------
    CheckedProof
        `cells` is the number of windows of frequency; a strip that passes has a margin of 1 at least.
    """
    with refusing("a proof over the axis"):
        return _checked(proof, each)


def _checked(proof: AxisClaim, each: Each) -> CheckedProof:
    level, (low, high), border = require_claim(proof), proof.band, proof.border
    require_matrices(proof.system, proof.kind)
    parts = [(False, proof.below, (low, border if math.isinf(high) else high), "rad/s")]
    if math.isinf(high):
        parts.append((True, proof.above, (0.0, 1.0 / border), "s/rad"))
    windows = sum(
        check_strips(replace(proof.system, beyond=beyond), strips, proof.deviations, band, level, each, unit)
        for beyond, strips, band, unit in parts
        if band[0] < band[1]
    )
    inside = all(a <= 0.0 <= b for a, b in proof.deviations)
    stable = proof.band == (0.0, math.inf) and inside and proof.system.nominal_stable()
    proven = stable or proof.kind == "gain"
    require(proven, "a proof of stability needs the whole axis and a stable nominal member in the box")
    named = list(zip(proof.names, proof.system.kinds, proof.box))
    box = {name: ends for name, kind, ends in named if kind == REAL}
    disks = {name: ends[1] for name, kind, ends in named if kind != REAL}
    return CheckedProof(_digest(proof), proof.kind, proof.level, box, proof.band, windows, 1.0, stable, disks)


def _digest(proof: AxisClaim) -> str:
    """Digest of the plant."""
    system, every = proof.system, list(zip(proof.names, proof.system.kinds, proof.nominal, proof.system.groups))
    channels = dict(sorted((channel, name) for name, _, _, group in every for channel in group))
    nominal = {name: at for name, kind, at, _ in every if kind == REAL}
    sizes = {name: (len(group),) * 2 if kind == FULL else (1, 1) for name, kind, _, group in every if kind != REAL}
    return plant_digest(0.0, [*channels.values()], nominal, sizes, (system.A, system.B, system.C, system.D))


def require_claim(proof: AxisClaim) -> float:
    """A kind, a level, a band, a border and a box that make sense; the level of the inequality."""
    require(proof.kind in ("gain", "stability"), f"a proof must be of a gain or of stability, got {proof.kind!r}")
    level = 1.0 if proof.kind == "stability" else proof.level or 0.0
    own = 0.0 < level < math.inf and (proof.kind == "gain" or proof.level is None)
    require(own, f"a gain must have a positive level and stability none, got {proof.level}")
    low, high = proof.band
    require(0.0 <= low < high, f"a band must be two frequencies with 0 <= lower < upper, got {proof.band}")
    border = proof.border
    power = 2.0**-500 < border < 2.0**500 and math.frexp(border)[0] == 0.5
    above = low <= border or high < math.inf
    require(power and above, f"the border must be a power of two above the band's lower end, got {border}")
    names, kinds, count = proof.names, proof.system.kinds, len(proof.system.groups)
    own = len(names) == len(set(names)) == len(proof.nominal) == len(proof.box) == len(kinds) == count
    require(own, "each element must have a name of its own, a kind, a nominal value and an interval")
    for kind, at, (lower, upper) in zip(kinds, proof.nominal, proof.box):
        disk = kind in (COMPLEX, FULL) and lower == -upper and at == 0.0
        require(kind == REAL or disk, "each element must be real, or a disk about zero")
        own = all(map(math.isfinite, (at, lower, upper))) and lower <= upper
        require(own, f"intervals must be finite with lower <= upper, got {proof.box}")
    return level


def require_matrices(system: AxisSystem, kind: str) -> None:
    """Finite matrices that fit to each other; every channel belongs to one parameter."""
    n, q = len(system.A), system.sizes[0]
    rows, columns = system.D.shape
    shapes: dict[str, tuple[int, ...]] = {"A": (n, n), "B": (n, columns), "C": (rows, n), "D": (rows, columns)}
    for name, shape in {**shapes, "poles": (n,), "T": (n, n), "X": (n, n)}.items():
        array, number = getattr(system, name), np.float64 if name in "ABCD" else np.complex128
        own = array.shape == shape and array.dtype == number and np.all(np.isfinite(array))
        require(own, f"{name} must be finite, of shape {shape} and type {number.__name__}, got another")
    channels = [channel for group in system.groups for channel in group]
    own = indices(channels, q) and len({*channels}) == q
    require(own, "every channel must belong to one parameter")
    errors, inputs = rows - q, columns - q
    own = min(errors, inputs) > 0 if kind == "gain" else errors == inputs == 0
    require(own, f"a gain needs outputs and inputs, stability has none, got {(errors, inputs)}")
