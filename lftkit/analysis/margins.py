"""Margins of one loop: by gain, phase and delay alone, peaks of the sensitivities, and disk margins.

Crossings are zeros of ``1 - L~ L`` and of ``L - L~``, which generalised eigenvalues give; each is confirmed by a change
of sign of the response of the loop as it is, and refined there.

A disk margin says how much gain and phase may change at the same time. A loop of negative feedback stays stable for all
complex factors ``f`` in the disk around 1 that its size alpha and skew sigma give,
``f = (2 + (1 - sigma) a z) / (2 - (1 + sigma) a z)`` with ``|z| < 1``, ``a = alpha``. The largest alpha is
``1 / || S + (sigma - 1) / 2 ||`` with the sensitivity S. Source: Seiler, Packard and Gahinet, IEEE Control Systems
Magazine 40 (2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import linalg, optimize

from lftkit.analysis.eigenvectors import EPS, balanced
from lftkit.analysis.frequency_grid import pole_range
from lftkit.analysis.norms import HInfNorm, hinf_norm, is_stable
from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.regular_solve import regular_solve
from lftkit.support.scalars import as_number
from lftkit.support.settings import AlgorithmSettings
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.bilinear import to_continuous, unwarped_frequency
from lftkit.systems.system import System
from lftkit.systems.zeros_poles import zeros_of

sl_optimize: Any = optimize
Point = tuple[float, float]


@dataclass(frozen=True)
class CrossingSettings(AlgorithmSettings):
    """Numbers of the search for the crossings of a loop.

    Attributes
    ----------
    points : frequencies between the slowest and the fastest pole and crossing at which signs are looked at, too
    crosses : part of the response that may be left at a crossing; a pole on the axis, where the sign changes, too,
        leaves more
    noise : part of the response that is rounding, and no sign; a factor below it, or over its inverse, is no margin
    """

    points: int = 400
    crosses: float = 1e-6
    noise: float = 1e-12


SETTINGS = CrossingSettings()


@dataclass(frozen=True)
class LoopMargins:
    """Every crossing of one loop, by rising frequency [rad/s].

    Attributes
    ----------
    gain : tuple of (omega, factor)
        Where the response is real and negative: the factor of the gain that makes it -1, also at zero frequency, at
        infinity or at the Nyquist frequency.
    phase : tuple of (omega, angle)
        Where the gain is 1: the phase lag that makes the response -1 [deg], above -180 and up to 180; also at the
        frequencies of `gain` at the ends.
    delay : tuple of (omega, delay)
        At the frequencies between the ends the least delay that makes it -1 [s]. At infinity 0 where the gain there is
        1 or larger: no delay is short enough. At the Nyquist frequency one period where it is so: delays of a sampled
        loop are whole periods, and one makes it unstable.
    stable : bool
        Whether the loop is stable; otherwise the margins are crossings only.
    """

    gain: tuple[Point, ...]
    phase: tuple[Point, ...]
    delay: tuple[Point, ...]
    stable: bool

    @property
    def gain_range(self) -> tuple[float, float]:
        """Factors around 1 between which a stable loop stays stable; 0 and infinity without an end."""
        factors = [factor for _, factor in self.gain]
        return max((f for f in factors if f <= 1.0), default=0.0), min(
            (f for f in factors if f >= 1.0), default=math.inf
        )

    @property
    def phase_margin(self) -> float:
        """Least phase, lag or lead, that makes a stable loop unstable [deg]; infinite without a crossing."""
        return min((abs(angle) for _, angle in self.phase), default=math.inf)

    @property
    def delay_margin(self) -> float:
        """Least delay that makes a stable loop unstable [s]; infinite without a crossing."""
        return min((delay for _, delay in self.delay), default=math.inf)


@dataclass(frozen=True)
class SensitivityPeaks:
    """H-infinity norms of S = 1 / (1 + L) and T = L / (1 + L), both of their sides; infinite for an unstable loop."""

    sensitivity: HInfNorm
    complementary: HInfNorm


@checked
def loop_margins(loop: Any, *, settings: CrossingSettings = SETTINGS) -> LoopMargins:
    """Gain, phase and delay margins of a loop with one input and one output at all crossings (allmargin in MATLAB).

    Parameters
    ----------
    loop : System, or what :func:`lftkit.as_system` takes
        Loop transfer L of negative feedback, continuous or sampled: **the loop is closed by** ``u = -y``. A sampled
        one has no pole at z = -1.
    settings : CrossingSettings
        Numbers of the search.

    Raises
    ------
    ValueError
        An uncertain system, or one with several inputs or outputs.

    Examples
    --------
    ``k / (s (s + 1) (s + 2))`` bears the gain up to 6 / k, by the criterion of Hurwitz:

    >>> from lftkit import s
    >>> found = loop_margins((1 / (s * (s + 1) * (s + 2))).system("u", "y"))
    >>> [round(g, 9) for g in found.gain_range], round(found.phase_margin, 1), found.stable
    ([0.0, 6.0], 53.4, True)
    """
    L = as_system(loop)
    L.require_siso()
    signs, noise = _Signs.of(L, settings), settings.noise
    real = signs.crossings(lambda value: value.imag, lambda value: value.imag / abs(value))
    ends = signs.ends()
    gain = [*((omega, signs.value(omega).real) for omega in real), *ends]
    factors = tuple(sorted((omega, -1.0 / value) for omega, value in gain if value < 0.0))
    unit = signs.crossings(lambda value: abs(value) - 1.0, lambda value: abs(value) - 1.0)
    phase = [(omega, 180.0) for omega, value in ends if abs(value - 1.0) <= noise]
    delay = [(omega, L.dt) for omega, value in ends if omega > 0.0 and abs(value) >= 1.0 - noise]
    for omega in unit:
        lag = math.pi + float(np.angle(signs.value(omega)))  # from 0 to 2 pi
        phase.append((omega, math.degrees(lag if lag <= math.pi else lag - 2.0 * math.pi)))
        delay.append((omega, lag / omega))
    try:
        stable = is_stable(sensitivity(L)[0], L.dt)
    except ValueError:
        stable = False
    return LoopMargins(factors, tuple(sorted(phase)), tuple(sorted(delay)), stable)


@checked
def sensitivity_peaks(loop: Any) -> SensitivityPeaks:
    """Peaks of the sensitivities of a loop, also of one with several channels: Ms and Mt.

    Parameters
    ----------
    loop : System, or what :func:`lftkit.as_system` takes
        Loop transfer L of negative feedback, square, continuous or sampled.

    Raises
    ------
    ValueError
        An uncertain system, one that is not square, a loop that is not well posed.

    Examples
    --------
    A double integrator with the law ``s + 1``:

    >>> from lftkit import s
    >>> found = sensitivity_peaks(((s + 1) / s**2).system("u", "y"))
    >>> round(found.complementary.value, 4)
    1.4679
    """
    L = as_system(loop)
    L.require_certain()
    A, B, C, D = sensitivity(L)
    kind = L.dt or None
    return SensitivityPeaks(hinf_norm(A, B, C, D, dt=kind), hinf_norm(A, B, -C, np.eye(len(D)) - D, dt=kind))


def sensitivity(loop: System) -> Matrices:
    """Matrices of ``S = (1 + L)^-1``.

    Raises
    ------
    ValueError
        A loop that is not square, or not well posed.
    """
    A, B, C, D = loop.matrices
    if D.shape[0] != D.shape[1]:
        raise InputError(f"{loop.name}: must have as many inputs as outputs, got {D.shape[1]} and {D.shape[0]}")
    through = np.eye(len(D)) + D
    try:
        inner = regular_solve(through, np.eye(len(D)))
    except linalg.LinAlgError:
        raise InputError(
            f"{loop.name}: the loop must be well posed, got 1 + L singular at infinite frequency"
        ) from None
    return A - B @ inner @ C, B @ inner, -inner @ C, inner


@dataclass(frozen=True)
class _Signs:
    """A loop and the frequencies between which a sign of its response can change at most once."""

    loop: System
    between: FloatArray
    settings: CrossingSettings

    @classmethod
    def of(cls, L: System, settings: CrossingSettings) -> _Signs:
        matrices = to_continuous(*L.matrices, L.dt) if L.dt else L.matrices
        A, B, C, D = *balanced(*matrices[:3]), matrices[3]
        # 1 - L~ L and L - L~, with -A' for the states of L~
        into, out = np.vstack([B, -C.T @ D]), np.hstack([-D.T @ C, -B.T])
        gain = np.block([[A, np.zeros_like(A)], [-C.T @ C, -A.T]]), into, out, 1.0 - D * D
        real = linalg.block_diag(A, -A.T), np.vstack([B, C.T]), np.hstack([C, B.T]), 0.0 * D
        poles = np.abs(linalg.eigvals(A)) if len(A) else np.zeros(0)
        zeros = np.concatenate([zeros_of(*gain), zeros_of(*real)])
        marks = np.unique(np.concatenate([poles, np.abs(zeros.imag), np.abs(zeros)]))
        marks = marks[marks > 0.0] if marks.any() else np.ones(1)
        middle = np.sqrt(marks[1:]) * np.sqrt(marks[:-1])
        low, high = pole_range(poles)
        grid = np.geomspace(1e-3 * low, 1e3 * high, settings.points)
        both = np.unique(np.concatenate([grid, middle, [0.5 * marks[0], 2.0 * marks[-1]]]))
        if L.dt:
            both = np.array([unwarped_frequency(w, L.dt) for w in both])
        return cls(L, both, settings)

    def value(self, omega: float) -> complex:
        """The response at a frequency; not finite at a pole."""
        point = np.exp(1j * omega * self.loop.dt) if self.loop.dt else 1j * omega
        try:
            return complex(self.loop(point))
        except (ValueError, ArithmeticError, linalg.LinAlgError):
            return complex(math.inf, math.inf)

    @cached_property
    def _values(self) -> list[tuple[complex, float]]:
        """The responses between, each with the part of it that may be rounding."""
        A = balanced(*self.loop.matrices[:3])[0]
        points = np.exp(1j * self.between * self.loop.dt) if self.loop.dt else 1j * self.between
        parts = [linalg.svdvals(point * np.eye(len(A)) - A) if len(A) else np.ones(1) for point in points]
        noise = [max(self.settings.noise, EPS * float(sizes[0] / max(sizes[-1], 1e-300))) for sizes in parts]
        return [(self.value(omega), part) for omega, part in zip(self.between, noise)]

    def crossings(self, sign: Callable[[complex], float], left: Callable[[complex], float]) -> list[float]:
        """Frequencies at which `sign` of the response changes with nothing `left` [rad/s], rising."""
        signs = [sign(v) if np.isfinite(v) and abs(sign(v)) > noise * abs(v) else 0.0 for v, noise in self._values]
        signed = [i for i, value in enumerate(signs) if value]
        roots = []
        for low, high in pairwise(signed):
            if signs[low] * signs[high] < 0.0:
                ends = self.between[low], self.between[high]
                root = float(sl_optimize.brentq(lambda w: sign(self.value(w)), *ends, xtol=1e-300, rtol=1e-14))
                if abs(left(self.value(root))) < self.settings.crosses:
                    roots.append(root)
        return roots

    def ends(self) -> list[Point]:
        """Finite responses at zero frequency and at the highest one, which are real."""
        last = math.pi / self.loop.dt if self.loop.dt else math.inf
        values = [(0.0, self.value(0.0)), (last, self.value(last) if self.loop.dt else complex(self.loop.D.item()))]
        noise = self.settings.noise
        return [(omega, value.real) for omega, value in values if noise < abs(value) < 1.0 / noise]


@dataclass(frozen=True)
class DiskMargin:
    """Margin of one loop.

    Attributes
    ----------
    size : float
        alpha: 0 for a loop that is not stable.
    gain : tuple of float
        Factors of the gain alone that the loop bears, from and to.
    phase : float
        Change of the phase alone [deg], to both sides; 180 where every phase is borne.
    omega : float
        Frequency at which the margin is least [rad/s].
    factor : complex
        A factor at the edge of the disk that makes a pole at ``omega``.
    """

    size: float
    gain: tuple[float, float]
    phase: float
    omega: float
    factor: complex

    @property
    def gain_db(self) -> tuple[float, float]:
        """The factors in decibel."""
        low, high = (20.0 * math.log10(g) if g > 0.0 else -math.inf for g in self.gain)
        return low, high


NONE = DiskMargin(0.0, (1.0, 1.0), 0.0, 0.0, 1.0 + 0.0j)
"""That of a loop which is not stable."""


@checked
def disk_margin(loop: System, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a loop with one input and one output, continuous or sampled.

    Parameters
    ----------
    loop : System
        Loop transfer L of negative feedback: the loop is closed by ``u = -y``.
    skew : float
        0: gains and their inverses alike; above 0 the disk has more room for larger gains. Of magnitude 1e6 at most.

    Raises
    ------
    ValueError
        An uncertain system, or one with several inputs or outputs; another skew.

    Examples
    --------
    The example of Seiler, Packard and Gahinet, printed with 0.46, 0.63 to 1.59 and 25.8 deg:

    >>> from lftkit import s
    >>> found = disk_margin((25 / (s**3 + 10 * s**2 + 10 * s + 10)).system("u", "y"))
    >>> round(found.size, 2), [round(g, 2) for g in found.gain], round(found.phase, 1)
    (0.46, [0.63, 1.59], 25.8)
    """
    L, skew = as_system(loop), as_skew(skew)
    L.require_siso()
    try:
        A, B, C, D = sensitivity(L)
    except ValueError:
        return NONE
    return margin_of_shifted((A, B, C, D + 0.5 * (skew - 1.0)), L.dt, skew)


def as_skew(value: Any) -> float:
    """A skew of a disk margin; a ValueError for one whose margins would have no digits."""
    skew = as_number(value, "skew")
    # Beyond it the disk is a half plane, and the sensitivity is lost in the rounding of S + (skew - 1) / 2
    if not abs(skew) <= 1e6:
        raise InputError(f"skew must be from -1e+06 to 1e+06, got {skew:g}")
    return float(skew)


def margin_of_shifted(shifted: Matrices, dt: float, skew: float) -> DiskMargin:
    """Disk margin of the loop with one signal whose ``S + (skew - 1) / 2`` is given."""
    if not is_stable(shifted[0], dt):
        return NONE
    worst = hinf_norm(*shifted, dt=dt or None)
    size = 1.0 / worst.value if worst.value > 0.0 else math.inf
    # The factor that makes a pole at a frequency
    point = np.exp(1j * worst.omega * dt) if dt else 1j * worst.omega
    response = complex((shifted[3] if math.isinf(worst.omega) else lft.response(shifted, point)).item())
    below = 2.0 * response - (1.0 + skew)
    edge = (2.0 * response + 1.0 - skew) / below if below != 0.0 else complex(math.inf)
    return DiskMargin(size, disk_gains(size, skew), disk_phase(size, skew), worst.omega, edge)


def disk_gains(size: float, skew: float = 0.0) -> tuple[float, float]:
    """Real factors at the ends of the disk; zero and infinity where it reaches the axis or beyond.

    Examples
    --------
    A margin of 2/3 without skew allows gains from a half to two:

    >>> low, high = disk_gains(2.0 / 3.0)
    >>> round(low, 9), round(high, 9)
    (0.5, 2.0)
    """
    if math.isinf(size):
        return 0.0, math.inf
    below, above = 2.0 + (1.0 + skew) * size, 2.0 - (1.0 + skew) * size
    low = max((2.0 - (1.0 - skew) * size) / below, 0.0) if below > 0.0 else 0.0
    return low, (2.0 + (1.0 - skew) * size) / above if above > 0.0 else math.inf


def disk_phase(size: float, skew: float = 0.0) -> float:
    """Angle [deg] at which the unit circle leaves the disk ``(2 + (1 - skew) d) / (2 - (1 + skew) d)``, |d| < size.

    180 where it does not leave it.

    Examples
    --------
    >>> round(disk_phase(2.0), 6)
    90.0
    """
    # |d| of the factor exp(j phi) is 2 |f - 1| / |(1 - skew) + (1 + skew) f|
    square = size**2
    slope = 4.0 + square * (1.0 - skew**2)
    if math.isinf(size) or slope <= 0.0:
        return 180.0
    return math.degrees(math.acos(max(-1.0, (4.0 - square * (1.0 + skew**2)) / slope)))
