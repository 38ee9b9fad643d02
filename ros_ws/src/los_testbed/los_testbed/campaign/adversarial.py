"""Members found by a worst-case search, for campaigns on the worst case instead of the distribution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from los_testbed.campaign.sampling import MemberParameters, members
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts

METRICS = ("slow", "fast")
"""Metrics that are searched: tones of the relative error."""

APART = 1e-3
"""Distance, in ranges of the parameters, below which two members are the same."""

MOST_ASCENTS = 200
"""Ascents of each metric."""


_last: dict[tuple[RunConfig, int, int], tuple[tuple[float, dict[str, float]], ...]] = {}


def _searched(
    base: RunConfig, ascents: int, seed: int, workers: Workers | None
) -> tuple[tuple[float, dict[str, float]], ...]:
    from los_design.search.worst_case_search import Search, SearchOptions

    loop = RunParts(replace(base, scenario="design")).implemented_loop(base.parameter_values)
    with one_thread():
        worst = Search(loop, SearchOptions(ascents=ascents, seed=seed)).run(METRICS, workers=workers)
    points = [point for band in worst.values() for point in band]
    return tuple((p.gamma, dict(p.parameters)) for p in sorted(points, key=lambda p: -p.gamma))


def adversarial_members(base: RunConfig, samples: int, seed: int, workers: Workers | None = None) -> FloatArray:
    """Parameters of the members: worst points of the search, then uniform ones.

    The search is :class:`los_design.search.worst_case_search.Search`.

    The search finds the worst point of each frequency band for slow and for fast tones, some thirty points; the first
    member is the worst one of all.

    Parameters
    ----------
    base : RunConfig
        Stage, controllers, parameter file.
    samples : int
        Number of members.
    seed : int
    workers : Workers, optional
        Processes that search; the members do not depend on them.

    Returns
    -------
    ndarray, shape (samples, parameters)

    Raises
    ------
    ValueError
        No member is asked for.
    """
    uniform = members("uniform", samples, seed, base.parameters, base.parameter_values)
    ascents = min(MOST_ASCENTS, 10 * samples)
    parameters = MemberParameters.of(base.parameters, base.parameter_values)
    width = np.ptp(parameters.limits, axis=1)
    chosen: list[FloatArray] = []
    # Value and parameters of the worst point of each band of each metric, worst first; those of the last call
    # kept
    key = (base, ascents, seed)
    if key not in _last:
        _last.clear()
        _last[key] = _searched(*key, workers)
    for _, values in _last[key]:
        point = np.array([values[name] for name in parameters.ranges])
        if all(np.abs((point - other) / width).max() > APART for other in chosen):
            chosen.append(point)
    return np.vstack([*chosen, uniform])[:samples]
