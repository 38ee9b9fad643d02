"""Largest values of the stages' metrics over a grid of frequencies, at all parameter points together.

At each frequency the telescope's response is computed once for all stages, each stage's loop is closed once, and every
point costs a solution of the order of the channels beside those of the arrays' angle
(:mod:`los_loop.angle_channels`). Singular values of more than two rows are computed where a norm does not show that
they change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from los_loop.closing import ClosedAt, ClosedLoop
from los_loop.implemented_loop import ImplementedLoop, LoopMetric
from los_loop.margins import change_names, doubtful
from los_loop.spec import LOS_ROWS
from titop_plant.interface import FORCE_STAGES, MIRROR

ROUNDING = 1e-12
"""Relative rounding of a norm that bounds a singular value."""


class Reach:
    """Responses of a stage that its metrics and its changed loops need.

    Parameters
    ----------
    loop : ImplementedLoop
    metrics : mapping of str to LoopMetric
    changes : bool
        Whether changed loops are looked at.
    """

    def __init__(self, loop: ImplementedLoop, metrics: Mapping[str, LoopMetric], changes: bool = True) -> None:
        self.loop, self.metrics, self.changes = loop, dict(metrics), changes
        commands = loop.ports.commands if loop.stage in FORCE_STAGES else MIRROR.stop
        added, size = loop.open.disturbances, loop.open.disturbances + loop.ports.commands
        columns = {name: slice(*m.columns.indices(size)[:2]) for name, m in metrics.items()}
        self.applied = slice(LOS_ROWS.stop, LOS_ROWS.stop + commands)
        self.added = slice(added, added + commands)
        self.rows = slice(0, max([self.applied.stop, *(m.rows.stop for m in metrics.values())]))
        self.columns = slice(0, max([self.added.stop, *(s.stop for s in columns.values())]))
        blocks: dict[tuple[int, int, int, int], list[str]] = {}
        for name, m in metrics.items():
            blocks.setdefault((m.rows.start, m.rows.stop, columns[name].start, columns[name].stop), []).append(name)
        self.blocks = [(slice(a, b), slice(c, d), names) for (a, b, c, d), names in blocks.items()]

    @property
    def change_count(self) -> int:
        """Number of the changes of :func:`los_loop.margins.changed_loops`."""
        return len(change_names(self.loop.stage, self.loop.ports.commands))

    def responses(self, closed: ClosedAt | ClosedLoop, delta: ComplexArray) -> ComplexArray:
        """First rows and columns of the response for N diagonals of Delta (N, 32), or one of each of N closed loops."""
        return self.loop.some_responses(closed, delta, self.rows, self.columns)

    def doubt(self, T: ComplexArray, omega: float | FloatArray) -> BoolArray:
        """What :func:`los_loop.margins.doubtful` says of responses, shape (N, changes); without changes nothing."""
        if not self.changes:
            return np.zeros((len(T), self.change_count), dtype=bool)
        return doubtful(T[:, self.applied, self.added], omega, self.loop.stage)

    def here(self, omega: float) -> list[tuple[slice, slice, dict[str, float]]]:
        """Blocks of the response with the metrics whose band has a frequency, and their factors there."""
        blocks = []
        for rows, columns, names in self.blocks:
            metrics = [self.metrics[name] for name in names]
            factors = {m.name: self.loop.scale(m, omega) for m in metrics if m.band[0] <= omega <= m.band[1]}
            if factors:
                blocks.append((rows, columns, factors))
        return blocks


@dataclass(frozen=True)
class Sweep:
    """What a stage has at some of the frequencies of a grid.

    Parameters
    ----------
    value : dict of str to ndarray, shape (points,)
        By metric, the largest value of each point; 0 at unstable ones.
    place : dict of str to ndarray of int, shape (points,)
        Its place in the grid.
    envelope : dict of str to ndarray, shape (frequencies,)
        By metric, the largest value over the points at each frequency of the grid; 0 at those not looked at.
    doubt : ndarray of bool, shape (points, changes)
        Changes of the loop that could make it unstable.
    """

    value: dict[str, FloatArray]
    place: dict[str, IntArray]
    envelope: dict[str, FloatArray]
    doubt: BoolArray


def sweep(
    reaches: Sequence[Reach], omega: FloatArray, places: IntArray, cube: FloatArray, stable: Sequence[BoolArray]
) -> list[Sweep]:
    """Look at some frequencies of a grid.

    Parameters
    ----------
    reaches : sequence of Reach
        Of stages around the same open loop.
    omega : ndarray
        The grid [rad/s].
    places : ndarray of int
        Places in it that are looked at, in this order.
    cube : ndarray, shape (points, parameters)
        Of the unit cube.
    stable : sequence of ndarray of bool, shape (points,)
        For each stage.
    """
    sweeps = [_nothing(reach, len(cube), len(omega)) for reach in reaches]
    open_loop, at = reaches[0].loop.open, omega[places]
    delta, lft = open_loop.delta(cube), open_loop.at(at)
    for reach, of_reach, there in zip(reaches, sweeps, stable):
        for k, w, closed in zip(places, at.tolist(), reach.loop.around(lft, at)):
            T = reach.responses(closed, delta)
            of_reach.doubt[:] |= reach.doubt(T, w)
            for rows, columns, factors in reach.here(w):
                known = np.min([of_reach.value[name] / factor for name, factor in factors.items()], axis=0)
                gains = _gains_above(T[:, rows, columns], known, there)
                for name, factor in factors.items():
                    # Enter the values of a metric at a place of the grid
                    values, place = gains * factor, int(k)
                    higher = values > of_reach.value[name]
                    of_reach.value[name][higher] = values[higher]
                    of_reach.place[name][higher] = place
                    of_reach.envelope[name][place] = float(values.max())
    return sweeps


def joined(parts: Sequence[Sweep]) -> Sweep:
    """Of several parts of a grid."""
    value, place = dict[str, FloatArray](), dict[str, IntArray]()
    for name in parts[0].value:
        values, places = (np.array([getattr(part, field)[name] for part in parts]) for field in ("value", "place"))
        best = np.lexsort((places, -values), axis=0)[0]
        each = np.arange(values.shape[1])
        value[name], place[name] = values[best, each], places[best, each]
    envelope = {name: np.max([part.envelope[name] for part in parts], axis=0) for name in value}
    return Sweep(value, place, envelope, np.any([part.doubt for part in parts], axis=0))


def _nothing(reach: Reach, points: int, frequencies: int) -> Sweep:
    return Sweep(
        {name: np.zeros(points) for name in reach.metrics},
        {name: np.zeros(points, dtype=np.intp) for name in reach.metrics},
        {name: np.zeros(frequencies) for name in reach.metrics},
        np.zeros((points, reach.change_count), dtype=bool),
    )


def _gains_above(T: ComplexArray, known: FloatArray, stable: BoolArray) -> FloatArray:
    """Largest singular values at stable points, where they exceed what is `known`, or all others; else zero."""
    if min(T.shape[1:]) <= 2:
        return np.where(stable, largest_gains(T), 0.0)
    bound = (1.0 + ROUNDING) * np.sqrt(np.sum(T.real**2 + T.imag**2, axis=(1, 2))) * stable
    floor = largest_gains(T[[int(bound.argmax())]])[0]
    near = stable & ((bound > known) | (bound >= floor))
    gains = np.zeros(len(T))
    gains[near] = largest_gains(T[near])
    return gains


__all__ = ["Reach", "Sweep", "joined", "sweep"]
