"""Budgets of the relative and of the absolute error: tones and sensor noise share a limit.

The limit of the relative error is asked of the rms of a part of the windows of 20 ms, whatever made the error; the
requirement says of which part, here 99.7 %. What tones and noise make together is
:func:`titop_plant.telescope.window_noise.combined_level`. Noise has no reason to be the same on both axes; the budget
assumes :data:`titop_plant.telescope.window_noise.ON_AXIS`, and a verification takes what it is if that is more.

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

from dataclasses import dataclass
from functools import cache

import numpy as np

from titop_plant.telescope.requirements import instant_probability, window_probability
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.window_noise import combined_level

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

MAX_SENSITIVITY, TUNED_SENSITIVITY, TUNED_FORCE_SENSITIVITY = 2.0, 1.95, 1.9
"""Largest singular value of a sensitivity that a design may have, and the ones that K_FSM and K_PMA are tuned for: the
sampled loop has a little more than the design model, at the forces near half of the sampling rate."""


def largest_tone(noise: float, limit: float, probability: float) -> float:
    """Largest amplitude of a slow tone that keeps `limit` beside `noise` (rms over both axes); 0 if noise breaks it.

    Examples
    --------
    >>> [round(largest_tone(noise, 40.0, 0.997)) for noise in (8.0, 10.0, 12.0, 14.0)]
    [25, 20, 15, 9]
    >>> round(combined_level(largest_tone(11.0, 40.0, 0.6), 11.0, 0.6), 6)
    40.0
    """
    from scipy import optimize

    if combined_level(0.0, noise, probability) >= limit:
        return 0.0
    high = 1.01 * limit / np.sin(0.5 * np.pi * probability)
    while combined_level(high, noise, probability) < limit:  # noise can help at a small probability
        high *= 2.0

    def excess(tone: float) -> float:
        return combined_level(tone, noise, probability) - limit

    return float(optimize.brentq(excess, 0.0, high, xtol=min(2e-12, 1e-12 * high)))


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
    tone = _tone_share(TOTAL_NOISE, TONE, window_probability(requirements))
    absolute_tone = _tone_share(APE_NOISE, APE_TONE, instant_probability(requirements))
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
def _tone_share(noise: float, known: float, probability: float) -> float:
    """:func:`largest_tone` beside `noise`; `known` is that of the probability of the reference."""
    return known if probability == 0.997 else largest_tone(noise, 1.0, probability)


def band_edge(telescope: Telescope) -> float:
    """Frequency between slow and fast tones [rad/s]."""
    return telescope.weights.band_edge
