"""Disk margins: how much gain and phase of a loop may change at the same time.

A loop of negative feedback stays stable for all complex factors ``f`` in the disk around 1 that its size alpha and skew
sigma give, ``f = (2 + (1 - sigma) a z) / (2 - (1 + sigma) a z)`` with ``|z| < 1``, ``a = alpha``. The largest alpha is
``1 / || S + (sigma - 1) / 2 ||`` with the sensitivity S. Source: Seiler, Packard and Gahinet, IEEE Control Systems
Magazine 40 (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lftkit.analysis.margins import sensitivity
from lftkit.analysis.norms import hinf_norm, is_stable
from lftkit.arrays import Matrices
from lftkit.systems import lft
from lftkit.systems.exchange import as_system
from lftkit.systems.system import System


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


def disk_margin(loop: System, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a loop with one input and one output, continuous or sampled.

    Parameters
    ----------
    loop : System
        Loop transfer L of negative feedback: the loop is closed by ``u = -y``.
    skew : float
        0: gains and their inverses alike; above 0 the disk has more room for larger gains.

    Raises
    ------
    ValueError
        An uncertain system, or one with several inputs or outputs.

    Examples
    --------
    The example of Seiler, Packard and Gahinet, printed with 0.46, 0.63 to 1.59 and 25.8 deg:

    >>> from lftkit import s
    >>> found = disk_margin((25 / (s**3 + 10 * s**2 + 10 * s + 10)).system("u", "y"))
    >>> round(found.size, 2), [round(g, 2) for g in found.gain], round(found.phase, 1)
    (0.46, [0.63, 1.59], 25.8)
    """
    L = as_system(loop)
    L.require_siso()
    try:
        A, B, C, D = sensitivity(L)
    except ValueError:
        return NONE
    return margin_of_shifted((A, B, C, D + 0.5 * (skew - 1.0)), L.dt, skew)


def margin_of_shifted(shifted: Matrices, dt: float, skew: float) -> DiskMargin:
    """Disk margin of the loop with one signal whose ``S + (skew - 1) / 2`` is given."""
    if not is_stable(shifted[0], dt):
        return NONE
    worst = hinf_norm(*shifted, dt=dt or None)
    size = 1.0 / worst.value if worst.value > 0.0 else math.inf
    low, high = _gains(size, skew)
    return DiskMargin(size, (low, high), _phase(low, high), worst.omega, _edge(shifted, worst.omega, dt, skew))


def _gains(size: float, skew: float) -> tuple[float, float]:
    """Real factors at the ends of the disk; zero and infinity where it reaches the axis or beyond."""
    low = (2.0 - (1.0 - skew) * size) / (2.0 + (1.0 + skew) * size)
    rest = 2.0 - (1.0 + skew) * size
    return max(low, 0.0), (2.0 + (1.0 - skew) * size) / rest if rest > 0.0 else math.inf


def _phase(low: float, high: float) -> float:
    """Largest angle of the points of the unit circle inside the disk between two real factors [deg]."""
    if math.isinf(high):
        cosine = low
    else:
        cosine = (1.0 + low * high) / (low + high)
    return 180.0 if cosine <= -1.0 else math.degrees(math.acos(min(cosine, 1.0)))


def _edge(shifted: Matrices, omega: float, dt: float, skew: float) -> complex:
    """The factor that makes a pole at a frequency."""
    point = np.exp(1j * omega * dt) if dt else 1j * omega
    response = complex((shifted[3] if math.isinf(omega) else lft.response(shifted, point)).item())
    below = 2.0 * response - (1.0 + skew)
    return (2.0 * response + 1.0 - skew) / below if below != 0.0 else complex(math.inf)
