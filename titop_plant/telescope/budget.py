"""Budgets of the relative and of the absolute error: tones and sensor noise share a limit.

The limit of the relative error is asked of a part of the windows of 20 ms, whatever made the error; the requirement
says of which part, here 99.7 %. A tone of amplitude a along one axis and Gaussian noise of r rms over both axes (r /
sqrt 2 on each) are at a random phase of the tone outside of a circle of radius L with the probability

    P = mean over phi of Q(L; a |sin phi|, r / sqrt 2),   Q: upper tail of the Rice distribution

:func:`combined_level` is the L with P = 0.3 %. For tones above half of L it is about ``a + 1.7 r``; noise alone has
2.41 r.

Tones are split at :data:`BAND_EDGE`: below it the proof-mass actuators, with their own mode at 5.3 rad/s and a noisy
accelerometer, do nothing for the line of sight; above it they act. The two weights of :func:`band_weight` divide a
requirement at this frequency.

The shares (:func:`error_budget`) are those at which both stages are used: K_FSM is tuned for noise, slow tones and fast
tones, K_PMA for the fast tones that are left. Below the line the sum keeps the limit.

The absolute error has the same rule for the part of its instants, with two shares: noise, and the tone that keeps the
limit beside it. The paper asks its limit of tones alone, and a telescope whose tone takes all of it is above the limit
as soon as sensors are noisy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from titop_plant.telescope.parameters import FIRST_PROBABILITY, Parameters
from titop_plant.telescope.requirements import instant_probability, telescope_requirements, window_probability

if TYPE_CHECKING:  # a recorder needs the shares alone, and no linear algebra
    from lftkit import System

BAND_EDGE = 85.0
"""Frequency [rad/s] between slow and fast tones."""

NOISE, SLOW, FAST_MIRROR, FAST = 0.3, 0.5, 1.9, 0.485
"""Shares of the limit: what K_FSM is tuned for, noise (rms), slow tones, fast tones with the mirror alone; fast tones
with both controllers."""

TOTAL_NOISE = 0.29
"""Share of the noise (rms) with both controllers; the rest is for tones."""

TONE = 0.48958363084749135
"""Share of the amplitude of a tone that keeps the limit beside this noise, :func:`largest_tone` of it: every bag holds
the budget, and the search for this number would take most of the time that a recorder needs to start."""

APE_NOISE = 0.175
"""Share of the limit of the absolute error that noise may take (rms), in both stages with fine control."""

APE_TONE = 0.722186946061277
"""Share of a tone's absolute error beside it, :func:`largest_tone` of that noise, for 99.7 % of the instants."""

MAX_SENSITIVITY, TUNED_SENSITIVITY, TUNED_FORCE_SENSITIVITY = 2.0, 1.95, 1.9
"""Largest singular value of a sensitivity that a design may have, and the ones that K_FSM and K_PMA are tuned for: the
sampled loop has a little more than the design model, at the forces near half of the sampling rate."""

NEGLIGIBLE = 2e-3
"""Noise below this part of a tone is left out: it adds at most 0.3 %, and the distribution is not computable there."""

BAND_ORDER = 4
PHASES = 400


def combined_level(tone: float, noise: float, probability: float) -> float:
    """Radius that a part of the windows keeps with a tone and noise together.

    Parameters
    ----------
    tone : float
        Amplitude of the relative error along one axis.
    noise : float
        Relative error due to noise, rms over both axes; same unit.
    probability : float
        The part, that of a requirement: 0.997 for 99.7 %.

    Returns
    -------
    float
        In the same unit.

    Examples
    --------
    >>> round(combined_level(0.0, 10.0, 0.997), 2), round(combined_level(23.0, 10.0, 0.997), 1)
    (24.1, 40.0)
    """
    if not (tone >= 0.0 and noise >= 0.0):
        raise ValueError(f"tone and noise must not be negative, got {tone} and {noise}")
    if noise <= NEGLIGIBLE * tone:
        return float(tone * np.sin(0.5 * np.pi * probability))
    return _root(lambda level: _outside(level, tone, noise) - (1.0 - probability), tone + 5.0 * noise)


def largest_tone(noise: float, limit: float, probability: float) -> float:
    """Largest amplitude of a tone that keeps `limit` beside `noise` (rms over both axes); 0 if noise alone breaks it.

    Examples
    --------
    >>> [round(largest_tone(noise, 40.0, 0.997)) for noise in (8.0, 10.0, 12.0, 14.0)]
    [27, 23, 19, 14]
    """
    if combined_level(0.0, noise, probability) >= limit:
        return 0.0
    high = 1.01 * limit / np.sin(0.5 * np.pi * probability)
    return _root(lambda tone: combined_level(tone, noise, probability) - limit, high)


def _root(function: Callable[[float], float], high: float) -> float:
    """Root between 0 and `high`, with a tolerance that is small beside it in any unit."""
    from scipy import optimize

    return float(optimize.brentq(function, 0.0, high, xtol=min(2e-12, 1e-12 * high)))


def _outside(level: float, tone: float, noise: float) -> float:
    """Probability of an error beyond `level`."""
    from scipy import stats  # slow to import, and most processes of a run need only the constants of this module

    sigma = noise / np.sqrt(2.0)
    phase = (np.arange(PHASES) + 0.5) * (0.5 * np.pi / PHASES)
    return float(np.mean(stats.ncx2.sf((level / sigma) ** 2, 2, (tone * np.sin(phase) / sigma) ** 2)))


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
        Amplitude of a tone that keeps the limit beside `total_noise`.
    ape_noise, ape_tone : float
        Absolute error by noise (rms of both axes), and by the tone that keeps its limit beside it.
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


def error_budget(parameters: Parameters) -> ErrorBudget:
    """The budget of a telescope: shares of its limits of the relative and of the absolute error.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> budget = error_budget(load_parameters())
    >>> mas = 3.141592653589793 / 648e6
    >>> [round(share / mas, 1) for share in (budget.limit, budget.noise, budget.slow, budget.fast_mirror)]
    [40.0, 12.0, 20.0, 76.0]
    >>> round(combined_level(budget.tone / mas, budget.total_noise / mas, 0.997), 2)
    40.0
    """
    limit = float(parameters["weights"]["rpe_limit_fine"])
    requirements = telescope_requirements(parameters)
    tone = _tone_share(TOTAL_NOISE, TONE, window_probability(requirements))
    relative = (share * limit for share in (NOISE, SLOW, FAST_MIRROR, FAST, TOTAL_NOISE, tone))
    absolute_tone = _tone_share(APE_NOISE, APE_TONE, instant_probability(requirements))
    ape = float(parameters["weights"]["ape_limit"])
    return ErrorBudget(limit, *relative, APE_NOISE * ape, absolute_tone * ape)


def _tone_share(noise: float, known: float, probability: float) -> float:
    """:func:`largest_tone` beside `noise`; `known` is that of the first probability."""
    return known if probability == FIRST_PROBABILITY else largest_tone(noise, 1.0, probability)


def band_error_weight(parameters: Parameters, band: str) -> System:
    """Weight of the relative error of slow or fast tones: window and :func:`band_weight` in series."""
    from lftkit import cascade
    from titop_plant.telescope.weights import relative_error_weight

    relative = relative_error_weight(parameters["weights"]["rpe_window"]).at({})
    return cascade(relative, band_weight(band).at({}), f"W_RPE, {band}")


def band_weight(band: str, size: int = 2) -> System:
    """Butterworth filter of order 4 that keeps the ``slow`` or the ``fast`` tones, on each of `size` axes.

    Examples
    --------
    >>> slow, fast = (band_weight(band, 1).nominal() for band in ("slow", "fast"))
    >>> [round(float(abs(slow(1j * w))), 2) for w in (10, 60, 145)]
    [1.0, 0.97, 0.12]
    >>> [round(float(abs(fast(1j * w))), 2) for w in (60, 145, 400)]
    [0.24, 0.99, 1.0]
    """
    if band not in ("slow", "fast"):
        raise ValueError(f"band must be slow or fast, got {band!r}")
    from scipy import signal

    from lftkit import Port, state_space

    denominator = np.poly(signal.butter(BAND_ORDER, 1.0, analog=True, output="zpk")[1]).real
    A = np.diag(np.full(BAND_ORDER - 1, BAND_EDGE), -1)
    A[0] = -BAND_EDGE * denominator[1:]
    B = np.eye(BAND_ORDER)[:, :1] * BAND_EDGE
    C, D = (np.eye(BAND_ORDER)[-1:], 0.0) if band == "slow" else (A[:1] / BAND_EDGE, 1.0)
    each = np.eye(size)
    ports = [Port("relative_error", size)], [Port(f"{band}_error", size)]
    return state_space(np.kron(each, A), np.kron(each, B), np.kron(each, C), D * each, *ports)
