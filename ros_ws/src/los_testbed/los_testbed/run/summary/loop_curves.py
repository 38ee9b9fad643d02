"""Nyquist curves and sensitivity of the loop that ran, for the report: from configuration and controllers in the bag.

The loop is that of :mod:`los_loop.implemented_loop` at the parameters of the run, broken at the mirror's commands or at
the forces, with the other loop closed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lftkit.analysis.batched_linalg import eigenvalues, largest_gains, solve
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.support.threads import one_thread
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop
from los_loop.open_loop import OpenLoop
from los_testbed.config import RunConfig
from los_testbed.factories import RunParts
from los_testbed.run.replay import controller_of
from los_testbed.run_start import START_FILE, RunStart
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read.mcap.bag_metadata import value_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.report.loop_figures import LoopCurves
from titop_plant.interface import FORCE_STAGES, FORCES, FRAME_TICKS, MIRROR, MIRROR_STAGES
from titop_plant.simulation.plant_config import parameter_values
from titop_plant.telescope.budget import MAX_SENSITIVITY

POINTS = 500
"""Frequencies, beside those at the telescope's modes."""

_SIDE = np.geomspace(1e-4, 2e-2, 12)
AT_MODES: FloatArray = np.concatenate([-_SIDE[::-1], [0.0], _SIDE])
"""Relative distances of frequencies around each mode, which is narrower than the steps of the grid."""

AT_ONCE = 64
"""Frequencies whose matrices of the whole loop are held at a time: they stay in the cache."""

FROM, TO = 1.0, 1000.0
"""Range of modes [rad/s]."""


def loop_curves(runs: Sequence[Recording]) -> list[tuple[LoopCurves, ...]]:
    """Of each run the loop broken at the mirror, and at the forces where they act.

    Nothing for a run whose loop is not known: another program's bag, a stage without fine control, a telescope that
    moves or is no longer that of the run, a camera at another rate, code of the user.
    """
    return [_curves(run) if isinstance(run, Run) else () for run in runs]


def _curves(run: Run) -> tuple[LoopCurves, ...]:
    known = run.parameters.get("plant_parameters_hash")
    if known is None or not {"run.yaml", START_FILE, "k_fsm.json", "k_pma.json"} <= set(run.attachments):
        return ()
    try:
        config = RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "run.yaml of the bag"))
        moves = config.ramp_duration or config.other_plant
        if config.loop not in MIRROR_STAGES or moves or config.frame_ticks != FRAME_TICKS:
            return ()
        start = RunStart.from_bytes(run.attachments[START_FILE])
        parts = RunParts(config, {name: controller_of(run, name)[0] for name in ("k_fsm", "k_pma")}, start)
        # the disturbance is no part of the loop
        telescope = value_of(known.partition(" with ")[0]) if isinstance(known, str) else known
        if parts.physical.ramps or value_of(parts.family.name(parts.physical)) != telescope:
            return ()
        values = parameter_values(parts.settings, parts.telescope)
        with one_thread():
            # at its parameters the telescope has no channels of Delta, which would be closed at each frequency
            open_loop = OpenLoop(parts.family.control_loop.at(values), parts.telescope)
            loop = ImplementedLoop(open_loop, parts.models["k_fsm"], parts.models["k_pma"], config.loop)
            return broken_loops(loop, loop.point({}))
    except (ValueError, TypeError, OSError, OverflowError):
        return ()


def broken_loops(loop: ImplementedLoop, point: FloatArray) -> tuple[LoopCurves, ...]:
    """The loop at a point of the unit cube, broken at the mirror, and at the forces where they act."""
    modes = loop.open.modes(point, FROM, TO)
    around = np.concatenate([modes * (1.0 + offset) for offset in AT_MODES])
    omega = np.union1d(np.geomspace(LOWEST, HIGHEST, POINTS), around)
    starts = range(0, max(1, len(omega) - AT_ONCE // 2), AT_ONCE)
    parts = (omega[k : k + AT_ONCE] if k != starts[-1] else omega[k:] for k in starts)
    S = np.concatenate([loop.sensitivities(closed, point[None]) for part in parts for closed in loop.at_each(part)])
    places = {"mirror": MIRROR, **({"forces": FORCES} if loop.stage in FORCE_STAGES else {})}
    return tuple(_broken(place, omega, S[:, channels, channels]) for place, channels in places.items())


def _broken(place: str, omega: FloatArray, S: ComplexArray) -> LoopCurves:
    unit = np.eye(S.shape[1], dtype=complex)
    loci = eigenvalues(solve(S, np.broadcast_to(unit, S.shape)) - unit)
    return LoopCurves(place, omega, _as_curves(loci), largest_gains(S), MAX_SENSITIVITY)


def _as_curves(loci: ComplexArray) -> ComplexArray:
    """Eigenvalues (N, k) in an order in which each column is one curve: by the nearest one of the frequency before.

    Examples
    --------
    >>> _as_curves(np.array([[1.0, 5.0j], [4.0j, 1.1], [1.2, 3.0j]])).tolist()
    [[(1+0j), 5j], [(1.1+0j), 4j], [(1.2+0j), 3j]]
    """
    from scipy.optimize import linear_sum_assignment

    distances = np.abs(loci[:-1, :, None] - loci[1:, None, :])
    following = np.argmin(distances, axis=2)
    # where two are nearest to one, the least sum of distances
    for k in np.flatnonzero((np.sort(following, axis=1) != np.arange(loci.shape[1])).any(axis=1)):
        following[k] = linear_sum_assignment(distances[k])[1]
    order, found = np.arange(loci.shape[1]), loci.copy()
    for k, step in enumerate(following):
        order = step[order]
        found[k + 1] = loci[k + 1, order]
    return found
