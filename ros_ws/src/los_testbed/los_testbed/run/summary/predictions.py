"""Predicted and measured tones for the report: the model as implemented against a recorded run, from the bag alone.

Configuration and controllers are those in the bag. The telescope's parameter file is not in it: its values
must still be those of the run, by the hash in the bag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lftkit.errors import InputError
from los_loop.tone_model import compare_tones
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import AT_REST, START_FILE, RunStart
from los_testbed.run.replay import models_of_controllers
from los_testbed.run.summary.rig_prediction import rig_tones
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.indices.errors import on_camera
from pointing_analysis.read.mcap.bag_metadata import value_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import statistics_of
from pointing_analysis.spectra.prediction import Prediction
from titop_plant.interface import TICK_NS, period_ticks

LONGEST = 60.0
"""Seconds from the start of a run that are modelled and compared; the model costs a step of python each millisecond."""

OTHER_FIGURES = "telescope has changed since the run"
LATE = 100
"""Ticks that may be missing at the end of a record; where more are, its recorder may have come late."""


def predictions(
    runs: Sequence[Recording], transient: float | None = None, start: float = 0.0, stop: float = math.inf
) -> list[Prediction | None]:
    """For each run the predicted and measured amplitude of its tones.

    Only the first 60 s of a run are compared (`LONGEST`), start-up left out.

    Parameters
    ----------
    runs : sequence of Recording
    transient : float, optional
        Seconds of start-up to leave out.
    start, stop : float
        The part of each run that was read [s].

    Returns
    -------
    list of Prediction or None
        None where there is nothing to predict: a bag of another program, no tones, a telescope that changes during the
        run, a plant of another kind, a replay. A prediction without tones says in its note why it failed.
    """
    return [_prediction(run, transient, start, stop) if isinstance(run, Run) else None for run in runs]


def _prediction(run: Run, transient: float | None, start: float, stop: float) -> Prediction | None:
    rig = _emulated(run)
    known = rig or run.parameters.get("plant_parameters_hash")
    if not (rig or run.parameters.get("tones_rad_s")) or known is None or "run.yaml" not in run.attachments:
        return None
    if run.parameters.get("mode") == "replay" or "disturbances" in run.parameters:  # tones are not the scenario's alone
        return None
    try:
        config = RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "run.yaml of the bag"))
        if START_FILE not in run.attachments:
            raise InputError(f"the bag does not hold {START_FILE}")
        start_of_run = RunStart.from_bytes(run.attachments[START_FILE])
        controllers = models_of_controllers(run)
        if rig:
            config, start_of_run = config.emulated(), AT_REST
        else:
            _check(run, config, start, stop)
        unstated = start_of_run.states is None and start_of_run.tone is None  # the recorder node leaves it out at rest
        parts = RunParts(config, controllers, None if unstated else start_of_run)
        if parts.physical.ramps:
            return None
        if value_of(parts.family.name(parts.physical)) != known:
            raise InputError(f"the {'rig simulates another telescope or disturbance' if rig else OTHER_FIGURES}")
        if rig:
            tones, (first, last) = rig_tones(run, parts, transient)
        else:
            tones, (first, last) = compare_tones(run, parts.tone_model(), transient, LONGEST)
    except (ValueError, TypeError, OSError, OverflowError) as error:
        text = " ".join(str(error).split()).replace(str(run.path), run.path.name)
        return Prediction(note=text)
    if not tones:
        return Prediction(note=f"too few periods of each tone within the first {LONGEST:g} s after start-up")
    return Prediction(tones, first, last)


def _emulated(run: Run) -> str:
    """Name of the telescope that a rig simulates; "" for other runs and without a true line of sight."""
    return "" if on_camera(run) else str(statistics_of(run.parameters, "plant").get("device_emulates", ""))


def _check(run: Run, config: RunConfig, start: float, stop: float) -> None:
    """Refuse a record that the model does not follow from its first sample on."""
    if config.camera_dropout:
        raise InputError("camera frames were dropped at random, and the model drops none")
    if start > 0:
        raise InputError("the prediction starts with the run, and the report with a later part")
    if run["truth/los"].lost_before:
        raise InputError("the record does not begin with the run: its first samples are lost")
    stamp = run["truth/los"].stamp
    plant = statistics_of(run.parameters, "plant")
    recorded = round((int(stamp[-1]) - int(stamp[0])) / TICK_NS) + 1 if len(stamp) else 0
    missing = int(plant.get("ticks", 0)) - recorded if math.isinf(stop) else 0
    if not recorded or int(stamp[0]) % (period_ticks(config.frame_ticks) * TICK_NS) or missing > LATE:
        raise InputError("the record does not begin with the run")
