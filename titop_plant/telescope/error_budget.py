"""Budgets of the relative and of the absolute error: tones and sensor noise share a limit.

The limit of the relative error is asked of the rms of a part of the windows of 20 ms, whatever made the error; the
requirement says of which part, here 99.7 %. A tone that is slow beside a window, and nearly all of the noise, are ramps
in a window: with the tone's phase phi random, its rms is that of the vector (a sin phi + n1, n2). a is the amplitude
(that of the weighted tone, which is the rms over all windows times the square root of two), n1 and n2 are Gaussian: the
noise on the axis of the tone and across. A faster tone turns by omega T in a window of T. Its rms there,

    rho(phi)^2 = a^2 (1 + q cos 2 phi) / 2,    q = (sinc(x)^2 - sinc(2 x)) / (1 - sinc(x)^2),  x = omega T / 2

hardly depends on its phase, and only the part that is a ramp adds up with the noise: p(phi) = a P cos phi,
P = sqrt(3) (sinc(x) - cos(x)) / (x sqrt(1 - sinc(x)^2)). The level L with which a part of the windows is within

    (p(phi) + n1)^2 + n2^2 <= L^2 - rho(phi)^2 + p(phi)^2

is :func:`combined_level`. The instants of the absolute error have that of a slow tone. Noise has no reason to be the
same on both axes; the budget assumes :data:`ON_AXIS`, and a verification takes what it is if that is more.

Tones are split at the edge of the bands (``weights.band_edge``): below it the proof-mass actuators, with their own mode
at 5.3 rad/s and a noisy accelerometer, do nothing for the line of sight; above it they act. The two weights of
:func:`titop_plant.telescope.weights.band_weight` divide a requirement at this frequency.

The shares (:func:`error_budget`) are those at which both stages are used: K_FSM is tuned for noise, slow tones and fast
tones, K_PMA for the fast tones that are left. Below the line the sum is within the limit.

The absolute error has the same rule for the part of its instants, with two shares: noise, and the tone that keeps the
limit beside it. The paper asks its limit of tones alone, and a telescope whose tone takes all of it is above the limit
as soon as sensors are noisy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from lftkit.errors import InputError
from titop_plant.telescope.requirements import instant_probability, window_probability
from titop_plant.telescope.telescope import FIRST_PROBABILITY, Telescope

if TYPE_CHECKING:  # a recorder needs the shares alone, and no linear algebra
    from lftkit.arrays import FloatArray

NOISE, SLOW, FAST_MIRROR, FAST = 0.3, 1.5, 2.2, 0.5
"""Shares of the limit: what K_FSM is tuned for, noise (rms), slow tones, fast tones with the mirror alone; fast tones
with both controllers."""

MOST_ALONE = 0.97
"""Part of the limit of the mirror alone that the last two of K_FSM's shares take at most: a telescope whose limits with
and without proof-mass actuators are closer than the reference's is tuned for what it is verified by."""

TOTAL_NOISE = 0.265
"""Share of the noise (rms) with both controllers; the rest is for tones."""

TONE = 0.464
"""Share of the amplitude of a slow tone that is within the limit beside this noise, :func:`largest_tone` to 4 digits:
every bag holds the budget, and the search would take most of the time that a recorder needs to start."""

APE_NOISE = 0.138
"""Share of the limit of the absolute error that noise may take (rms), in both stages with fine control."""

APE_TONE = 0.7485
"""Share of a tone's absolute error beside it, :func:`largest_tone` of that noise for 99.7 % of the instants."""

ON_AXIS, ABSOLUTE_ON_AXIS = 0.7, 0.7
"""Part of the noise's power that the budgets of the relative and of the absolute error put on the axis of the tone."""

MAX_SENSITIVITY, TUNED_SENSITIVITY, TUNED_FORCE_SENSITIVITY = 2.0, 1.95, 1.9
"""Largest singular value of a sensitivity that a design may have, and the ones that K_FSM and K_PMA are tuned for: the
sampled loop has a little more than the design model, at the forces near half of the sampling rate."""

NEGLIGIBLE = 2e-3
"""Noise below this part of a tone counts as this part of it: the distribution is not computable below, and a level is
never less than what is kept.
"""

SLOW_TURN = 1e-2
"""Half of a turn in a window below which a tone is a ramp there; the difference is of its square."""

PHASES = 64
"""Of a tone beside at least a tenth of it as noise; beside less, more of them in proportion."""
PHASES_OF_TWO = 16
"""Of each of two tones beside at least two fifths of them as noise; with twice as many a level changes by 1e-12."""
LEAST_ON_AXIS = 0.1
NODES = 40
"""Of the integral over the noise across the axis of the tone (Gauss and Legendre)."""
REACH = 8.5
"""Standard deviations of that noise that the integral has."""


def combined_level(
    tone: float, noise: float, probability: float, on_axis: float = ON_AXIS, turn: float = 0.0, least: float = 0.0
) -> float:
    """Level that a part of the windows (or instants) keeps with a tone and noise together.

    Parameters
    ----------
    tone : float
        Amplitude of the weighted relative error along one axis, or of the absolute error.
    noise : float
        Error due to noise, rms over both axes; same unit.
    probability : float
        The part, that of a requirement: 0.997 for 99.7 %.
    on_axis : float
        Part of the noise's power that is on the axis of the tone, 0.1 to 1.
    turn : float
        Angle that the tone turns in a window [rad], omega T; 0: of a slow tone, or of instants.
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
    >>> round(combined_level(0.0, 10.0, 0.997, on_axis=0.5), 2), round(combined_level(17.0, 11.0, 0.997), 1)
    (24.1, 39.5)
    >>> round(combined_level(17.0, 11.0, 0.997, turn=8.0), 1)
    31.3
    """
    if not (tone >= 0.0 and noise >= 0.0 and turn >= 0.0):
        raise InputError(f"tone, noise and turn must not be negative, got {tone}, {noise} and {turn}")
    if not LEAST_ON_AXIS <= on_axis <= 1.0:
        raise InputError(f"on_axis must be from {LEAST_ON_AXIS:g} to 1, got {on_axis}")
    if noise <= NEGLIGIBLE * tone:
        modulation, _ = _in_window(turn)
        least = max(least, float(tone * np.sqrt(0.5 * (1.0 - abs(modulation) * np.cos(np.pi * probability)))))
        if not noise:
            return least
    noise = max(noise, NEGLIGIBLE * tone)
    window = partial(_outside, tone=tone, noise=noise, on_axis=on_axis, turn=turn)
    if least > 0.0 and window(least) <= 1.0 - probability:
        return least
    return _root(lambda level: window(level) - (1.0 - probability), 1.5 * tone + 5.0 * noise)


def two_tone_level(
    slow: float, fast: float, noise: float, probability: float, on_axis: float = ON_AXIS, turn: float = 0.0
) -> float:
    """Level that a part of the windows keeps with a slow tone, a fast one and noise at once.

    The slow tone is a ramp in a window, on the axis of the fast one; the phases of both are random and independent.

    Parameters
    ----------
    slow, fast : float
        Amplitudes of the weighted relative error.
    noise, probability, on_axis
        As for :func:`combined_level`.
    turn : float
        Angle that the fast tone turns in a window [rad].

    Examples
    --------
    >>> round(two_tone_level(17.0, 0.0, 11.0, 0.997), 1), round(two_tone_level(0.0, 17.0, 11.0, 0.997, turn=8.0), 1)
    (39.5, 31.3)
    >>> round(two_tone_level(12.0, 12.0, 11.0, 0.997), 1)  # of norm 17 in all, with independent phases
    41.9
    """
    if not (slow >= 0.0 and fast >= 0.0 and noise >= 0.0 and turn >= 0.0):
        raise InputError(f"tones, noise and turn must not be negative, got {slow}, {fast}, {noise} and {turn}")
    noise = max(noise, NEGLIGIBLE * max(slow, fast))
    outside = partial(_outside, tone=fast, noise=noise, on_axis=on_axis, turn=turn, slow=slow)
    return _root(lambda level: outside(level) - (1.0 - probability), 1.5 * (slow + fast) + 5.0 * noise)


def largest_tone(noise: float, limit: float, probability: float, on_axis: float = ON_AXIS) -> float:
    """Largest amplitude of a slow tone that keeps `limit` beside `noise` (rms over both axes); 0 if noise breaks it.

    Examples
    --------
    >>> [round(largest_tone(noise, 40.0, 0.997)) for noise in (8.0, 10.0, 12.0, 14.0)]
    [25, 20, 15, 9]
    >>> round(combined_level(largest_tone(11.0, 40.0, 0.6), 11.0, 0.6), 9)
    40.0
    """
    if combined_level(0.0, noise, probability, on_axis) >= limit:
        return 0.0
    high = 1.01 * limit / np.sin(0.5 * np.pi * probability)
    while combined_level(high, noise, probability, on_axis) < limit:  # noise can help at a small probability
        high *= 2.0
    return _root(lambda tone: combined_level(tone, noise, probability, on_axis) - limit, high)


def _root(function: Callable[[float], float], high: float) -> float:
    """Root between 0 and `high`, with a tolerance that is small beside it in any unit."""
    from scipy import optimize

    return float(optimize.brentq(function, 0.0, high, xtol=min(2e-12, 1e-12 * high)))


def _in_window(turn: float) -> tuple[float, float]:
    """Modulation q of the mean square of a tone in a window by its phase, and its part P that is a ramp."""
    x = 0.5 * turn
    if x < SLOW_TURN:
        return 1.0, 1.0
    mean, twice = np.sin(x) / x, np.sin(2.0 * x) / (2.0 * x)
    spread = 1.0 - mean**2
    return float((mean**2 - twice) / spread), float(np.sqrt(3.0) * (mean - np.cos(x)) / (x * np.sqrt(spread)))


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return np.asarray(nodes), np.asarray(weights)


def _outside(level: float, tone: float, noise: float, on_axis: float, turn: float, slow: float = 0.0) -> float:
    """Probability of an error beyond `level`; `slow` is another tone, a ramp in the window."""
    if level <= 0.0:
        return 1.0
    from scipy import special  # slow to import, and most processes of a run need only the constants of this module

    along, across = noise * np.sqrt(on_axis), noise * max(np.sqrt(1.0 - on_axis), 1e-6)
    least, share = (PHASES_OF_TWO, 0.4) if slow else (PHASES, 0.1)
    count = int(least * max(1.0, share * max(tone, slow) / noise))
    phase = (np.arange(count) + 0.5) * (0.5 * np.pi / count)
    modulation, ramp = _in_window(turn)
    slope = slow * np.cos(phase)[:, None] if slow else np.zeros((1, 1))
    phase = 2.0 * phase if slow else phase  # signs beside each other count: of both tones only the common one does not
    shift = tone * ramp * np.cos(phase)
    left = level**2 - 0.5 * tone**2 * (1.0 + modulation * np.cos(2.0 * phase)) + shift**2
    shift, left = (slope + shift).ravel(), np.broadcast_to(left, (len(slope), count)).ravel()
    radius = np.sqrt(np.maximum(left, (1e-9 * level) ** 2))[:, None]
    nodes, weights = _nodes()
    angle = np.arcsin(np.minimum(1.0, REACH * across / radius))
    y, half = radius * np.sin(angle * nodes), radius * np.cos(angle * nodes)
    density = np.exp(-0.5 * (y / across) ** 2) / (across * np.sqrt(2.0 * np.pi))
    within = special.ndtr((half - shift[:, None]) / along) - special.ndtr((-half - shift[:, None]) / along)
    inside = np.sum(weights * angle * half * density * within, axis=1)
    return float(np.mean(np.where(left > 0.0, 1.0 - inside, 1.0)))


@dataclass(frozen=True)
class ErrorBudget:
    """Shares of the relative and of the absolute error [rad].

    Parameters
    ----------
    limit : float
        Relative error of the part of the windows that the requirement names, noise and tones together.
    noise, slow, fast_mirror : float
        What K_FSM is tuned for: noise (rms of both axes), amplitudes of slow and of fast tones, mirror alone.
    fast : float
        Fast tones that K_PMA is tuned for.
    total_noise : float
        Noise with both controllers.
    tone : float
        Largest amplitude of a tone within the limit beside `total_noise`.
    ape_noise, ape_tone : float
        Absolute error by noise (rms of both axes), and by the tone that is within its limit beside it.
    """

    limit: float
    noise: float
    slow: float
    fast_mirror: float
    fast: float
    total_noise: float
    tone: float
    ape_noise: float
    ape_tone: float


def error_budget(telescope: Telescope) -> ErrorBudget:
    """The budget of a telescope: shares of its limits of the relative and of the absolute error.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> budget = error_budget(load_telescope())
    >>> mas = 3.141592653589793 / 648e6
    >>> [round(share / mas, 1) for share in (budget.limit, budget.noise, budget.slow, budget.fast_mirror)]
    [40.0, 12.0, 60.0, 88.0]
    >>> round(combined_level(budget.tone / mas, budget.total_noise / mas, 0.997), 1)
    40.0
    """
    limit = telescope.weights.rpe_limit_fine
    requirements = telescope.requirements
    tone = _tone_share(TOTAL_NOISE, TONE, window_probability(requirements), ON_AXIS)
    absolute_tone = _tone_share(APE_NOISE, APE_TONE, instant_probability(requirements), ABSOLUTE_ON_AXIS)
    ape = telescope.weights.ape_limit
    alone = MOST_ALONE * telescope.weights.rpe_limit
    return ErrorBudget(
        limit=limit,
        noise=NOISE * limit,
        slow=min(SLOW * limit, alone),
        fast_mirror=min(FAST_MIRROR * limit, alone),
        fast=FAST * limit,
        total_noise=TOTAL_NOISE * limit,
        tone=tone * limit,
        ape_noise=APE_NOISE * ape,
        ape_tone=absolute_tone * ape,
    )


@cache
def _tone_share(noise: float, known: float, probability: float, on_axis: float) -> float:
    """:func:`largest_tone` beside `noise`; `known` is that of the first probability."""
    return known if probability == FIRST_PROBABILITY else largest_tone(noise, 1.0, probability, on_axis)


def band_edge(telescope: Telescope) -> float:
    """Frequency between slow and fast tones [rad/s]."""
    return telescope.weights.band_edge
