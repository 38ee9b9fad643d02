"""Level of the relative error that tones and noise make together in a window.

The error in a window of length T is that of a slow tone, of a fast one, and of noise, each less its mean there. At the
places t of the window, from -1/2 to 1/2, a tone of amplitude a that turns by an angle g in the window is ::

    a Re(exp(i phi) E(t)),   E(t) = (exp(i g t) - mean) / rms

with a random phase phi; a is the amplitude of the weighted tone, which is its rms over all windows times the square
root of two. For a small angle it is a ramp. Noise is Gaussian and stationary: along the axis of the tone and across it
has a covariance C over the places of a window. With the eigenvectors v_j of C and its eigenvalues l_j the mean square
of the error is a sum of squares of independent numbers ::

    Q = sum of (c_j(phi) + sqrt(l_j) n_j)^2 + rest(phi),   n_j of variance 1

where c_j are the parts of the tones along v_j and the rest is outside of what the noise has. The distribution of Q at a
phase follows from its Laplace transform ``prod (1 + 2 l_j s)^(-1/2) exp(-c_j^2 s / (1 + 2 l_j s))`` along a contour
around its singularities, which are negative (Trefethen, Weideman and Schmelzer, BIT 46, 2006). The level L is the root
of ``P(Q > L^2) = 1 - p``, the mean over the phases.

Noise of which the root mean square alone is known may have any shape. Beside a tone the worst ones are a ramp and noise
as narrow as the tone at its frequency; the larger level of both counts.

The instants of the absolute error have the distribution of a slow tone: one number along the axis, one across.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lftkit.errors import InputError
from lftkit.support.settings import AlgorithmSettings

if TYPE_CHECKING:  # a recorder needs the shares of a budget alone, and no linear algebra
    from lftkit.arrays import ComplexArray, FloatArray

ON_AXIS = 0.7
"""Part of the noise's power that budgets put on the axis of the tone."""


@dataclass(frozen=True)
class LevelSettings(AlgorithmSettings):
    """Numbers of the computation of a level.

    Attributes
    ----------
    places : fewest of a window
    most_places : most of a window; noise and tones that turn faster are taken at this resolution
    phases, phases_of_two : of one tone, and of each of two, beside noise of at least a tenth of them; more beside less
    negligible, negligible_of_two : part of a tone, and of the larger of two, below which noise counts as this part
    small : eigenvalues below this part of their sum are added as their mean
    nodes : of the contour, on its upper half
    small_noise : part of a tone below which noise is small: the contour would need too many nodes
    bisections : for the saddle point of a distribution beside small noise
    slow : angle that a tone turns in a window below which it is a ramp there
    least_on_axis : least part of the noise's power on the axis of the tone
    """

    places: int = 64
    most_places: int = 512
    phases: int = 32
    phases_of_two: int = 12
    negligible: float = 2e-3
    negligible_of_two: float = 0.02
    small: float = 1e-3
    nodes: int = 16
    small_noise: float = 0.2
    bisections: int = 60
    slow: float = 1e-2
    least_on_axis: float = 0.1


SETTINGS = LevelSettings()


@dataclass(frozen=True, eq=False)
class WindowNoise:
    """Noise in the windows of the relative error, or at the instants of the absolute error.

    Parameters
    ----------
    rms : float
        Over both axes.
    on_axis : float
        Part of its power on the axis of the tone, 0.1 to 1.
    shape : ndarray, shape (n, n), optional
        Covariance at the middles of n equal parts of a window, of noise less its mean there; any scale. None: unknown.
    """

    rms: float
    on_axis: float = ON_AXIS
    shape: FloatArray | None = None

    def __post_init__(self) -> None:
        if not self.rms >= 0.0:
            raise InputError(f"noise must not be negative, got {self.rms}")
        if not SETTINGS.least_on_axis <= self.on_axis <= 1.0:
            raise InputError(f"on_axis must be from {SETTINGS.least_on_axis:g} to 1, got {self.on_axis}")

    @classmethod
    def of_spectrum(cls, rms: float, on_axis: float, turns: FloatArray, powers: FloatArray) -> WindowNoise:
        """From the powers (m,) that components have in the relative error, and the angles that they turn in a window.

        Parameters
        ----------
        rms, on_axis : float
        turns : ndarray, shape (m,)
            [rad], zero or more.
        powers : ndarray, shape (m,)
            In any unit.

        Examples
        --------
        >>> slow = WindowNoise.of_spectrum(10.0, 0.7, np.array([1e-3]), np.array([1.0]))
        >>> bool(np.allclose(slow.shape, np.outer(ramp(64), ramp(64)), atol=1e-3))
        True
        """
        n = places_of(float(np.max(turns, initial=0.0)))
        parts = np.stack([tone_shape(float(turn), n) for turn in turns]) * np.sqrt(powers / np.sum(powers))[:, None]
        return cls(rms, on_axis, np.asarray((parts.T @ parts.conj()).real))

    def changed(self, rms: float) -> WindowNoise:
        """The same noise with another root mean square."""
        other = WindowNoise(rms, self.on_axis, self.shape)
        if "modes" in vars(self):
            vars(other)["modes"] = self.modes
        return other

    @cached_property
    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues (d,), with the sum 1, and eigenvectors (n, d) of the shape, the largest first."""
        from scipy import linalg

        assert self.shape is not None
        values, vectors = linalg.eigh(self.shape)
        kept = values > SETTINGS.small * float(values.sum())
        return np.asarray(values[kept][::-1] / values.sum()), np.asarray(vectors[:, kept][:, ::-1])


def places_of(turn: float) -> int:
    """Places of a window in which a component turns by an angle [rad]."""
    return int(min(max(SETTINGS.places, math.ceil(2.0 * turn / math.pi) + 1), SETTINGS.most_places))


def ramp(n: int) -> FloatArray:
    """A ramp at the middles of n parts of a window, of mean zero and rms one."""
    t = (np.arange(n) + 0.5) / n - 0.5
    return np.asarray(t / np.sqrt(np.mean(t**2)))


def tone_shape(turn: float, n: int) -> ComplexArray:
    """E of a tone that turns by `turn` [rad] in a window, at the middles of n parts: mean zero, mean of |E|^2 one."""
    if turn < SETTINGS.slow:
        return np.asarray(1j * ramp(n), dtype=np.complex128)
    shape = np.exp(1j * turn * ((np.arange(n) + 0.5) / n - 0.5))
    shape -= shape.mean()
    return np.asarray(shape / np.sqrt(np.mean(np.abs(shape) ** 2)))


def combined_level(
    tone: float,
    noise: WindowNoise | float,
    probability: float,
    turn: float = 0.0,
    *,
    slow: float = 0.0,
    least: float = 0.0,
) -> float:
    """Level that a part of the windows (or instants) keeps with tones and noise together.

    Parameters
    ----------
    tone : float
        Amplitude of the weighted relative error along one axis, or of the absolute error.
    noise : WindowNoise or float
        Error due to noise in the same unit; a number is its rms over both axes, of any shape.
    probability : float
        The part, that of a requirement: 0.997 for 99.7 %.
    turn : float
        Angle that the tone turns in a window [rad], omega T; 0: of a slow tone, or of instants.
    slow : float
        Amplitude of a slow tone beside it, on the same axis, with an independent phase.
    least : float
        A level of interest: where it is kept it is the result, which is found much sooner than the level itself.

    Returns
    -------
    float
        In the same unit, `least` or more.

    Raises
    ------
    ValueError
        A negative tone, noise or turn, or a part of the noise that is none.

    Examples
    --------
    >>> round(combined_level(0.0, WindowNoise(10.0, 0.5), 0.997), 2), round(combined_level(17.0, 11.0, 0.997), 1)
    (24.1, 39.5)

    A faster tone hardly adds up with slow noise, and with noise at its frequency it does:

    >>> ramps = WindowNoise(11.0, shape=np.outer(ramp(64), ramp(64)))
    >>> [round(combined_level(17.0, noise, 0.997, turn=8.0), 1) for noise in (ramps, 11.0)]
    [31.3, 31.8]
    """
    if not (tone >= 0.0 and turn >= 0.0 and slow >= 0.0):
        raise InputError(f"tones and turn must not be negative, got {tone}, {slow} and {turn}")
    known = noise if isinstance(noise, WindowNoise) else WindowNoise(noise)
    if not known.rms and not slow:
        return max(least, _alone(tone, probability, turn))
    shapes = [known.shape] if known.shape is not None else [_narrow(0.0, turn), _narrow(turn, turn)]
    fewest = SETTINGS.negligible_of_two if slow and tone else SETTINGS.negligible
    rms = max(known.rms, fewest * max(tone, slow))
    for shape in shapes[: 1 if turn < SETTINGS.slow else None]:
        least = _level(tone, WindowNoise(rms, known.on_axis, shape), probability, turn, slow, least)
    return least


def _narrow(turn: float, longest: float) -> FloatArray:
    """Covariance of noise at one frequency."""
    shape = tone_shape(turn, places_of(longest))
    return np.asarray(np.outer(shape, shape.conj()).real)


def _alone(tone: float, probability: float, turn: float) -> float:
    """Level of a tone without noise: its mean square is a constant and a part that turns twice as fast."""
    square = np.mean(tone_shape(turn, places_of(turn)) ** 2)
    return float(tone * math.sqrt(0.5 * (1.0 - abs(square) * math.cos(math.pi * probability))))


def _level(tone: float, noise: WindowNoise, probability: float, turn: float, slow: float, least: float) -> float:
    outside = _outside(tone, noise, turn, slow)
    if least > 0.0 and outside(least) <= 1.0 - probability:
        return least
    from scipy import optimize

    high = 1.5 * (tone + slow) + 5.0 * noise.rms
    tolerance = min(2e-12, 1e-12 * high)
    root = optimize.brentq(lambda level: outside(level) - (1.0 - probability), 0.0, high, xtol=tolerance, rtol=1e-9)
    return max(least, float(root))


def _outside(tone: float, noise: WindowNoise, turn: float, slow: float) -> Callable[[float], float]:
    """Probability of an error beyond a level, as a function of it."""
    values, vectors = noise.modes
    n = len(vectors)
    few = 0.1 * max(tone, slow) / noise.rms
    count = int((SETTINGS.phases_of_two if slow and tone else SETTINGS.phases) * max(1.0, few))
    turning = np.exp(1j * math.pi * (np.arange(count) + 0.5) / count)  # both signs of an error are alike
    error = (tone * turning[:, None] * tone_shape(turn, n)).real
    if slow and tone:
        error = (error[:, None, :] + slow * np.append(turning, -turning).imag[None, :, None] * ramp(n)).reshape(-1, n)
    elif slow:
        error = slow * turning.imag[:, None] * ramp(n)
    parts = error @ vectors / math.sqrt(n)
    power = noise.rms**2
    rest = np.mean(error**2, axis=1) - np.sum(parts**2, axis=1) + power * max(0.0, 1.0 - float(values.sum()))
    variances = power * np.concatenate([noise.on_axis * values, (1.0 - noise.on_axis) * values])
    squares = np.hstack([parts**2, np.zeros_like(parts)])
    beyond = _by_saddle_point if noise.rms < SETTINGS.small_noise * max(tone, slow) else _by_contour

    def outside(level: float) -> float:
        left = level**2 - rest
        possible = left > 1e-12 * level**2
        within = beyond(left[possible], variances, squares[possible])
        return 1.0 - float(np.sum(1.0 - within)) / len(rest)

    return outside


def _by_contour(level: FloatArray, variances: FloatArray, squares: FloatArray) -> FloatArray:
    """Probability (m,) that a sum of (c_j + n_j)^2 is beyond a level (m,).

    Parameters
    ----------
    level : (m,)
    variances : (d,) of the independent normal n_j of mean zero
    squares : (m, d) of the c_j
    """
    z, slope = _contour()
    time = np.maximum(level, np.sum(squares, axis=1) + np.sum(variances))[:, None]
    s = z / time
    exponent = s * level[:, None]
    for variance, square in zip(variances, squares.T):
        spread = 1.0 + 2.0 * variance * s
        exponent -= 0.5 * np.log(spread) + square[:, None] * s / spread
    return np.asarray(1.0 - np.sum((np.exp(exponent) / z * slope).imag, axis=1))


def _by_saddle_point(level: FloatArray, variances: FloatArray, squares: FloatArray) -> FloatArray:
    """The same beside small noise (Lugannani and Rice, Advances in Applied Probability 12, 1980)."""
    from scipy import special

    def cumulants(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cumulant generating function of the sum and two derivatives."""
        spread = 1.0 - 2.0 * variances * s[:, None]
        k = np.sum(squares * s[:, None] / spread - 0.5 * np.log(spread), axis=1)
        first = np.sum(variances / spread + squares / spread**2, axis=1)
        return k, first, np.sum(2.0 * (variances / spread) ** 2 + 4.0 * variances * squares / spread**3, axis=1)

    some = variances > 0.0
    variances, squares, count = variances[some], squares[:, some], int(some.sum())
    high: FloatArray = np.full(level.shape, 0.5 / float(variances.max()))
    # There each term of the mean is below its part of the level.
    low = -count / level - np.max(np.sqrt(count * squares / level[:, None]) / variances, axis=1)
    for _ in range(SETTINGS.bisections):
        middle = 0.5 * (low + high)
        above = cumulants(middle)[1] > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    s = low
    k, _, second = cumulants(s)
    w = np.sign(s) * np.sqrt(np.maximum(2.0 * (s * level - k), 0.0))
    u = s * np.sqrt(second)
    near = np.abs(w) < 1e-4  # of the mean, where both terms of the correction grow
    correction = np.where(near, 0.0, 1.0 / np.where(near, 1.0, u) - 1.0 / np.where(near, 1.0, w))
    return np.asarray(special.ndtr(-w) + np.exp(-0.5 * w**2) / math.sqrt(2.0 * math.pi) * correction)


def _contour() -> tuple[ComplexArray, ComplexArray]:
    """Nodes of the contour times the time, and their weights, on its upper half."""
    count = 2 * SETTINGS.nodes
    angle = (2.0 * np.arange(SETTINGS.nodes) + 1.0) * math.pi / count
    tangent = np.tan(0.6407 * angle)
    z = count * (0.5017 * angle / tangent - 0.6122 + 0.2645j * angle)
    slope = 0.5017 / tangent - 0.5017 * 0.6407 * angle / np.sin(0.6407 * angle) ** 2 + 0.2645j
    return z, 2.0 * slope
