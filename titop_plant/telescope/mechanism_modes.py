"""Modes of the rotors of wheels and drives, with what they are mounted on held: for the summary of a telescope."""

from __future__ import annotations

import math
from dataclasses import dataclass

from titop_plant.telescope.components import drive_rotor
from titop_plant.telescope.layout import WheelOnBoard
from titop_plant.telescope.telescope import Telescope


@dataclass(frozen=True)
class MechanismMode:
    """A mode of a rotor.

    Parameters
    ----------
    name : str
        Wheel or array, and kind of the mode.
    at_rest, at_speed : float
        Undamped frequency [rad/s] at rest and at the default speed of the wheel; of a drive both are the same.
    """

    name: str
    at_rest: float
    at_speed: float


def mechanism_modes(telescope: Telescope) -> tuple[MechanismMode, ...]:
    """Modes of all wheels with bearings and of all drives with a stepper; none of the reference telescope.

    Examples
    --------
    >>> from titop_plant.telescope.load import load_telescope
    >>> mechanism_modes(load_telescope())
    ()
    """
    modes = [mode for wheel in telescope.wheels for mode in _of_wheel(wheel)]
    for array in telescope.motors:
        rotor, drive = drive_rotor(array), array.drive
        if rotor is not None and drive is not None:
            carried = rotor.gear_ratio**2
            omega = math.sqrt((carried * rotor.stiffness + drive.gearbox_stiffness) / (carried * rotor.inertia))
            modes.append(MechanismMode(f"{array.name}, rotor of the motor", omega, omega))
    return tuple(modes)


def _of_wheel(wheel: WheelOnBoard) -> list[MechanismMode]:
    if wheel.bearing is None:
        return []
    bearing, modes = wheel.bearing, []
    for kind in ("radial", "axial"):
        stiffness = getattr(bearing, f"{kind}_stiffness")
        if stiffness is not None:
            omega = math.sqrt(stiffness / bearing.rotor_mass)
            modes.append(MechanismMode(f"{wheel.name}, {kind}", omega, omega))
    if bearing.rocking_stiffness is not None:
        still = math.sqrt(bearing.rocking_stiffness / bearing.rotor_radial_inertia)
        half = abs(wheel.default_speed) * wheel.axial_inertia / (2.0 * bearing.rotor_radial_inertia)
        for sense, sign in (("backward", -1.0), ("forward", 1.0)):
            modes.append(MechanismMode(f"{wheel.name}, {sense} whirl", still, sign * half + math.hypot(half, still)))
    return modes
