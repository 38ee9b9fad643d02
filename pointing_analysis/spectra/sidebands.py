r"""Sidebands: lines of a tone that moves, and lines of their own beside a stronger one.

A tone that moves (a wheel whose speed is not constant) is a carrier with sidebands. Two kinds of lines name a carrier:

- **Pairs** at equal distances from a stronger line, with equal amplitudes and the phases of a modulation.
- What is left within :data:`CLOSE` / T of a line ten times stronger in power, unless it is a line of its own.

**A line of its own** is steady: its phasors in both halves of the record differ by no more than noise explains (what
rings at the start does not). And the carrier's motion does not explain it, for one of two reasons. A tone that moves
has the same motion on both axes, z(t) p: the phasors of all its parts are multiples of p, so that a part across p that
noise does not explain has another source. A modulation in amplitude or in angle has parts of equal size on both sides
of its carrier: a line that has less than half its amplitude at the other side is none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.spectra.sinusoid_fit import MERGED, Sinusoids, fit_sinusoids

CLOSE, TEN = 4.0, 10.0
SAME, ALIKE, IN_PHASE, HARMONICS = 0.5, 1.4, 0.5, 20.0
"""Of a pair of sidebands: largest error of the middle, in 1 / T; ratio of amplitudes to their mean; angle [rad] from
that of a modulation; orders up to which lines at multiples of their distance are harmonics."""

UNLIKELY, LEAST_ACROSS, LEAST_CHANGE = 1e-3, 0.05, 0.1
"""Chance in noise of a part across a carrier, or of a change between the halves of a record, as large as one that
counts; least powers that count, relative to that of the line."""

HALF = 0.5
"""Amplitude on the other side of a carrier, relative to that of a line, below which the line is no sideband."""


@dataclass(frozen=True)
class FoundLine:
    """A line that was found.

    Attributes
    ----------
    omega : [rad/s]
    phasor : (2,) complex, of each axis; the line is the real part of phasor times exp(i omega (t - t_middle))
    lower, upper : (2,) bounds of the amplitude of each axis at the stated confidence
    level : dB by which it is above the noise, see the module
    chance : expected number of lines as strong as this one in noise alone
    carrier : frequency [rad/s] of the line whose sideband this one is; NaN for none
    """

    omega: float
    phasor: ComplexArray
    lower: FloatArray
    upper: FloatArray
    level: float
    chance: float
    carrier: float = math.nan

    @property
    def amplitude(self) -> FloatArray:
        """(2,) amplitude of each axis."""
        return np.asarray(np.abs(self.phasor))

    @property
    def power(self) -> float:
        """Mean square, both axes."""
        return 0.5 * float(np.sum(self.amplitude**2))

    def times(self, unit: float) -> FoundLine:
        """The line of a record in another unit."""
        return replace(self, phasor=unit * self.phasor, lower=unit * self.lower, upper=unit * self.upper)

    @property
    def is_sideband(self) -> bool:
        """Whether it belongs to a stronger line."""
        return not math.isnan(self.carrier)


@dataclass(frozen=True)
class FittedRecord:
    """A record with its lines.

    Attributes
    ----------
    error : (n, 2)
    weight : (n,) of each row in the fits; zero where a sample is missing
    dt : [s]
    fitted : the lines
    noise_of : covariance (2, 2) of the phasor of a line in noise, and the transforms that it is estimated from
    """

    error: FloatArray
    weight: FloatArray
    dt: float
    fitted: Sinusoids
    noise_of: Callable[[FoundLine], tuple[ComplexArray, float]]

    @property
    def duration(self) -> float:
        """[s]."""
        return len(self.error) * self.dt

    def phasor_at(self, omega: float) -> ComplexArray:
        """Phasor (2,) at a frequency [rad/s], fitted with all lines; that of the line there, if one is."""
        w = self.fitted.omega
        nearest = int(np.abs(w - omega).argmin())
        if abs(w[nearest] - omega) * self.duration < MERGED * 2.0 * math.pi:
            return np.asarray(self.fitted.phasor[nearest])
        more = fit_sinusoids(self.error, self.weight, self.dt, np.append(w, omega), moves=False)
        return np.asarray(more.phasor[np.abs(more.omega - omega).argmin()])

    def change(self, omega: float) -> ComplexArray:
        """Phasor (2,) of a line in the first half of the record less that in the second."""
        n = len(self.error)
        turning = np.exp(-1j * omega * self.dt * (np.arange(n) - 0.5 * (n - 1)))
        present = self.weight > 0.0
        turning[~present] = 0.0
        halves = (slice(0, n // 2), slice(n // 2, n))
        first, second = (2.0 * turning[half] @ self.fitted.rest[half] / max(present[half].sum(), 1) for half in halves)
        return np.asarray(first - second)


def with_carriers(lines: Sequence[FoundLine], record: FittedRecord) -> tuple[FoundLine, ...]:
    """The lines of a record, each sideband with its carrier.

    Parameters
    ----------
    lines : found in the record
    record : with these lines
    """
    duration = record.duration
    strongest = sorted(lines, key=lambda line: -line.power)
    carriers: dict[float, float] = {}
    for i, carrier in enumerate(strongest):
        if carrier.omega in carriers:
            continue
        weaker = [line for line in strongest[i + 1 :] if line.omega not in carriers]
        for line in weaker:
            near = abs(line.omega - carrier.omega) * duration < CLOSE * 2.0 * math.pi
            if near and TEN * line.power < carrier.power and _moves_with(line, carrier, record):
                carriers[line.omega] = carrier.omega
        for lower, upper in _pairs(weaker, carrier, duration):
            carriers[lower.omega] = carriers[upper.omega] = carrier.omega
    return tuple(replace(line, carrier=carriers.get(line.omega, math.nan)) for line in lines)


def _pairs(weaker: Sequence[FoundLine], carrier: FoundLine, duration: float) -> list[tuple[FoundLine, FoundLine]]:
    """Lines at equal distances below and above a carrier that modulate it."""
    above = [line for line in weaker if line.omega > carrier.omega]
    below = [line for line in weaker if line.omega < carrier.omega]
    tolerance = 2.0 * math.pi * SAME / duration
    return [
        (lower, upper)
        for upper in above
        for lower in below
        if abs(lower.omega + upper.omega - 2.0 * carrier.omega) < tolerance and _modulates(lower, upper, carrier)
    ]


def _modulates(lower: FoundLine, upper: FoundLine, carrier: FoundLine) -> bool:
    """Whether two lines have the equal amplitudes and the phases of a modulation in amplitude or in angle.

    Harmonics of one fundamental are as far apart, too: lines at whole multiples of their distance are no sidebands.
    """
    distance = 0.5 * (upper.omega - lower.omega)
    order = carrier.omega / distance
    if order < HARMONICS and abs(order - round(order)) < 1e-3 * order:
        return False
    size = math.sqrt(lower.power * upper.power)
    if not max(lower.power, upper.power) < ALIKE**2 * size:
        return False
    phase = np.sum(lower.phasor * upper.phasor * np.conj(carrier.phasor) ** 2)
    return bool(abs(phase.imag) < math.tan(IN_PHASE) * abs(phase.real))


def _moves_with(line: FoundLine, carrier: FoundLine, record: FittedRecord) -> bool:
    """Whether a line beside a carrier can be a part of its motion."""
    covariance, number = record.noise_of(line)

    def counts(power: float, least: float) -> bool:
        return (1.0 + power / number) ** (1.0 - number) < UNLIKELY and power > least * (along + across)

    along, across = _parts(line.phasor, carrier.phasor, covariance)
    if counts(max(_parts(record.change(line.omega), line.phasor, 4.0 * covariance)), LEAST_CHANGE):
        return True
    mirror = 2.0 * carrier.omega - line.omega
    if counts(across, LEAST_ACROSS) or mirror <= 0.0:
        return mirror <= 0.0
    return _parts(record.phasor_at(mirror), carrier.phasor, covariance)[0] >= HALF**2 * along


def _parts(phasor: ComplexArray, direction: ComplexArray, covariance: ComplexArray) -> tuple[float, float]:
    """Power of a phasor along a direction and across it, relative to that of noise."""
    a, p = linalg.solve(covariance, np.stack([phasor, direction], axis=1)).T
    along = abs(complex(np.vdot(direction, a))) ** 2 / max(float(np.vdot(direction, p).real), 1e-300)
    return along, max(float(np.vdot(phasor, a).real) - along, 0.0)
