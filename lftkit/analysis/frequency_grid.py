"""Frequency grids: of a response, which resolves lightly damped resonances, and of equal steps of the logarithm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError


def pole_range(poles: ArrayLike, *, zero: float = 1e-9) -> tuple[float, float]:
    """Smallest and largest magnitude of poles [rad/s] but those at zero; (1, 1) without any.

    Parameters
    ----------
    poles : array_like
        Eigenvalues [rad/s].
    zero : float
        Magnitude, over the largest one, up to which a pole counts as one at zero.

    Examples
    --------
    >>> pole_range([0.0, -0.5, -2.0 + 1.5j, -2.0 - 1.5j])
    (0.5, 2.5)
    """
    size = np.abs(np.ravel(np.asarray(poles, dtype=complex)))
    size = size[size > zero * size.max(initial=0.0)]
    return (float(size.min()), float(size.max())) if size.size else (1.0, 1.0)


def logarithmic_grid(low: float, high: float, step: float) -> FloatArray:
    """Frequencies from `low` to `high` [rad/s] whose logarithms are about `step` apart, both ends among them.

    Examples
    --------
    >>> logarithmic_grid(1.0, 100.0, 1.5).round(6).tolist()
    [1.0, 10.0, 100.0]
    """
    return np.asarray(np.geomspace(low, high, max(int(np.log(high / low) / step), 2)), dtype=float)


def frequency_grid(
    poles: ArrayLike,
    low: float,
    high: float,
    *,
    points: int = 400,
    per_decade: int | None = None,
    offsets: Sequence[float] = (0.0, 1.0, 2.0, 3.0),
    light: float = 0.3,
    clearance: float = 1e-6,
) -> FloatArray:
    """Logarithmic grid, refined around each lightly damped pole.

    Parameters
    ----------
    poles : array_like
        Eigenvalues [rad/s]; the grid is refined at those between the ends that are lightly damped.
    low, high : float
        Ends [rad/s], both in the grid.
    points : int
        Points of the logarithmic part.
    per_decade : int, optional
        Density of the logarithmic part, instead of `points`.
    offsets : sequence of float
        Distances of the points around a pole from its frequency, to both sides, as multiples of its decay rate (half
        of the half-power width). With ratios below about 2.5 the gain of that mode changes by less than this factor
        from point to point.
    light : float
        Damping ratio below which a pole is lightly damped.
    clearance : float
        Least distance of a point from an undamped pole, over its frequency.

    Returns
    -------
    ndarray, sorted [rad/s]
        No point is closer to an undamped pole than its clearance: a response has no value there.

    Raises
    ------
    ValueError
        Ends that are not ``0 < low < high``.

    Examples
    --------
    >>> frequency_grid([-0.01 + 1j, -0.01 - 1j], 0.5, 2.0, points=2, offsets=(0, 1)).tolist()
    [0.5, 0.99, 1.0, 1.01, 2.0]
    """
    if not 0.0 < low < high:
        raise InputError(f"low and high must be 0 < low < high, got {low} and {high}")
    if per_decade is not None:
        points = max(2, int(np.ceil(np.log10(high / low) * per_decade)))
    p = np.ravel(np.asarray(poles, dtype=complex))
    size = np.abs(p)
    resonant = p[(p.imag > 0) & (np.abs(p.real) < light * size) & (size > low) & (size < high)]
    decay = np.abs(resonant.real)
    on_axis = decay < 1e-10 * resonant.imag  # undamped but for rounding
    decay[on_axis] = 2.0 * clearance * resonant.imag[on_axis]
    steps = np.array(sorted({s for offset in offsets for s in (float(offset), -float(offset))}))
    near = resonant.imag[:, None] + decay[:, None] * steps
    grid = np.unique(np.concatenate([np.geomspace(low, high, points), near.ravel()]))
    grid = grid[(grid >= low) & (grid <= high)]
    for w in resonant.imag[on_axis]:
        grid = grid[np.abs(grid - w) >= clearance * w]
    return np.asarray(grid)
