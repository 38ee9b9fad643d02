"""Force of a mass that moves to and fro with an unsteady phase: a cooler.

A harmonic of order h has the displacement ``X = -a / (m h^2 w^2) sin(h phi)``, bounded whatever the phase does, and the
force on the structure is that of its second derivative::

    phi = w t + theta(t)
    f = a ((phi' / w)^2 sin(h phi) - phi'' / (h w^2) cos(h phi))

So the force has neither a mean nor power at zero frequency, and a free spacecraft does not drift. The phase noise theta
is a random walk at instants that are `PERIODS` periods apart, and a cubic spline between them: it has two derivatives.
Its variance grows by ``2 pi linewidth`` [rad^2/s], so the line is Lorentzian as far from its centre as the instants
resolve. The phase does not depend on the tick: the same seed gives the same motion at every sampling rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from lftkit.arrays import ComplexArray, FloatArray

PERIODS = 4
"""Periods of the fundamental between two instants of the random walk."""
WIDEST = 0.1
"""Largest linewidth, as a part of the frequency: the frequency of a wider line would be negative at times."""


@dataclass(frozen=True)
class PhaseNoise:
    """A phase with two derivatives.

    Parameters
    ----------
    pieces : ndarray, shape (n, 4)
        Coefficients of each piece, from the cube down [rad/s^3, ..., rad].
    length : float
        Of a piece [s].
    """

    pieces: FloatArray
    length: float

    @classmethod
    def of(cls, linewidth: float, frequency: float, duration: float, rng: np.random.Generator) -> PhaseNoise:
        """Of an oscillator with a Lorentzian line of this full width at half maximum [Hz].

        Parameters
        ----------
        linewidth, frequency : float
            Hz.
        duration : float
            Of the run [s]; behind it the phase stays.
        rng : numpy.random.Generator
        """
        length = PERIODS / frequency
        count = math.ceil(duration / length) + 2
        steps = math.sqrt(2.0 * math.pi * linewidth * length) * rng.standard_normal(count)
        walk = np.concatenate([[0.0], np.cumsum(steps)])
        spline = CubicSpline(length * np.arange(walk.size), walk, bc_type="clamped")
        return cls(np.ascontiguousarray(spline.c.T), length)

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Phase [rad] and its two derivatives at times (q,) [s]."""
        piece = np.minimum((time / self.length).astype(int), len(self.pieces) - 1)
        since = np.minimum(time - piece * self.length, self.length)
        a, b, c, d = self.pieces[piece].T
        phase = ((a * since + b) * since + c) * since + d
        moves = time < self.length * len(self.pieces)
        return phase, moves * ((3.0 * a * since + 2.0 * b) * since + c), moves * (6.0 * a * since + 2.0 * b)


@dataclass(frozen=True)
class MovingMassSignal:
    """Force of a moving mass; the module says how.

    Parameters
    ----------
    frequency : float
        Of the fundamental [rad/s].
    order : ndarray, shape (q,)
        Of each harmonic.
    amplitude : ndarray, shape (q, 6), complex
        N, Nm; without phase noise the value is the imaginary part of ``amplitude exp(i order frequency t)``.
    dt : float
        Tick [s].
    noise : PhaseNoise
    """

    frequency: float
    order: FloatArray
    amplitude: ComplexArray
    dt: float
    noise: PhaseNoise

    @property
    def lines(self) -> FloatArray:
        """Frequencies of the harmonics [rad/s]."""
        return self.frequency * self.order

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        theta, rate, acceleration = self.noise.at((k + instants) * self.dt)
        phase = np.fmod(k * self.dt * self.lines, 2.0 * np.pi)[:, None] + np.multiply.outer(
            self.lines * self.dt, instants
        )
        turning = np.exp(1j * (phase + np.multiply.outer(self.order, theta)))
        swing = np.square(1.0 + rate / self.frequency)
        # the imaginary part of -i e^(i x) is -cos x
        bend = np.multiply.outer(1.0 / (self.order * self.frequency**2), acceleration)
        return np.asarray(((turning * (swing - 1j * bend)).T @ self.amplitude).imag)


def moving_mass(
    rows: Sequence[tuple[float, float, ComplexArray]], dt: float, frequency: float, noise: PhaseNoise
) -> MovingMassSignal:
    """Moving mass from rows of order, frequency [rad/s] and amplitudes (6,)."""
    order, _, amplitude = (np.array(x) for x in zip(*rows))
    return MovingMassSignal(frequency, order.astype(float), amplitude.astype(complex), dt, noise)
