"""Contract of a user's plant, checked before the run: errors name attribute, shape or value."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from lftkit.arrays import BoolArray, FloatArray
from lftkit.errors import InputError
from los_testbed.config.plugins import RAISED, in_one_line
from los_testbed.parts.law_models import element
from los_testbed.parts.stepped_plant import SteppedPlant, plant_notes
from los_testbed.parts.user_blocks import UNTOUCHED, beyond
from titop_plant.interface import RATE, TRUTH
from titop_plant.telescope.loop_ports import LoopPorts


def _element(name: str, where: BoolArray, ports: LoopPorts | None) -> str:
    """First marked element of a vector: of the measurement by its port, as ``accel_M1[2]``; else its number."""
    if ports is not None and name == "measurement":
        return element(ports.measured, where)
    return f"[{int(np.flatnonzero(where)[0])}]"


class RunFailedError(RuntimeError):
    """Plant, observer or controller failed during a run; the message says which, at which tick and how."""


def first_not_finite(
    signals: Mapping[str, FloatArray], rows: int, ports: LoopPorts | None = None
) -> tuple[int, str] | None:
    """Row and port of the first value that is not finite (`beyond`), except held values; None if all are.

    Parameters
    ----------
    signals : name of the vector -> (n, size) values of consecutive ticks
    rows : how many of the ticks are valid
    ports : of the loop, for the measurement
    """
    odd_values = []
    for name, values in signals.items():
        odd = beyond(values[:rows])
        if ports is not None and name == "measurement":
            odd[:, ports.held] = False
        ticks = np.flatnonzero(odd.any(axis=1))
        if ticks.size:
            row = int(ticks[0])
            odd_values.append((row, f"{name} {_element(name, odd[row], ports)} is {values[row][odd[row]][0]:g}"))
    return min(odd_values, key=lambda one: one[0]) if odd_values else None


def check_plant(plant: SteppedPlant, ports: LoopPorts) -> None:
    """Try one step of a copy of a plant; one that cannot be copied is tried itself and reset afterwards.

    Raises
    ------
    InputError
        An attribute is missing or of another type, `step` fails, leaves something unwritten, writes values that are not
        finite, or changes the command.
    """
    for name in ("step", "reset"):
        if not callable(getattr(plant, name, None)):
            raise InputError(f"plant.{name} must be a method, got {getattr(plant, name, 'none')!r}")
    try:
        frame = getattr(plant, "frame_ticks", None)
        plant_notes(plant)
    except RAISED as error:
        names = "plant.frame_ticks, and tones and parameters_hash if there are any,"
        raise InputError(f"{names} must be values that can be recorded, got {in_one_line(error)}") from error
    if isinstance(frame, bool) or not isinstance(frame, (int, np.integer)) or not 1 <= frame <= RATE:
        raise InputError(f"plant.frame_ticks must be a whole number of ticks from 1 to {RATE}, got {frame!r}")
    command = np.zeros(ports.commands)
    measurement, truth = np.full(ports.measurements, UNTOUCHED), np.full(TRUTH, UNTOUCHED)
    shapes = f"command ({ports.commands},), measurement ({ports.measurements},), truth ({TRUTH},)"
    try:
        trial = copy.deepcopy(plant)
    except Exception:
        trial = plant
    try:
        trial.reset()
        trial.step(command, measurement, truth)
        trial.reset()
    except RAISED as error:
        raise InputError(f"plant.step and plant.reset must accept {shapes}, got {in_one_line(error)}") from error
    if command.any():
        raise InputError("plant.step must not change its command, got another one after the step")
    held = np.zeros(ports.measurements, bool)
    held[ports.held] = True
    for name, vector, may_be_nan in (("measurement", measurement, held), ("truth", truth, np.zeros(TRUTH, bool))):
        untouched = vector == UNTOUCHED
        if untouched.any():
            raise InputError(f"plant.step must write all of {name}, got nothing in {_element(name, untouched, ports)}")
        odd = beyond(vector) & ~may_be_nan
        if odd.any():
            value = vector[np.flatnonzero(odd)[0]]
            raise InputError(
                f"plant.step must write finite values, got {value:g} in {name} {_element(name, odd, ports)}"
            )
