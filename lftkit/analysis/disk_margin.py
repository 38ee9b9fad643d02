"""Disk margins: how much gain and phase of a loop may change at the same time.

A loop of negative feedback stays stable for all complex factors ``f`` in the disk around 1 that its size alpha and skew
sigma give, ``f = (2 + (1 - sigma) a z) / (2 - (1 + sigma) a z)`` with ``|z| < 1``, ``a = alpha``. The largest alpha is
``1 / || S + (sigma - 1) / 2 ||`` with the sensitivity S. Source: Seiler, Packard and Gahinet, IEEE Control Systems
Magazine 40 (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit.analysis.margins import sensitivity
from lftkit.analysis.norms import hinf_norm, is_stable
from lftkit.arrays import Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_number
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.system import System

LARGEST_SKEW = 1e6
"""Beyond it the disk is a half plane, and the sensitivity is lost in the rounding of ``S + (skew - 1) / 2``."""


@dataclass(frozen=True)
class DiskMargin:
    """Margin of one loop.

    Attributes
    ----------
    size : float
        alpha: 0 for a loop that is not stable.
    gain : tuple of float
        Factors of the gain alone that the loop bears, from and to.
    phase : float
        Change of the phase alone [deg], to both sides; 180 where every phase is borne.
    omega : float
        Frequency at which the margin is least [rad/s].
    factor : complex
        A factor at the edge of the disk that makes a pole at ``omega``.
    """

    size: float
    gain: tuple[float, float]
    phase: float
    omega: float
    factor: complex

    @property
    def gain_db(self) -> tuple[float, float]:
        """The factors in decibel."""
        low, high = (20.0 * math.log10(g) if g > 0.0 else -math.inf for g in self.gain)
        return low, high


NONE = DiskMargin(0.0, (1.0, 1.0), 0.0, 0.0, 1.0 + 0.0j)
"""That of a loop which is not stable."""


@checked
def disk_margin(loop: System, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a loop with one input and one output, continuous or sampled.

    Parameters
    ----------
    loop : System
        Loop transfer L of negative feedback: the loop is closed by ``u = -y``.
    skew : float
        0: gains and their inverses alike; above 0 the disk has more room for larger gains. Of magnitude 1e6 at most.

    Raises
    ------
    ValueError
        An uncertain system, or one with several inputs or outputs; another skew.

    Examples
    --------
    The example of Seiler, Packard and Gahinet, printed with 0.46, 0.63 to 1.59 and 25.8 deg:

    >>> from lftkit import s
    >>> found = disk_margin((25 / (s**3 + 10 * s**2 + 10 * s + 10)).system("u", "y"))
    >>> round(found.size, 2), [round(g, 2) for g in found.gain], round(found.phase, 1)
    (0.46, [0.63, 1.59], 25.8)
    """
    L, skew = as_system(loop), as_skew(skew)
    L.require_siso()
    try:
        A, B, C, D = sensitivity(L)
    except ValueError:
        return NONE
    return margin_of_shifted((A, B, C, D + 0.5 * (skew - 1.0)), L.dt, skew)


def as_skew(value: Any) -> float:
    """A skew of a disk margin; a ValueError for one whose margins would have no digits."""
    skew = as_number(value, "skew")
    if not abs(skew) <= LARGEST_SKEW:
        raise InputError(f"skew must be from {-LARGEST_SKEW:g} to {LARGEST_SKEW:g}, got {skew:g}")
    return float(skew)


def margin_of_shifted(shifted: Matrices, dt: float, skew: float) -> DiskMargin:
    """Disk margin of the loop with one signal whose ``S + (skew - 1) / 2`` is given."""
    if not is_stable(shifted[0], dt):
        return NONE
    worst = hinf_norm(*shifted, dt=dt or None)
    size = 1.0 / worst.value if worst.value > 0.0 else math.inf
    # The factor that makes a pole at a frequency
    point = np.exp(1j * worst.omega * dt) if dt else 1j * worst.omega
    response = complex((shifted[3] if math.isinf(worst.omega) else lft.response(shifted, point)).item())
    below = 2.0 * response - (1.0 + skew)
    edge = (2.0 * response + 1.0 - skew) / below if below != 0.0 else complex(math.inf)
    return DiskMargin(size, disk_gains(size, skew), disk_phase(size, skew), worst.omega, edge)


def disk_gains(size: float, skew: float = 0.0) -> tuple[float, float]:
    """Real factors at the ends of the disk; zero and infinity where it reaches the axis or beyond.

    Examples
    --------
    A margin of 2/3 without skew allows gains from a half to two:

    >>> low, high = disk_gains(2.0 / 3.0)
    >>> round(low, 9), round(high, 9)
    (0.5, 2.0)
    """
    if math.isinf(size):
        return 0.0, math.inf
    below, above = 2.0 + (1.0 + skew) * size, 2.0 - (1.0 + skew) * size
    low = max((2.0 - (1.0 - skew) * size) / below, 0.0) if below > 0.0 else 0.0
    return low, (2.0 + (1.0 - skew) * size) / above if above > 0.0 else math.inf


def disk_phase(size: float, skew: float = 0.0) -> float:
    """Angle [deg] at which the unit circle leaves the disk ``(2 + (1 - skew) d) / (2 - (1 + skew) d)``, |d| < size.

    180 where it does not leave it.

    Examples
    --------
    >>> round(disk_phase(2.0), 6)
    90.0
    """
    # |d| of the factor exp(j phi) is 2 |f - 1| / |(1 - skew) + (1 + skew) f|
    square = size**2
    slope = 4.0 + square * (1.0 - skew**2)
    if math.isinf(size) or slope <= 0.0:
        return 180.0
    return math.degrees(math.acos(max(-1.0, (4.0 - square * (1.0 + skew**2)) / slope)))
