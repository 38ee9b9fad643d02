"""Synthesis weights of the fine control: expected disturbances in, pointing errors out.

``W_rws`` shapes the amplitude of each wheel's imbalance, ``W_sa`` bounds the drives' torque, ``W_RPE`` is the rational
high-pass of a relative performance error over a window. Source: the paper, "Hybrid control of LOS with FSM".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lftkit import Port, System, cascade, state_space
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.telescope.telescope import Telescope


def disturbance_weight(telescope: Telescope) -> System:
    """From normalised disturbances to wheel imbalance [N, Nm] and SADM torque [Nm]; a state for each imbalance.

    For the reference telescope 22 disturbances: 20 of four wheels, 2 of the drives.

    Examples
    --------
    The amplitude is 0.4 N at high frequency and nearly zero at low frequency:

    >>> from titop_plant.telescope.load import load_telescope
    >>> W = disturbance_weight(load_telescope()).nominal()
    >>> round(abs(complex(W(1e4j)[0, 0])), 3), round(abs(complex(W(0)[0, 0])), 6)
    (0.4, 4e-06)
    """
    table = telescope.weights
    zero, pole = table.wheel_imbalance_zero, table.wheel_imbalance_pole
    size, bounds = np.tile(table.wheel_imbalance, len(telescope.turning_wheels)), telescope.torque_bounds
    n, m = size.size, size.size + bounds.size
    D = np.diag(np.r_[size, bounds])
    B = np.hstack([np.eye(n), np.zeros((n, bounds.size))])
    C = np.vstack([np.diag(size) * (zero - pole), np.zeros((bounds.size, n))])
    return state_space(-pole * np.eye(n), B, C, D, [Port("normalised", m)], [Port("disturbance", m)])


def weight_amplitudes(telescope: Telescope, omega: ArrayLike) -> FloatArray:
    """Amplitudes |W_rws|, W_sa of the disturbance inputs at frequencies omega [rad/s], shape (k, channels)."""
    table = telescope.weights
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    high_pass = np.hypot(w, table.wheel_imbalance_zero) / np.hypot(w, table.wheel_imbalance_pole)
    wheels = high_pass[:, None] * np.tile(table.wheel_imbalance, len(telescope.turning_wheels))
    return np.hstack([wheels, np.tile(telescope.torque_bounds, (w.size, 1))])


RPE_NUMERATOR, RPE_DENOMINATOR = np.sqrt(12.0), (6.0, 12.0)
"""Coefficients b1, (a1, a0) of the weight of a relative performance error: y (y + b1) / (y^2 + a1 y + a0), y = s t."""


def rpe_weight(omega: ArrayLike, window: float) -> FloatArray:
    """Magnitude of the weight of a relative performance error over `window` [s] at `omega` [rad/s].

    Examples
    --------
    >>> round(float(rpe_weight(2.0 * np.pi * 10.0, 0.02)), 6)
    0.360016
    """
    y = 1j * np.asarray(omega, dtype=float) * window
    a1, a0 = RPE_DENOMINATOR
    return np.asarray(np.abs(y * (y + RPE_NUMERATOR) / (y**2 + a1 * y + a0)))


def window_ratio(turn: ArrayLike) -> FloatArray:
    """Rms of a tone's relative error in windows over that of the rational weight; it turns so far [rad] in a window.

    The weight is a fit of the paper, from 2.6 % above the error of the windows to 4.5 % below it.

    Examples
    --------
    >>> [round(float(window_ratio(turn)), 3) for turn in (0.0, 2.0, 5.3, 60.0)]
    [1.0, 0.974, 1.045, 0.999]
    """
    from pointing_analysis.indices.weights import rpe_exact

    turns = np.maximum(turn, 1e-9)  # both vanish with the turn
    return np.asarray(rpe_exact(turns, 1.0) / rpe_weight(turns, 1.0))


def relative_error_weight(window: float, size: int = 2) -> System:
    """:func:`rpe_weight` as a system, ``s t (s t + sqrt 12) / ((s t)^2 + 6 s t + 12)`` on each axis; 2 states per axis.

    Examples
    --------
    >>> W = relative_error_weight(0.02, 1).nominal()
    >>> round(float(abs(W(2j * np.pi * 10.0))), 6)
    0.360016
    """
    if not window > 0.0:
        raise InputError(f"window must be positive, got {window} s")
    a1, a0, b1 = RPE_DENOMINATOR[0] / window, RPE_DENOMINATOR[1] / window**2, RPE_NUMERATOR / window
    each = np.eye(size)
    return state_space(
        np.kron(each, [[0.0, 1.0], [-a0, -a1]]),
        np.kron(each, [[0.0], [1.0]]),
        np.kron(each, [[-a0, b1 - a1]]),
        each,
        [Port("error", size)],
        [Port("relative_error", size)],
    )


BAND_ORDER = 4


def band_error_weight(telescope: Telescope, band: str) -> System:
    """Weight of the relative error of slow or fast tones: window and :func:`band_weight` in series."""
    relative = relative_error_weight(telescope.weights.rpe_window).at({})
    return cascade(relative, band_weight(band, telescope.weights.band_edge).at({}), f"W_RPE, {band}")


def band_weight(band: str, edge: float, size: int = 2) -> System:
    """Butterworth filter of order 4 that keeps the tones below (``slow``) or above an edge [rad/s], on `size` axes.

    Examples
    --------
    >>> slow, fast = (band_weight(band, 85.0, 1).nominal() for band in ("slow", "fast"))
    >>> [round(float(abs(slow(1j * w))), 2) for w in (10, 60, 145)]
    [1.0, 0.97, 0.12]
    >>> [round(float(abs(fast(1j * w))), 2) for w in (60, 145, 400)]
    [0.24, 0.99, 1.0]
    """
    if band not in ("slow", "fast"):
        raise InputError(f"band must be slow or fast, got {band!r}")
    from scipy import signal  # slow to import, and disturbances in time need none of it

    denominator = np.poly(signal.butter(BAND_ORDER, 1.0, analog=True, output="zpk")[1]).real
    A = np.diag(np.full(BAND_ORDER - 1, edge), -1)
    A[0] = -edge * denominator[1:]
    B = np.eye(BAND_ORDER)[:, :1] * edge
    C, D = (np.eye(BAND_ORDER)[-1:], 0.0) if band == "slow" else (A[:1] / edge, 1.0)
    each = np.eye(size)
    ports = [Port("relative_error", size)], [Port(f"{band}_error", size)]
    return state_space(np.kron(each, A), np.kron(each, B), np.kron(each, C), D * each, *ports)
