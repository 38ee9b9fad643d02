"""Whether fine control removes more of the error than it adds, from the bag alone.

The telescope on its isolator without fine control, under the disturbance of the run, is modelled; the run itself is
measured. Where its error is larger, sensor noise through the loops outweighs the disturbance that they remove.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lftkit.support.threads import one_thread
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_FILE, RunStart
from los_testbed.run.replay import models_of_controllers
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import Summary
from titop_plant.interface import MIRROR_STAGES


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
        if self.closed <= self.isolated:
            return ""
        return (
            f"control increases the error: RPE {self.closed:.3g} mas rms with it, "
            f"{self.isolated:.3g} mas rms on the isolator alone (model)"
        )


def control_effect(run: Run, summary: Summary) -> ControlEffect | None:
    """Effect of control in a recorded run; None where it is not known.

    It is known for a stage with fine control, a telescope of constant parameters, a disturbance of tones and a bag that
    holds how its run started.

    Parameters
    ----------
    run : Run
    summary : Summary
        Of the run.
    """
    needed = {"run.yaml", START_FILE, "k_fsm.json", "k_pma.json"}
    known = "plant_parameters_hash" in run.parameters and needed <= set(run.attachments)
    if not known or summary.loop not in MIRROR_STAGES or run.parameters.get("mode") == "replay":
        return None
    try:
        config = RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "run.yaml of the bag"))
        start = RunStart.from_bytes(run.attachments[START_FILE])
        if (
            config.ramp_duration
            or config.disturbance_source
            or RunParts(config).sources
            or not np.isfinite(summary.rpe_rms)
        ):
            return None
        controllers = models_of_controllers(run)
        with one_thread():
            model = RunParts(replace(config, loop="isolator"), controllers, start).tone_model()
            isolated = model.relative_error(summary.window)
    except (ValueError, OSError, OverflowError):
        return None
    return ControlEffect(summary.rpe_rms, isolated / RAD_PER_MAS)
