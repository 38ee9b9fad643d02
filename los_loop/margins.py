"""Stability margins of the implemented loop: changes of its gain and delay, and what a peak of sensitivity guarantees.

A peak Ms of the largest singular value of the sensitivity guarantees, for all channels together and one by one, the
gain margin ``Ms / (Ms - 1)`` and the phase margin ``2 asin(1 / (2 Ms))``. With the complementary sensitivity T a
delay tau keeps the loop stable while ``2 sin(w tau / 2) sigma(T(w)) < 1`` at all frequencies. The changes themselves
(one more tick of delay, gains times 0.5 and 2) are checked by the eigenvalues of the changed loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lftkit.analysis.batched_linalg import eigenvalues, largest_gains
from lftkit.arrays import BoolArray, ComplexArray, FloatArray
from los_loop.implemented_loop import ImplementedLoop
from los_loop.sampled_loop import SampledLoop
from los_loop.spec import LOS_ROWS
from titop_plant.interface import DT, FORCE_STAGES, FORCES, MIRROR

CERTAIN, NARROW_FROM = (0.98, 0.9), 60.0
BOUND_ROUNDING = 1e-9
"""Of the norm of a power, relative."""
TOGETHER = 64
"""Frequencies whose loops are closed together."""
GAINS = (0.5, 2.0)
"""Factors of the loop gain that the loop must bear, all channels alike and one at a time."""


@dataclass(frozen=True)
class GuaranteedMargins:
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


def delay_margins(
    loop: ImplementedLoop, channels: Sequence[slice], points: FloatArray, omega: FloatArray
) -> list[float]:
    """Smallest guaranteed delay margins [s] over points of the unit cube (N, 7) and frequencies [rad/s].

    Parameters
    ----------
    channels : sequence of slice
        Of the commands, each with a margin of its own: :data:`titop_plant.interface.MIRROR` or ``FORCES``.
    """
    smallest, delta = [math.inf] * len(channels), loop.delta(points)
    last = max(part.stop for part in channels)
    rows, columns = (slice(start, start + last) for start in (LOS_ROWS.stop, loop.open.disturbances))
    for start in range(0, len(omega), TOGETHER):
        for closed in loop.at_each(omega[start : start + TOGETHER]):
            S = loop.some_responses(closed, delta, rows, columns)
            for k, part in enumerate(channels):
                T = float(largest_gains(S[:, part, part] - np.eye(part.stop - part.start)).max())
                if T > 0.5:
                    smallest[k] = min(smallest[k], 2.0 * math.asin(0.5 / T) / closed.omega)
    return smallest


def change_names(stage: str, commands: int) -> list[str]:
    """Names of the changes of :func:`changed_loops`, in its order, for a loop with so many commands."""
    names = ["one more tick"]
    for factor in GAINS:
        names.append(f"gain x{factor:g}")
        for channel in _channels(stage, commands):
            kind = f"force {channel - FORCES.start + 1}" if channel >= FORCES.start else f"mirror {channel + 1}"
            names.append(f"gain x{factor:g} at {kind}")
    return names


def doubtful(sensitivity: ComplexArray, omega: float | FloatArray, stage: str) -> BoolArray:
    """Whether a change could meet -1 at a frequency, for N sensitivities (N, u, u): shape (N, changes).

    `omega` [rad/s] is that of all of them, or has one for each, shape (N,).

    A gain g in one channel leaves the loop stable while ``1 - (g - 1) (S_ii - 1)`` stays away from zero on the way from
    1 to g; one in all channels and a delay alike with the eigenvalues of S. :data:`CERTAIN` is below 1 for what lies
    between the frequencies of a grid; its second number holds above :data:`NARROW_FROM`, where modes are narrow.
    Eigenvalues are computed only where norms do not exclude the doubt. A delay turns: with an eigenvalue l of ``S - I``
    it leaves the loop stable while ``1 + l (1 - exp(-j a))`` stays away from zero for all a from 0 to w dt, which large
    ones may do as well.
    """
    size, (low, high) = len(_channels(stage, sensitivity.shape[1])), GAINS
    S, at = sensitivity[:, :size, :size], np.broadcast_to(omega, len(sensitivity))
    certain = np.where(at > NARROW_FROM, CERTAIN[1], CERTAIN[0])
    turned = 2.0 * np.abs(np.sin(0.5 * np.minimum(at * DT, math.pi)))
    least_T, least_S = certain / np.maximum(1.0 - low, turned), certain * high / (high - 1.0)
    found, whole = _balanced(S), np.eye(size)
    T_all, S_all = (np.sqrt(np.sum(np.abs(part) ** 2, axis=(1, 2))) for part in (found - whole, found))
    delay = np.zeros(len(S), dtype=bool)
    for bounds, least, part in ((T_all, least_T, whole), (S_all, least_S, 0.0 * whole)):
        near = np.flatnonzero(bounds >= least)
        # Upper bounds of the spectral radius of each matrix of a stack (N, k, k): norms of their powers
        M = found[near] - part
        square = M @ M
        fourth = square @ square
        norm = np.sqrt(np.sum(np.abs(fourth @ fourth) ** 2, axis=(1, 2)))
        bounds[near] = np.asarray((1.0 + BOUND_ROUNDING) * norm**0.125)
        near = near[bounds[near] >= least[near]]
        if near.size:
            values = np.asarray(eigenvalues(S[near] - part))
            bounds[near] = np.abs(values).max(axis=1)
            if part is whole:
                delay[near] = _turns_to_zero(values, at[near] * DT, certain[near])
    own = np.diagonal(S, axis1=1, axis2=2)
    T = np.column_stack([T_all, np.abs(own - 1.0)])
    raised = np.column_stack([S_all, np.abs(own)]) * (high - 1.0) / high
    gains = np.column_stack([(1.0 - low) * T, raised]) >= certain[:, None]
    return np.asarray(np.column_stack([delay, gains]))


def _turns_to_zero(values: ComplexArray, angle: FloatArray, certain: FloatArray) -> BoolArray:
    """Whether ``1 - x``, ``x = l (exp(-j a) - 1)``, comes near zero for an a from 0 to `angle` (N,) and an l (N, k).

    Near is ``|1 - x| <= (1 - certain) max(1, |x|)``: a change of x by so small a part of it, or of 1, could reach zero.
    The points ``l exp(-j a)`` are an arc; its distance from ``1 + l`` is that of the circle, or of an end.
    """
    turned = np.minimum(angle, 2.0 * math.pi)[:, None]
    to = np.mod(np.angle(values) - np.angle(1.0 + values), 2.0 * math.pi)
    ends = np.minimum(1.0, np.abs(1.0 + values - values * np.exp(-1j * turned)))
    circle = np.abs(np.abs(1.0 + values) - np.abs(values))
    distance = np.where(to <= turned, np.minimum(circle, ends), ends)
    largest = 2.0 * np.abs(values) * np.sin(0.5 * np.minimum(turned, math.pi))
    return np.asarray((distance <= (1.0 - certain)[:, None] * np.maximum(1.0, largest)).any(axis=1))


def _balanced(S: ComplexArray) -> ComplexArray:
    """Similar matrices (N, k, k) in which what angles do to forces has the size of what forces do to angles."""
    if S.shape[1] <= MIRROR.stop:
        return S
    found, first, last = S.copy(), slice(0, MIRROR.stop), slice(MIRROR.stop, None)
    there, back = (np.sum(np.abs(part) ** 2, axis=(1, 2)) for part in (S[:, first, last], S[:, last, first]))
    ratio = np.where((there > 0.0) & (back > 0.0), np.maximum(there, 1e-300) / np.maximum(back, 1e-300), 1.0) ** 0.25
    found[:, first, last] /= ratio[:, None, None]
    found[:, last, first] *= ratio[:, None, None]
    return found


def changed_loops(loop: SampledLoop, stage: str) -> Iterator[tuple[str, Callable[[], SampledLoop]]]:
    """Makers of the loop with one more tick of delay, and with other gains, by name."""
    names = iter(change_names(stage, loop.commands))
    yield next(names), lambda: delayed(loop)
    for factor in GAINS:
        yield next(names), partial(scaled, loop, np.full(loop.commands, factor))
        for channel in _channels(stage, loop.commands):
            gains = np.ones(loop.commands)
            gains[channel] = factor
            yield next(names), partial(scaled, loop, gains)


def _channels(stage: str, commands: int) -> range:
    return range(commands if stage in FORCE_STAGES else MIRROR.stop)


def unstable_changes(loop: SampledLoop, stage: str) -> list[str]:
    """Names of the changes that make the loop unstable."""
    return [name for name, changed in changed_loops(loop, stage) if not changed().spectral_radius() < 1.0]


def scaled(loop: SampledLoop, gains: FloatArray) -> SampledLoop:
    """The loop with its commands multiplied by `gains` (8,)."""
    rows = slice(loop.plant_order, loop.plant_order + loop.commands)

    def change(matrix: FloatArray) -> FloatArray:
        changed = matrix.copy()
        changed[rows] *= gains[:, None]
        return changed

    return loop.changed(change, change, loop.truth)


def delayed(loop: SampledLoop) -> SampledLoop:
    """The loop with one more tick of delay at all commands; 8 states more, before the held values."""
    V = np.arange(loop.plant_order, loop.plant_order + loop.commands)
    n, commands = loop.hold.shape[0], loop.commands
    held = n - loop.ports.held.size
    order = np.r_[np.arange(held), np.arange(n, n + commands), np.arange(held, n)]

    def later(A: FloatArray) -> FloatArray:
        whole = np.zeros((n + commands, n + commands))
        whole[:n, :n] = A
        whole[:n, n:] = A[:, V]
        whole[:n, V] = 0.0
        whole[n + np.arange(commands), V] = 1.0
        return np.asarray(whole[np.ix_(order, order)])

    def widened(rows: FloatArray) -> FloatArray:
        return np.asarray(np.vstack([rows, np.zeros((commands, rows.shape[1]))])[order])

    truth = np.hstack([loop.truth, loop.truth[:, V]])
    truth[:, V] = 0.0
    return loop.changed(later, widened, truth[:, order])
