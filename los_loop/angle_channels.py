"""Channels of the arrays' angle: half of their number, regular at every angle.

A rotation by theta is the square of a Cayley map in tau = tan(theta / 4) with four channels, two of each factor
(:mod:`titop_plant.blocks.rotation`). The first factor alone, in t = tan(theta / 2), is the whole rotation, so that the
channels of the second are left out. As t is infinite at theta = pi, a channel ``w = t z`` is written as

    w = delta (z - j w),   delta = t / (1 - j t) = sin(theta / 2) exp(j theta / 2),

which takes j from the diagonal of the matrix from w to z.

All these channels have the same delta, so that an LFT is closed with many angles at once
(:class:`lftkit.analysis.lft_response.RepeatedClosed`).
"""

from __future__ import annotations

import numpy as np

from lftkit import System
from lftkit.arrays import ComplexArray, FloatArray, IntArray
from titop_plant.physical_settings import ANGLE

FACTORS = 4
"""Channels of a rotation in a plane; the first half of them is kept."""


def kept_channels(system: System) -> IntArray:
    """Channels of a system's Delta without those of the second factor of each rotation.

    All of them where the nominal angle is not zero: what is left out then is not the identity.
    """
    names = system.channels
    angles = [k for k, name in enumerate(names) if name == ANGLE]
    if any(p.nominal != 0.0 for p in system.parameters if p.name == ANGLE):
        angles = []
    dropped = {channel for number, channel in enumerate(angles) if number % FACTORS >= FACTORS // 2}
    return np.array([channel for channel in range(len(names)) if channel not in dropped], dtype=np.intp)


def half_turn(tau: FloatArray) -> ComplexArray:
    """Entry of Delta for an angle with ``tau = tan(theta / 4)``: ``sin(theta / 2) exp(j theta / 2)``.

    Examples
    --------
    At theta = pi:

    >>> np.round(half_turn(np.array([1.0])), 12).tolist()
    [1j]
    """
    half = 2.0 * np.arctan(tau)
    return np.asarray(np.sin(half) * np.exp(1j * half))


def half_turn_slope(tau: FloatArray) -> ComplexArray:
    """Derivative of :func:`half_turn`."""
    return np.asarray(2.0 * np.exp(4j * np.arctan(tau)) / (1.0 + tau**2))


__all__ = ["half_turn", "half_turn_slope", "kept_channels"]
