"""Stability margins of the implemented loop: changes of its gain and delay, and what a peak of sensitivity guarantees.

A peak Ms of the largest singular value of the sensitivity guarantees, for all channels together and one by one, the
gain margin ``Ms / (Ms - 1)`` and the phase margin ``2 asin(1 / (2 Ms))``. With the complementary sensitivity T a
delay tau keeps the loop stable while ``2 sin(w tau / 2) sigma(T(w)) < 1`` at all frequencies. The changes themselves
(one more tick of delay, gains times 0.5 and 2) are checked by the eigenvalues of the changed loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from lftkit.analysis.batched_linalg import eigenvalues, largest_gains
from lftkit.arrays import BoolArray, ComplexArray, FloatArray
from los_loop.implemented_loop import ImplementedLoop
from los_loop.sampled_loop import SampledLoop
from titop_plant.interface import COMMANDS, DT, FORCE_STAGES, FORCES, HELD, MIRROR

CERTAIN, NARROW_FROM = (0.98, 0.9), 60.0
GAINS = (0.5, 2.0)
"""Factors of the loop gain that the loop must bear, all channels alike and one at a time."""


@dataclass(frozen=True)
class Margins:
    """What a peak of the sensitivity at one point of the loop guarantees.

    Parameters
    ----------
    sensitivity : float
        Peak of the largest singular value.
    delay : float
        Guaranteed delay margin [s] of all channels of this point together.
    """

    sensitivity: float
    delay: float

    @property
    def gain_db(self) -> float:
        """Upper gain margin [dB]."""
        return 20.0 * math.log10(self.sensitivity / (self.sensitivity - 1.0)) if self.sensitivity > 1.0 else math.inf

    @property
    def phase_deg(self) -> float:
        """Phase margin [deg]."""
        return math.degrees(2.0 * math.asin(min(1.0, 0.5 / self.sensitivity)))

    def to_mapping(self) -> dict[str, float | str]:
        """For JSON, which has no infinity."""
        return {
            "sensitivity": rounded(self.sensitivity),
            "gain_db": rounded(self.gain_db, 4),
            "phase_deg": rounded(self.phase_deg, 4),
            "delay_ms": rounded(1e3 * self.delay, 4),
        }


def rounded(value: float, digits: int = 5) -> float | str:
    """A number for JSON, which has no infinity: that is the text ``"inf"``."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else str(value)


def delay_margin(loop: ImplementedLoop, channels: slice, points: FloatArray, omega: FloatArray) -> float:
    """Smallest guaranteed delay margin [s] over points of the unit cube (N, 7) and frequencies [rad/s].

    Parameters
    ----------
    channels : slice
        Of the commands: :data:`titop_plant.interface.MIRROR` or ``FORCES``.
    """
    smallest = math.inf
    size = channels.stop - channels.start
    for w in omega:
        S = loop.sensitivities(loop.at(float(w)), points)[:, channels, channels]
        T = float(largest_gains(S - np.eye(size)).max())
        if T > 0.5:
            smallest = min(smallest, 2.0 * math.asin(0.5 / T) / float(w))
    return smallest


def change_names(stage: str) -> list[str]:
    """Names of the changes of :func:`changed_loops`, in its order."""
    names = ["one more tick"]
    for factor in GAINS:
        names.append(f"gain x{factor:g}")
        for channel in _channels(stage):
            kind = f"force {channel - FORCES.start + 1}" if channel >= FORCES.start else f"mirror {channel + 1}"
            names.append(f"gain x{factor:g} at {kind}")
    return names


def doubtful(sensitivity: ComplexArray, omega: float, stage: str) -> BoolArray:
    """Whether a change could meet -1 at a frequency, for N sensitivities (N, 8, 8): shape (N, changes).

    A gain g in one channel leaves the loop stable while ``1 - (g - 1) (S_ii - 1)`` stays away from zero on the way from
    1 to g; one in all channels and a delay alike with the eigenvalues of S. :data:`CERTAIN` is below 1 for what lies
    between the frequencies of a grid; its second number holds above :data:`NARROW_FROM`, where modes are narrow.
    Eigenvalues are computed only where a norm does not exclude the doubt.
    """
    size, (low, high), certain = len(_channels(stage)), GAINS, CERTAIN[int(omega > NARROW_FROM)]
    S = sensitivity[:, :size, :size]
    turned = 2.0 * abs(math.sin(0.5 * min(omega * DT, math.pi)))
    T_all = np.sqrt(np.sum(np.abs(S - np.eye(size)) ** 2, axis=(1, 2)))
    S_all = np.sqrt(np.sum(np.abs(S) ** 2, axis=(1, 2)))
    near = np.maximum.reduce([S_all * (high - 1.0) / high, (1.0 - low) * T_all, turned * T_all]) >= certain
    if near.any():
        eigen = np.asarray(eigenvalues(S[near]))
        T_all[near], S_all[near] = np.abs(eigen - 1.0).max(axis=1), np.abs(eigen).max(axis=1)
    own = np.diagonal(S, axis1=1, axis2=2)
    T = np.column_stack([T_all, np.abs(own - 1.0)])
    raised = np.column_stack([S_all, np.abs(own)]) * (high - 1.0) / high
    return np.asarray(np.column_stack([turned * T_all, (1.0 - low) * T, raised]) >= certain)


def changed_loops(loop: SampledLoop, stage: str) -> Iterator[tuple[str, Callable[[], SampledLoop]]]:
    """Makers of the loop with one more tick of delay, and with other gains, by name."""
    names = iter(change_names(stage))
    yield next(names), lambda: delayed(loop)
    for factor in GAINS:
        yield next(names), partial(scaled, loop, np.full(COMMANDS, factor))
        for channel in _channels(stage):
            gains = np.ones(COMMANDS)
            gains[channel] = factor
            yield next(names), partial(scaled, loop, gains)


def _channels(stage: str) -> range:
    return range(COMMANDS if stage in FORCE_STAGES else MIRROR.stop)


def unstable_changes(loop: SampledLoop, stage: str) -> list[str]:
    """Names of the changes that make the loop unstable."""
    return [name for name, changed in changed_loops(loop, stage) if not changed().spectral_radius() < 1.0]


def scaled(loop: SampledLoop, gains: FloatArray) -> SampledLoop:
    """The loop with its commands multiplied by `gains` (8,)."""
    rows = slice(loop.plant_order, loop.plant_order + COMMANDS)

    def change(matrix: FloatArray) -> FloatArray:
        changed = matrix.copy()
        changed[rows] *= gains[:, None]
        return changed

    return loop.changed(change, change, loop.truth)


def delayed(loop: SampledLoop) -> SampledLoop:
    """The loop with one more tick of delay at all commands; 8 states more, before the held values."""
    V = np.arange(loop.plant_order, loop.plant_order + COMMANDS)
    n = loop.hold.shape[0]
    order = np.r_[np.arange(n - HELD.size), np.arange(n, n + COMMANDS), np.arange(n - HELD.size, n)]

    def later(A: FloatArray) -> FloatArray:
        whole = np.zeros((n + COMMANDS, n + COMMANDS))
        whole[:n, :n] = A
        whole[:n, n:] = A[:, V]
        whole[:n, V] = 0.0
        whole[n + np.arange(COMMANDS), V] = 1.0
        return np.asarray(whole[np.ix_(order, order)])

    def widened(rows: FloatArray) -> FloatArray:
        return np.asarray(np.vstack([rows, np.zeros((COMMANDS, rows.shape[1]))])[order])

    truth = np.hstack([loop.truth, loop.truth[:, V]])
    truth[:, V] = 0.0
    return loop.changed(later, widened, truth[:, order])
