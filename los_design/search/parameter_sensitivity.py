"""Which parameter drives a worst case: derivatives at a worst point, ranges of one parameter at a time.

Two kinds of parameters. Those of the box are varied in the loop's linear fractional form, with the exact gradient and
over their whole range, all others staying at the worst point. Entries of the parameter file (``isolator.stiffness``)
are constants of the model: the telescope is assembled anew with the entry one per cent larger and smaller.

The peak moves with a parameter, so each value is the largest one within :data:`NEAR` of the worst point's frequency. A
peak elsewhere in the band is not seen: these are effects on this worst case, not worst cases. Values of other members
are read from a grid of frequencies: with eight times as many they are larger by at most 1 % (shipped pair, slow and
fast tones with both stages).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit.errors import InputError
from los_design.search.worst_points import WorstPoint
from los_loop.implemented_loop import ImplementedLoop, LoopMetric
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.telescope import Telescope

NEAR, FREQUENCIES = 0.05, 81
"""Half-width of the band around a worst frequency, relative, and frequencies in it."""
VALUES = 17
"""Values of a parameter over its range."""
PER_CENT = 0.01
"""Relative change of an entry of the parameter file, to both sides."""


@dataclass(frozen=True)
class ParameterEffect:
    """What one parameter does to a figure at its worst point.

    Parameters
    ----------
    stage, figure, parameter : str
    value : float
        The figure at the worst point, over its limit.
    slope : float
        First-order change of the figure over its value: of a parameter of the box per whole range, **positive where
        the figure grows with the parameter**; of an entry of the file per per cent.
    least, largest : float
        The figure over its limit with this parameter alone varied: over its range, or one per cent to both sides.
    """

    stage: str
    figure: str
    parameter: str
    value: float
    slope: float
    least: float
    largest: float


def effects_of_box(loop: ImplementedLoop, metric: LoopMetric, worst: WorstPoint) -> list[ParameterEffect]:
    """Of each parameter of the box, the one with the largest span first.

    Parameters
    ----------
    loop : ImplementedLoop
        Of the stage of the worst point.
    metric : LoopMetric
        The figure of the worst point.
    worst : WorstPoint
    """
    point = np.clip(loop.point(dict(worst.parameters)), 0.0, 1.0)
    value, slope, _ = loop.gain(worst.omega, metric, point)
    points = np.tile(point, (len(point) * VALUES, 1))
    for k in range(len(point)):
        points[k * VALUES : (k + 1) * VALUES, k] = np.linspace(0.0, 1.0, VALUES)
    # Largest gains at some points (N, 7) over frequencies near one
    low, high = max(worst.omega * (1.0 - NEAR), metric.band[0]), min(worst.omega * (1.0 + NEAR), metric.band[1])
    near = np.append(np.geomspace(low, high, FREQUENCIES), worst.omega)
    values = np.array([loop.gains(closed, metric, points) for closed in loop.at_each(near)])
    peaks = np.append(np.asarray(values.max(axis=0)), value)
    effects = []
    for k, name in enumerate(loop.names):
        over_range = peaks[[*range(k * VALUES, (k + 1) * VALUES), -1]]
        change = float(slope[k]) / value
        ends = float(over_range.min()), float(over_range.max())
        effects.append(ParameterEffect(loop.stage, metric.name, name, value, change, *ends))
    return sorted(effects, key=lambda effect: effect.least - effect.largest)


def effects_of_entries(
    loops: Sequence[ImplementedLoop],
    metrics: Mapping[str, Mapping[str, LoopMetric]],
    worst: Sequence[WorstPoint],
    entries: Sequence[str],
) -> list[ParameterEffect]:
    """Of entries of the parameter file on the figures of some worst points.

    Parameters
    ----------
    loops : sequence of ImplementedLoop
        Stages of one pair of controllers.
    metrics : mapping
        Of each stage its figures by name.
    worst : sequence of WorstPoint
        Of these stages and figures.
    entries : sequence of str
        ``TABLE.KEY`` each, numbers or lists of numbers.

    Raises
    ------
    ValueError
        No such entry, or none of numbers; a telescope that cannot be assembled with it.
    """
    changed = {
        name: [changed_entry(loops[0].telescope, name, 1.0 + s) for s in (-PER_CENT, PER_CENT)] for name in entries
    }
    by_stage = {loop.stage: loop for loop in loops}
    before = [_peak(by_stage[p.stage], metrics[p.stage][p.requirement], p) for p in worst]
    effects = []
    for name, both in changed.items():
        sides = []
        for telescope in both:
            ports = loops[0].ports
            open_loop = OpenLoop(loop_plant(telescope, ports), telescope, ports)
            again = {stage: ImplementedLoop(open_loop, *loop.pair, stage) for stage, loop in by_stage.items()}
            sides.append([_peak(again[p.stage], metrics[p.stage][p.requirement], p) for p in worst])
        for p, value, low, high in zip(worst, before, *sides):
            ends = min(value, low, high), max(value, low, high)
            slope = (high - low) / (2.0 * value)
            effects.append(ParameterEffect(p.stage, p.requirement, name, value, slope, *ends))
    return effects


def changed_entry(telescope: Telescope, entry: str, factor: float) -> Telescope:
    """A telescope with one entry times a factor.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> changed_entry(load_telescope(), "sadm.gearbox_stiffness", 1.5).sadm.gearbox_stiffness
    30000.0
    """
    table, _, key = entry.partition(".")
    held = telescope.to_mapping().get(table)
    old: Mapping[str, Any] = held if isinstance(held, Mapping) else {}
    value = old.get(key)
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if value is None or isinstance(value, (bool, str)) or not np.isfinite(numbers).all():
        raise InputError(
            f"an entry must be TABLE.KEY of numbers in the parameter file, e.g. isolator.stiffness, got {entry}"
        )
    return telescope.changed({table: {key: (factor * numbers).tolist()}})


def _peak(loop: ImplementedLoop, metric: LoopMetric, worst: WorstPoint) -> float:
    """The figure at the parameters of a worst point, its peak sought near it."""
    point = np.clip(loop.point(dict(worst.parameters)), 0.0, 1.0)[None]
    low, high = max(worst.omega * (1.0 - NEAR), metric.band[0]), min(worst.omega * (1.0 + NEAR), metric.band[1])
    grid = np.geomspace(low, high, FREQUENCIES)
    best = 0.0
    for _ in range(3):  # the step falls to 1e-6 of the frequency
        values = [float(loop.gains(closed, metric, point)[0]) for closed in loop.at_each(np.append(grid, worst.omega))]
        k = int(np.argmax(values[:-1]))
        best = max(best, *values)
        grid = np.geomspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], FREQUENCIES)
    return best
