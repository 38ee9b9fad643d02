"""Lines of a waterfall (amplitude over speed and frequency) at one speed, interpolated along the orders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray

ABOVE = 3.0
"""A line is so many times as high as the median around it."""
AROUND = 15
"""Bins on each side of a line that the median is of."""


def lines_at(
    speed: float, speeds: FloatArray, frequency: FloatArray, amplitude: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Frequencies and amplitudes of the lines at a speed.

    Amplitudes are interpolated between the two measured speeds at equal order (frequency over speed), so that a
    harmonic goes over into itself and does not become two lines.

    Parameters
    ----------
    speed : float
        Hz; between the lowest and the highest of `speeds`.
    speeds : ndarray, shape (s,)
        Hz, ascending.
    frequency : ndarray, shape (f,)
        Hz, ascending.
    amplitude : ndarray, shape (s, f, 6)
        N, Nm.

    Returns
    -------
    frequency : ndarray, shape (q,)
        Hz.
    amplitude : ndarray, shape (q, 6)

    Raises
    ------
    ValueError
        A speed outside of the table, or no line.
    """
    if not speeds[0] <= speed <= speeds[-1]:
        raise ValueError(
            f"speed must be between {speeds[0]:g} and {speeds[-1]:g} Hz of the waterfall, got {speed:g} Hz"
        )
    right = min(max(int(np.searchsorted(speeds, speed)), 1), speeds.size - 1)
    share = (speed - speeds[right - 1]) / (speeds[right] - speeds[right - 1])
    order = frequency / speed
    level = np.zeros((frequency.size, amplitude.shape[2]))
    for i, part in ((right - 1, 1.0 - share), (right, share)):
        for axis in range(level.shape[1]):
            level[:, axis] += part * np.interp(order * speeds[i], frequency, amplitude[i, :, axis], right=0.0)
    chosen = _lines(np.sqrt(np.square(level).sum(axis=1)))
    if not chosen.size:
        raise ValueError(f"waterfall must have lines {ABOVE:g} times above what is around them, got none")
    return frequency[chosen], level[chosen]


def _lines(height: FloatArray) -> NDArray[np.int64]:
    inner = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    floor = np.array([np.median(height[max(i - AROUND, 0) : i + AROUND + 1]) for i in inner])
    return inner[height[inner] > ABOVE * floor]
