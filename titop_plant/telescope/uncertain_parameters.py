"""The uncertain parameters of a telescope: wheel speeds, angle of the arrays, frequencies, factors."""

from __future__ import annotations

import itertools
import math
import random
import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from lftkit.uncertainty.elements import RealParameter
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.layout import MountedBody, WheelOnBoard, speed_names

SPEED = re.compile(r"wheel_[1-9]\d*\.speed")
"""Names of the speeds of wheels."""
MOST_CORNERS = 256
"""Corners of the box that are looked at one by one: all of eight parameters."""


def uncertain_parameters(
    wheels: Sequence[WheelOnBoard],
    arrays: Sequence[MountedBody],
    appendages: Sequence[MountedBody],
    factors: Mapping[str, RealParameter],
) -> dict[str, RealParameter]:
    """The varying and uncertain parameters of the telescope, in the order of Delta.

    ``wheel_1.speed`` and so on [rad/s] of the wheels whose speeds vary; of each array the uncertain frequencies
    ``<parameters>.omega_1`` and so on [rad/s]; ``solar_array.tau`` = tan(theta / 4), one theta for all arrays that
    turn; of appendages their uncertain frequencies; factors of the table ``[uncertain]``, where there is one. The
    arrays of the reference share ``solar_array.omega_1`` and ``solar_array.omega_2``.
    """
    speeds = wheel_speeds(wheels)
    result = {speed.name: speed for speed, wheel in zip(speeds, wheels) if wheel.varies} | _frequencies(arrays)
    turning = [array for array in arrays if array.turns]
    if turning:
        low, high = (math.tan(theta / 4) for theta in turning[0].theta_range)
        about = f"tan(theta/4), theta the angle of {_words(turning, arrays)}"
        result[ANGLE] = RealParameter(ANGLE, 0.0, low, high, "1", about)
    return result | _frequencies(appendages) | dict(factors)


def wheel_speeds(wheels: Sequence[WheelOnBoard]) -> list[RealParameter]:
    """Speed of each wheel [rad/s]; nominal is the middle of its range, so that the map to [-1, 1] is affine."""
    return [
        RealParameter(name, 0.5 * sum(wheel.speed_range), *wheel.speed_range, "rad/s", f"speed of reaction wheel {i}")
        for i, (name, wheel) in enumerate(zip(speed_names(len(wheels)), wheels), start=1)
    ]


def _frequencies(bodies: Sequence[MountedBody]) -> dict[str, RealParameter]:
    """Uncertain frequencies of mounted bodies, those that several share once."""
    parameters: dict[str, RealParameter] = {}
    for prefix in dict.fromkeys(body.parameters for body in bodies):
        owners = [body for body in bodies if body.parameters == prefix]
        parameters |= _frequencies_of(owners[0], _words(owners, bodies))
    return parameters


def _frequencies_of(body: MountedBody, owners: str) -> dict[str, RealParameter]:
    result, spread = {}, body.relative_uncertainty
    if not spread:
        return {}
    if body.modes is None:
        from titop_plant.structures.modal_file import read_modal_data  # loads scipy

        frequencies = read_modal_data(body.modal_data).frequencies.tolist()
    else:
        frequencies = list(body.modes.frequencies)
    for i, w in enumerate(frequencies[: body.uncertain_modes], start=1):
        name, about = f"{body.parameters}.omega_{i}", f"clamped frequency of mode {i} of {owners}"
        result[name] = RealParameter(name, float(w), w * (1 - spread), w * (1 + spread), "rad/s", about)
    return result


def _words(owners: Sequence[MountedBody], bodies: Sequence[MountedBody]) -> str:
    """Owner of a parameter, in words."""
    if len(owners) == len(bodies) == 2 and all(body.axis is not None for body in owners):
        return "both arrays"
    return ", ".join(body.name for body in owners)


def moves(name: str) -> bool:
    """Whether a parameter is a speed of a wheel or the arrays' angle, which follow a profile during a run."""
    return SPEED.fullmatch(name) is not None or name == ANGLE


def further_parameters(names: Iterable[str], factors: Collection[str]) -> list[str]:
    """Parameters that a run sets by ``frequencies``: neither speeds of wheels, nor the arrays' angle, nor `factors`.

    Examples
    --------
    >>> further_parameters(["wheel_1.speed", "solar_array.tau", "wing.omega_1", "fsm.stiffness"], ["fsm.stiffness"])
    ['wing.omega_1']
    """
    return [name for name in names if not (moves(name) or name in factors)]


def box_corners(box: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
    """All corners of the box of uncertain parameters (2^7 for the reference), or `MOST_CORNERS` random ones of more."""
    if 2 ** len(box) <= MOST_CORNERS:
        return [dict(zip(box, ends)) for ends in itertools.product(*box.values())]
    chance, drawn = random.Random(0), dict[tuple[float, ...], None]()
    while len(drawn) < MOST_CORNERS:
        drawn[tuple(map(chance.choice, box.values()))] = None
    return [dict(zip(box, ends)) for ends in drawn]
