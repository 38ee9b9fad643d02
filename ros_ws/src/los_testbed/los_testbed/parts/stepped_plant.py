"""Interface of a plant, and its metadata in a bag."""

from __future__ import annotations

import json
from typing import Protocol

import numpy as np

from lftkit.arrays import FloatArray


class SteppedPlant(Protocol):
    """Interface of a plant: commands in, measurements and truth out, one step per tick.

    **Contract.** The vectors are those of :mod:`titop_plant.interface`. `step` number k applies the command that was
    computed from the measurement of step k - 1 and holds it until step k + 1; it limits the command to what its
    actuators can do. It overwrites all of `measurement` and `truth`, does not change `command`, and raises nothing: a
    plant that diverges returns values that are not finite. It takes well under a tick. After `reset` the same commands
    give bit-identical outputs.

    Three further attributes are recorded where a plant has them: ``tones``, the frequencies of its disturbance [rad/s],
    ``motion``, what moves, as a mapping (:attr:`titop_plant.simulation.ramped_step.RampedStep.motion`), and
    ``parameters_hash``, a text that names its values. The telescope is a :class:`titop_plant.simulation.plant.Plant`.
    """

    frame_ticks: int
    """Ticks from one camera frame to the next: step k has a frame where k is a multiple of it."""

    def step(self, command: FloatArray, measurement: FloatArray, truth: FloatArray) -> None:
        """Apply `command` (8,) [rad, N]; write `measurement` (22,) [m/s2, rad/s2, rad] and `truth` (2,) [rad].

        The camera's columns are NaN where there is no frame or the frame is lost.
        """

    def reset(self) -> None:
        """Return to the state before the first step, noise included."""


def plant_notes(plant: SteppedPlant) -> dict[str, str]:
    """Tones, motion and name of the values of a plant, for the metadata of a bag."""
    notes = {}
    tones = getattr(plant, "tones", None)
    if tones is not None:
        notes["tones_rad_s"] = "[" + ", ".join(f"{tone:.9g}" for tone in np.ravel(tones)) + "]"
    motion = getattr(plant, "motion", None)
    if motion is not None:
        notes["motion"] = json.dumps(motion)
    parameters_hash = getattr(plant, "parameters_hash", None)
    if parameters_hash is not None:
        notes["plant_parameters_hash"] = str(parameters_hash)
    return notes
