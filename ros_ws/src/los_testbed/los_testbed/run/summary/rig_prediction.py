"""Predicted against measured for a run on an emulated rig: the loop with the delays that the run has measured.

The rig acts once a tick of its own clock, so that the ticks from a measurement to its command are a whole number, which
changes as its clock drifts past that of the host, in seconds. The response is the mean of those with each number, by
their shares of the run: a fit to the record finds this mean. It is that of the settled loop, since what the rig did
before the run is not known; the tones have the frequency that they have on the clock of the host.
"""

from __future__ import annotations

import numpy as np

from lftkit.errors import InputError
from los_loop.sampled_loop import Delays
from los_loop.tone_model import compare_settled
from los_testbed.config.topics import CAMERA_LOS
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.change_requests import statistics_of
from los_testbed.run.loop.latency_histogram import shares_of_text
from los_testbed.run.loop.slow_sensor import BEGINNING
from pointing_analysis.read.run import Run
from pointing_analysis.spectra.prediction import ToneComparison

LONGEST = 5
"""Ticks from a measurement to its command that are modelled."""

RARE = 0.01
"""Share of the ticks that may have a longer delay."""


def rig_tones(
    run: Run, parts: RunParts, transient: float | None
) -> tuple[tuple[ToneComparison, ...], tuple[float, float]]:
    """Tones of a run on an emulated rig, and the part of the run that they are fitted to [s].

    Raises
    ------
    ValueError
        Delays that are not in the bag, or too long for a settled loop.
    """
    plant, observer = (statistics_of(run, node) for node in ("plant", "estimator"))
    shares = shares_of_text(str(plant.get("device_delay_ticks", "")))
    late = sum(share for ticks, share in shares.items() if ticks > LONGEST)
    if not shares or not all(0.0 <= share <= 1.0 for share in shares.values()):
        raise InputError("the bag does not hold the delays of the rig")
    if late > RARE:
        raise InputError(f"{late:.0%} of the commands came more than {LONGEST} ticks after their measurements")
    shares = {ticks: share for ticks, share in shares.items() if ticks <= LONGEST}
    frames = round(float(observer.get(f"{BEGINNING}{CAMERA_LOS.name}_age_mean_ms", 0.0)))
    models = {ticks: parts.tone_model(Delays(max(0, ticks - 1), frames)) for ticks in shares}
    unstable = [ticks for ticks, model in models.items() if not model.loop.spectral_radius() < 1.0]
    if sum(shares[ticks] for ticks in unstable) > RARE:
        raise InputError(f"with commands {unstable[0]} ticks after their measurements the loop is not stable")
    kept = [ticks for ticks in shares if ticks not in unstable]
    settled = sum(shares[ticks] * models[ticks].settled() for ticks in kept) / sum(shares[ticks] for ticks in kept)
    rate = 1.0 + 1e-6 * float(plant.get("device_clock_drift_ppm", 0.0))
    return compare_settled(run, rate * models[kept[0]].omega, np.asarray(settled), transient)
