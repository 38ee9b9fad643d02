"""Whether fine control removes more of the error than it adds.

The telescope on its isolator without fine control, under the disturbance of the run, is modelled; the run itself is
measured. Where its error is larger, sensor noise through the loops outweighs the disturbance that they remove.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from los_testbed.run.summary.ran_loop import RanLoop
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.requirements.summary import Summary
from titop_plant.interface import MIRROR_STAGES

CLEARLY = 0.02
"""Part by which the error must be larger: one is of a record with its noise, the other of a model."""


@dataclass(frozen=True)
class ControlEffect:
    """Relative error with and without fine control [mas rms, norm of both axes].

    Parameters
    ----------
    closed : float
        Measured in the run.
    isolated : float
        Modelled: isolator alone, the same disturbance.
    """

    closed: float
    isolated: float

    @property
    def remark(self) -> str:
        """One line if control increases the error, else empty."""
        if self.closed <= self.isolated * (1.0 + CLEARLY):
            return ""
        return (
            f"control increases the error: RPE {self.closed:.3g} mas rms with it, "
            f"{self.isolated:.3g} mas rms on the isolator alone (model)"
        )


def control_effect(loop: RanLoop, summary: Summary) -> ControlEffect | None:
    """Effect of control in a recorded run; None where it is not known.

    It is known for a loop that is known to have run, in a stage with fine control, with constant parameters and a
    disturbance of tones.

    Parameters
    ----------
    loop : RanLoop
    summary : Summary
        Of the run.
    """
    if summary.loop not in MIRROR_STAGES or loop.unknown or loop.differs or not np.isfinite(summary.rpe_rms):
        return None
    try:
        parts = loop.known
    except InputError:
        return None
    config = parts.config
    if config.ramp_duration or config.disturbance_source or parts.sources:
        return None
    with one_thread():
        isolated = replace(parts, config=replace(config, loop="isolator"), recorded_start=parts.start).tone_model()
        return ControlEffect(summary.rpe_rms, isolated.relative_error(summary.window) / RAD_PER_MAS)
