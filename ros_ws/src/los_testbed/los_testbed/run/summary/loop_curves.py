"""Nyquist curves and sensitivity of the loop that ran, for the report: from configuration and controllers in the bag.

The curves are those of :mod:`los_loop.nyquist` at the parameters of the run.
"""

from __future__ import annotations

from collections.abc import Sequence

from lftkit.support.threads import one_thread
from los_loop.implemented_loop import ImplementedLoop
from los_loop.nyquist import broken_loops
from los_loop.open_loop import OpenLoop
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_FILE, RunStart
from los_testbed.run.replay import models_of_controllers
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read.mcap.bag_metadata import value_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.report.loop_figures import LoopCurves
from titop_plant.interface import FRAME_TICKS, MIRROR_STAGES
from titop_plant.simulation.plant_config import parameter_values
from titop_plant.telescope.error_budget import MAX_SENSITIVITY


def loop_curves(runs: Sequence[Recording]) -> list[tuple[LoopCurves, ...]]:
    """Of each run the loop broken at the mirror, and at the forces where they act.

    Nothing for a run whose loop is not known: another program's bag, a stage without fine control, a telescope that
    moves or is no longer that of the run, a camera at another rate, user code.
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
        parts = RunParts(config, models_of_controllers(run), start)
        # the disturbance is no part of the loop
        telescope = value_of(known.partition(" with ")[0]) if isinstance(known, str) else known
        if parts.physical.ramps or value_of(parts.family.name(parts.physical)) != telescope:
            return ()
        values = parameter_values(parts.settings, parts.telescope)
        with one_thread():
            # at its parameters the telescope has no channels of Delta, which would be closed at each frequency
            open_loop = OpenLoop(parts.family.control_loop.at(values), parts.telescope)
            loop = ImplementedLoop(open_loop, parts.models["k_fsm"], parts.models["k_pma"], config.loop)
            broken = broken_loops(loop, loop.point({}))
            return tuple(LoopCurves(one.place, one.omega, one.loci, one.sensitivity, MAX_SENSITIVITY) for one in broken)
    except (ValueError, TypeError, OSError, OverflowError):
        return ()
