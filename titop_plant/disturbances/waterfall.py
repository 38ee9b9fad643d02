"""Lines of a waterfall (amplitude over speed and frequency) at one speed, interpolated along the orders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray

ABOVE = 3.0
"""A line is so many times as high as the median around it."""
SAME = 1.5
"""Lines of two speeds whose orders differ by so many bins of frequency are the same."""
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
    left, bins = right - 1, frequency[1] - frequency[0]
    at = [_lines(_height(amplitude[i])) for i in (left, right)]
    first, second = ((frequency[k], amplitude[i, k]) for i, k in zip((left, right), at))
    rows = _matched(first, second, share, float(bins), speeds[left : right + 1])
    if not rows:
        raise ValueError(f"waterfall must have lines {ABOVE:g} times above their surroundings, got none")
    orders, levels = zip(*sorted(rows, key=lambda row: row[0]))
    return speed * np.array(orders), np.array(levels)


def _height(amplitude: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.square(amplitude).sum(axis=1)))


def _matched(
    first: tuple[FloatArray, FloatArray],
    second: tuple[FloatArray, FloatArray],
    share: float,
    bins: float,
    speeds: FloatArray,
) -> list[tuple[float, FloatArray]]:
    """Order and amplitudes of the lines between two speeds; one without a partner of the same order fades out."""
    orders = [found[0] / at for found, at in zip((first, second), speeds)]
    within, free = SAME * bins / speeds[0], set(range(orders[1].size))
    rows = []
    for order, level in zip(orders[0], first[1]):
        near = min(free, key=lambda j: abs(orders[1][j] - order), default=None)
        if near is None or abs(orders[1][near] - order) > within:
            rows.append((float(order), (1.0 - share) * level))
            continue
        free.remove(near)
        between = (1.0 - share) * order + share * orders[1][near]
        rows.append((float(between), (1.0 - share) * level + share * second[1][near]))
    return rows + [(float(orders[1][j]), share * second[1][j]) for j in sorted(free)]


def _lines(height: FloatArray) -> NDArray[np.int64]:
    inner = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    floor = np.array([np.median(height[max(i - AROUND, 0) : i + AROUND + 1]) for i in inner])
    return inner[height[inner] > ABOVE * floor]
