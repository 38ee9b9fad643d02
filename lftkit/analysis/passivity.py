"""Passivity indices: by how much a system is passive, or what it lacks.

Sources: Bao and Lee, Process Control: The Passive Systems Approach (2007), section 2.3; the level iteration is that of
Bruinsma and Steinbuch (1990) for the index in the place of the gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.frequency_grid import pole_range
from lftkit.analysis.norms import band_gain, hinf_norm, linf_norm
from lftkit.arrays import Matrices
from lftkit.errors import InputError
from lftkit.support.settings import AlgorithmSettings
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.system import System

Fraction = tuple[float, float, float, float]


@dataclass(frozen=True)
class PassivitySettings(AlgorithmSettings):
    """Numbers of the search for a passivity index.

    Attributes
    ----------
    precision : part of the gain (of its inverse) to which an index is found
    allowed : excess of a gain over 1 that is rounding
    steps : levels that are tried, at most
    points : frequencies with which the search begins, beside those of the poles
    rank : part of its factors from which on a product is regular, and of its entries by which a matrix is not symmetric
    far : shortage of output passivity, over the inverse of the gain, from which on it has no bound
    """

    precision: float = 1e-6
    allowed: float = 1e-7
    steps: int = 60
    points: int = 200
    rank: float = 1e-10
    far: float = 1e6


SETTINGS = PassivitySettings()


@dataclass(frozen=True)
class PassivityIndex:
    """Both sides of an index.

    Attributes
    ----------
    value, lower : float
        ``lower <= index <= value``; `value` is that of the response at `omega`. `lower` is minus infinity where
        nothing was found.
    omega : float
        Frequency with the least index [rad/s].
    """

    value: float
    lower: float
    omega: float


@checked
def passivity_index(system: Any, side: str = "input", *, settings: PassivitySettings = SETTINGS) -> PassivityIndex:
    """Passivity index of a stable square system (getPassiveIndex in MATLAB); above 0 it is strictly passive.

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
        G: certain, stable, as many outputs as inputs, continuous or sampled.
    side : {"input", "output"}
        ``input``: the largest nu with ``G + G* >= 2 nu`` at every frequency, [output unit / input unit].
        ``output``: the largest rho with ``G + G* >= 2 rho G* G``, in the inverse unit; minus infinity where no number
        is small enough.
    settings : PassivitySettings
        Numbers of the search.

    Raises
    ------
    ValueError
        A system that is uncertain, not square or not stable, another side.

    Examples
    --------
    ``(s + 2) / (s + 1)``: its real part is from 1 to 2, that of its inverse from 1/2 to 1.

    >>> from lftkit import s
    >>> G = ((s + 2) / (s + 1)).system("force", "velocity")
    >>> [round(passivity_index(G, side).value, 4) for side in ("input", "output")]
    [1.0, 0.5]
    """
    if side not in ("input", "output"):
        raise InputError(f"side must be input or output, got {side!r}")
    G = as_system(system)
    G.require_certain()
    if G.D.shape[0] != G.D.shape[1]:
        raise InputError(f"{G.name}: must have as many inputs as outputs, got {G.D.shape[1]} and {G.D.shape[0]}")
    gain = hinf_norm(G)
    if not gain.value < math.inf:
        raise InputError(f"{G.name}: must be stable for a passivity index, got a pole that is not")
    if gain.value == 0.0:
        end = 0.0 if side == "input" else math.inf
        return PassivityIndex(end, end, 0.0)
    scale = gain.value if side == "input" else 1.0 / gain.value
    if side == "output" and not G.dt and not G.D.any():
        inverse = inverse_without_derivative(G, settings.rank)
        if inverse is not None:
            return _index(_Index(inverse, "input", linf_norm(inverse).value or scale, settings), gain.omega)
    return _index(_Index(G, side, scale, settings), gain.omega)


def _index(search: _Index, peak: float) -> PassivityIndex:
    """The least index over frequency; `peak` is one of the frequencies with which the search begins."""
    scale, settings = search.scale, search.settings
    value, omega = search.first(peak)
    if value < -settings.far * scale:
        return PassivityIndex(-math.inf, -math.inf, omega)
    allowance = settings.precision * scale
    for _ in range(settings.steps):
        lower = value - allowance
        worst = search.violated(lower)
        if worst is None:
            return PassivityIndex(value, lower, omega)
        index = search.at(worst)
        if index < lower:
            value, omega = index, worst
            if value < -settings.far * scale:
                return PassivityIndex(-math.inf, -math.inf, omega)
        else:
            allowance *= 2.0
    return PassivityIndex(value, -math.inf, omega)


def inverse_without_derivative(G: System, rank: float = SETTINGS.rank) -> System | None:
    """``G^-1 - s E`` of a continuous system without feedthrough, if ``E = (C B)^-1`` is symmetric.

    None where it is not, and for a system with zeros on the axis.

    The derivative has no part in the output index of G, which is the input index of the rest. A test of the gain does
    not tell indices apart where the response of G falls to zero. From ``rate of y = C A x + C B u``; the states
    are those with ``C x = 0``.
    """
    A, B, C, _ = G.matrices
    product = C @ B
    sizes = linalg.svdvals(product)
    if not sizes[-1] > rank * linalg.norm(C, 2) * linalg.norm(B, 2):
        return None
    E = linalg.inv(product)
    if not np.abs(E - E.T).max() <= rank * np.abs(E).max():
        return None
    kernel = linalg.null_space(C, rcond=rank)
    inner, through = A - B @ E @ C @ A, B @ E
    states = kernel.T @ inner @ kernel, kernel.T @ inner @ through
    zeros = np.asarray(linalg.eigvals(states[0]) if len(states[0]) else [], dtype=complex)
    if np.any(np.abs(zeros.real) <= rank * np.abs(zeros).max(initial=0.0)):
        return None
    return System(*states, -E @ C @ A @ kernel, -E @ C @ A @ through, G.outputs, G.inputs, G.name)


def linear_fraction(matrices: Matrices, fraction: Fraction) -> Matrices | None:
    """Matrices of ``(a T + b) (c T + d)^-1``; None where its feedthrough is infinite."""
    (a, b, c, d), (A, B, C, D) = fraction, matrices
    one = np.eye(len(D))
    inner = c * D + d * one
    sizes = linalg.svdvals(inner)
    if not sizes[-1] > np.finfo(float).eps * sizes[0]:
        return None
    E = linalg.inv(inner)
    feedthrough = (a * D + b * one) @ E
    return A - c * B @ E @ C, B @ E, a * C - c * feedthrough @ C, feedthrough


@dataclass(frozen=True)
class _Index:
    """An index at single frequencies, and the test of a level at all of them."""

    system: System
    side: str
    scale: float
    settings: PassivitySettings

    def first(self, *further: float) -> tuple[float, float]:
        """The least index of some frequencies, and its frequency."""
        poles, last = self.system.poles(), math.inf
        if self.system.dt:
            last = math.pi / self.system.dt
            grid = np.linspace(0.0, last, self.settings.points)
        else:
            low, high = pole_range(poles)
            grid = np.concatenate([[0.0], np.abs(poles), np.geomspace(1e-2 * low, 1e2 * high, self.settings.points)])
        points = [float(omega) for omega in grid] + [last, *further]
        return min((self.at(omega), omega) for omega in points)

    def at(self, omega: float) -> float:
        """Index of the response at a frequency, also at infinity."""
        dt = self.system.dt
        point = np.exp(1j * omega * dt) if dt else 1j * omega
        G = self.system.D.astype(complex) if math.isinf(omega) else np.atleast_2d(self.system(point))
        H = 0.5 * (G + G.conj().T)
        if self.side == "input":
            return float(linalg.eigvalsh(H)[0])
        _, sizes, V = linalg.svd(G)
        seen = sizes > np.finfo(float).eps * max(1.0 / self.scale, float(sizes[0]))
        if not seen.any():
            return math.inf  # zero at the ends of the axis: no finite number
        inner = V[seen] @ H @ V[seen].conj().T / np.outer(sizes[seen], sizes[seen])
        return float(linalg.eigvalsh(0.5 * (inner + inner.conj().T))[0])

    def violated(self, level: float) -> float | None:
        """A frequency at which the index is below a level [rad/s]; None where there is none."""
        if self.side == "input":
            fraction = -1.0, self.scale + level, 1.0, self.scale - level
        else:
            fraction = (-2.0 * level, 1.0, 0.0, 1.0) if level > 0.0 else (0.0, 1.0, -2.0 * level, 1.0)
        index = linear_fraction(self.system.matrices, fraction)
        last = math.pi / self.system.dt if self.system.dt else math.inf
        if index is None:
            return last
        allowed = self.settings.allowed
        norm = band_gain(*index, (0.0, last), dt=self.system.dt or None, rtol=0.1 * allowed, stable=False)
        return None if norm.upper <= 1.0 + allowed else norm.omega
