"""Predicted and measured tones for the report: the model as implemented against a recorded run, from the bag alone.

Configuration and controllers are those in the bag, of a loop that is known to be the one that ran.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lftkit.errors import InputError
from los_loop.tone_model import compare_tones
from los_testbed.run.summary.ran_loop import LAWS, RanLoop, contradiction
from los_testbed.run.summary.rig_prediction import rig_tones
from pointing_analysis.indices.errors import on_camera
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import statistics_of
from pointing_analysis.spectra.prediction import Prediction

LONGEST = 60.0
"""Seconds from the start of a run that are modelled and compared; the model costs a step of python each millisecond."""


def predictions(loops: Sequence[RanLoop | None], transient: float | None = None) -> list[Prediction | None]:
    """For each run the predicted and measured amplitude of its tones.

    Only the first 60 s of a run are compared (`LONGEST`), start-up left out.

    Parameters
    ----------
    loops : sequence of RanLoop or None
        Of the runs; None for another recording.
    transient : float, optional
        Seconds of start-up to leave out.

    Returns
    -------
    list of Prediction or None
        None where there is nothing to predict: a bag of another program, no tones, a telescope that changes during the
        run, sources of disturbance. A prediction without tones says in its note why it failed.
    """
    return [None if loop is None else _prediction(loop, transient) for loop in loops]


def _prediction(loop: RanLoop, transient: float | None) -> Prediction | None:
    run, rig = loop.run, _emulated(loop.run)
    replayed = run.parameters.get("mode") == "replay"
    if replayed or not (rig or run.parameters.get("tones_rad_s")) or "disturbances" in run.parameters:
        return None  # without tones, or not only those of the scenario
    try:
        if rig:
            # The telescope that the rig simulates, with the laws that its nodes announced
            if loop.parts is None or (reason := contradiction(loop.run, loop.parts, LAWS)):
                raise InputError(loop.unknown if loop.parts is None else reason)
            parts = replace(loop.parts, config=loop.parts.config.emulated(), recorded_start=None)
            if parts.family.name(parts.physical) != rig:
                raise InputError("the rig simulates another telescope or disturbance")
            tones, (first, last) = rig_tones(run, parts, transient)
        else:
            parts = loop.known
            if parts.config.camera_dropout:
                raise InputError("camera frames were dropped at random, and the model drops none")
            if parts.physical.ramps:
                return None
            tones, (first, last) = compare_tones(run, parts.tone_model(), transient, LONGEST)
    except (ValueError, OverflowError) as error:
        text = " ".join(str(error).split()).replace(str(run.path), run.path.name)
        return Prediction(note=text)
    if not tones:
        return Prediction(note=f"too few periods of each tone within the first {LONGEST:g} s after start-up")
    return Prediction(tones, first, last)


def _emulated(run: Run) -> str:
    """Name of the telescope that a rig simulates; "" for other runs and without a true line of sight."""
    return "" if on_camera(run) else str(statistics_of(run.parameters, "plant").get("device_emulates", ""))
