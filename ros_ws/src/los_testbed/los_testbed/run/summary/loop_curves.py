"""Nyquist curves and sensitivity of the loop that ran, for the report.

The curves are those of :mod:`los_loop.nyquist` at the parameters of the run.
"""

from __future__ import annotations

from lftkit.support.threads import one_thread
from los_loop.nyquist import broken_loops
from los_testbed.run.summary.ran_loop import RanLoop
from pointing_analysis.report.loop_figures import LoopCurves
from titop_plant.interface import MIRROR_STAGES
from titop_plant.simulation.plant_config import parameter_values
from titop_plant.telescope.error_budget import MAX_SENSITIVITY


def loop_curves(loop: RanLoop | None) -> tuple[tuple[LoopCurves, ...], str]:
    """Of a run the loop broken at the mirror, and at the forces where they act; without them the reason.

    There is neither for another recording, or a stage without fine control.
    """
    if loop is None or loop.run.parameters.get("loop") not in MIRROR_STAGES:
        return (), ""
    try:
        parts = loop.known
        if parts.physical.ramps:
            return (), "arrays or wheels move during the run"
        nominal = {name: parameter.nominal for name, parameter in parts.telescope.uncertain.items()}
        model = parts.implemented_loop({**nominal, **parameter_values(parts.settings, parts.telescope)})
        with one_thread():
            broken = broken_loops(model, model.point({}))
    except (ValueError, OverflowError) as error:
        return (), str(error)
    return tuple(LoopCurves(one.place, one.omega, one.loci, one.sensitivity, MAX_SENSITIVITY) for one in broken), ""
