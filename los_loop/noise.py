"""Sensor noise in the line of sight of the implemented loop: covariances, and their correlation over time.

The loop is periodic, so that the covariance of the line of sight differs from tick to tick of a period; all that is
given here is the mean over a period. A covariance of a loop that is not stable is infinite.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System
from lftkit.arrays import FloatArray
from lftkit.systems.sampling import sampled
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import SampledLoop
from pointing_analysis.indices.window_rows import window_rows, window_starts
from titop_plant.interface import DT, PLATFORM
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import relative_error_weight
from titop_plant.telescope.window_noise import ON_AXIS, WindowNoise

PLACES = 10
"""Places for each tick of a window that is no whole number of ticks."""


def noise_covariances(
    plant: System,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    telescope: Telescope,
    *,
    loop: str,
    sensors: str | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Covariances (2, 2) of the line of sight due to sensor noise [rad^2]: plain and as relative error.

    The arguments are those of :func:`los_loop.sampled_loop_norms.sampled_loop_metrics`: the plant has the ports of the
    telescope that the controllers use. Infinite if the loop is unstable.
    """
    sensitivity, ports = telescope.fsm.los_sensitivity, telescope.loop_ports.used_by(k_fsm, k_pma)
    closed = sampled_loop(plant, ControlLaws(k_fsm, k_pma, loop, ports, sensitivity))
    if closed.spectral_radius() < 1.0:
        return covariances(closed, telescope, sensors)
    return np.diag([np.inf, np.inf]), np.diag([np.inf, np.inf])


def noise_rms(covariances: tuple[FloatArray, FloatArray]) -> tuple[float, float]:
    """Root mean squares [rad, both axes] of :func:`noise_covariances`."""
    plain, relative = (float(np.sqrt(max(np.trace(covariance), 0.0))) for covariance in covariances)
    return plain, relative


def loop_noise(
    plant: System, k_fsm: SampledSystem, k_pma: SampledSystem, telescope: Telescope, *, loop: str
) -> tuple[WindowNoise, WindowNoise]:
    """Noise of the line of sight [rad] at its instants, and as relative error in the windows of the requirements.

    The arguments are those of :func:`noise_covariances`. The part on the axis of a tone is the largest along any axis,
    and that of the budgets at least. The root mean squares are infinite if the loop is unstable.
    """
    sensitivity, ports = telescope.fsm.los_sensitivity, telescope.loop_ports.used_by(k_fsm, k_pma)
    closed = sampled_loop(plant, ControlLaws(k_fsm, k_pma, loop, ports, sensitivity))
    if closed.spectral_radius() >= 1.0:
        return WindowNoise(np.inf), WindowNoise(np.inf)
    both = covariances(closed, telescope, None)
    (plain, relative), parts = noise_rms(both), [max(ON_AXIS, largest_part(one)) for one in both]
    table = window_covariance(correlation(closed, ports.noise[: closed.noise_hold.shape[1]]), telescope)
    return WindowNoise(plain, parts[0]), WindowNoise(relative, parts[1], table)


def largest_part(covariance: FloatArray) -> float:
    """Largest part of a power that is along one axis: of a covariance (2, 2); NaN without a power.

    Examples
    --------
    >>> round(largest_part(np.array([[2.0, 1.0], [1.0, 2.0]])), 3)
    0.75
    """
    total = float(np.trace(covariance))
    return float(linalg.eigvalsh(covariance)[-1]) / total if np.isfinite(total) and total > 0.0 else np.nan


def covariances(loop: SampledLoop, telescope: Telescope, sensors: str | None) -> tuple[FloatArray, FloatArray]:
    """Covariances (2, 2) of the line of sight of a stable loop [rad^2], plain and with the relative-error weight.

    Parameters
    ----------
    loop : SampledLoop
    telescope : Telescope
        Window of the relative error.
    sensors : {None, "platform"}
        Noise of all sensors, or of the accelerometers of the payload base only.
    """
    sigma = loop.ports.noise
    if sensors == "platform":  # the paper's figure
        sigma[~np.isin(np.arange(sigma.size), np.arange(sigma.size)[PLATFORM])] = 0.0
    w = sampled(relative_error_weight(telescope.weights.rpe_window), DT)
    n, m = loop.hold.shape[0], w.order

    def extended(A: FloatArray, N: FloatArray) -> tuple[FloatArray, FloatArray]:
        whole = np.block([[A, np.zeros((n, m))], [w.B @ loop.truth, w.A]])
        drive = np.vstack([N * sigma, np.zeros((m, sigma.size))])
        return whole, drive @ drive.T

    outputs = (
        np.hstack([loop.truth, np.zeros((2, m))]),
        np.hstack([w.D @ loop.truth, w.C]),
    )
    ticks = loop.each_tick(extended)
    power = np.zeros((2, 2, 2))
    for P in periodic_covariances(ticks):
        power += [C @ P @ C.T for C in outputs]
    plain, relative = power / len(ticks)
    return plain, relative


def periodic_covariances(ticks: Sequence[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
    """Covariance of the state before each tick of a period, in the steady state.

    Parameters
    ----------
    ticks : sequence of (ndarray, ndarray)
        Matrix A of each tick and covariance Q of the noise it adds, shape (n, n); stable over the period.
    """
    size = len(ticks[0][0])
    period: FloatArray = np.eye(size)
    added: FloatArray = np.zeros((size, size))
    for A, Q in ticks:
        period, added = A @ period, A @ added @ A.T + Q
    found = [np.asarray(linalg.solve_discrete_lyapunov(period, added), dtype=float)]
    for A, Q in ticks[:-1]:
        found.append(A @ found[-1] @ A.T + Q)
    return found


def correlation(loop: SampledLoop, sigma: FloatArray, unit: float = 1.0) -> Callable[[int], FloatArray]:
    """Covariance (2, 2) of the line of sight with itself some ticks later, a function of these, of a stable loop.

    Parameters
    ----------
    loop : SampledLoop
    sigma : ndarray, shape (22,)
        Standard deviation of a sample of each measured value.
    unit : float
        Unit of the line of sight [rad].
    """
    ticks = loop.each_tick(lambda A, N: (A, (N * sigma) @ (N * sigma).T))
    start = [P @ loop.truth.T for P in periodic_covariances(ticks)]
    C = loop.truth / unit**2

    @cache
    def carried(lag: int) -> tuple[FloatArray, ...]:
        if lag == 0:
            return tuple(start)
        before = carried(lag - 1)
        # The state that began at phase k has reached phase k + lag - 1.
        return tuple(ticks[(k + lag - 1) % len(ticks)][0] @ state for k, state in enumerate(before))

    def at(lag: int) -> FloatArray:
        for step in range(lag):
            carried(step)
        return np.asarray(np.mean([C @ state for state in carried(lag)], axis=0))

    return at


def window_covariance(correlated: Callable[[int], FloatArray], telescope: Telescope) -> FloatArray:
    """Covariance (n, n) between the ticks of a window of the line of sight less its mean there, the sum over both axes.

    Parameters
    ----------
    correlated : callable
        Of :func:`correlation`.
    telescope : Telescope
        Its window of the relative error, in whole ticks.
    """
    n = max(round(telescope.weights.rpe_window / DT), 2)
    table = linalg.toeplitz([float(np.trace(correlated(lag))) for lag in range(n)])
    rest = np.eye(n) - 1.0 / n
    return np.asarray(rest @ table @ rest)


def covariances_in_window(correlated: Callable[[int], FloatArray], ticks: float) -> FloatArray:
    """Covariance of the line of sight less its mean over a window, at places of equal shares of it: (places, 2, 2).

    The places are the window's ticks. Of a window that is no whole number of ticks they are those of one window after
    the other (:func:`pointing_analysis.indices.window_rows.window_starts`).

    Parameters
    ----------
    correlated : callable
        Of :func:`correlation`.
    ticks : float
        Length of the window.
    """
    starts = window_starts(ticks)
    index, weights = window_rows(starts, ticks)
    count = index.shape[1]
    lags = [correlated(lag) for lag in range(count)]
    table = np.array([[lags[j - i] if j >= i else lags[i - j].T for j in range(count)] for i in range(count)])
    places = round(ticks) if len(starts) == 1 else round(PLACES * ticks)
    found = []
    for start, weight in zip(starts, weights / ticks):
        mean = np.einsum("j,ijab->iab", weight, table)
        whole = np.einsum("i,iab->ab", weight, mean)
        here = np.floor(start + (np.arange(places) + 0.5) * ticks / places).astype(int)
        found += [table[i, i] - mean[i] - mean[i].T + whole for i in here]
    return np.stack(found)


__all__ = [
    "correlation",
    "covariances",
    "covariances_in_window",
    "largest_part",
    "loop_noise",
    "noise_covariances",
    "noise_rms",
    "periodic_covariances",
    "window_covariance",
]
