"""Wiring faults of a rig, for the emulator."""

from __future__ import annotations

from collections import deque

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from titop_plant.interface import COLUMNS, COMMANDED, MEASURED

MISTAKES = ("swapped", "sign", "gain", "delay", "dead")
"""The first two values exchanged, all values negative, half of the values, values 20 ticks old, values zero."""

DELAY_TICKS = 20
HALF = 0.5


class Wiring:
    """Faults by part: ports of sensors and of commands.

    Parameters
    ----------
    text : str
        ``PART=MISTAKE``, separated by commas; empty: none.

    Raises
    ------
    ValueError
        A part or a mistake that is not known.

    Examples
    --------
    >>> wiring = Wiring("fsm_command=swapped")
    >>> wiring.command(np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))[:2].tolist()
    [2.0, 1.0]
    """

    def __init__(self, text: str) -> None:
        self._mistakes: dict[str, str] = {}
        self._past: dict[str, deque[FloatArray]] = {}
        for word in text.split(",") if text else ():
            part, _, mistake = word.partition("=")
            if part not in (*MEASURED, *COMMANDED) or mistake not in MISTAKES:
                known = f"{', '.join((*MEASURED, *COMMANDED))} and {', '.join(MISTAKES)}"
                raise InputError(f"wrong must be PART=MISTAKE of {known}, got {word!r}")
            self._mistakes[part] = mistake
            self._past[part] = deque(maxlen=DELAY_TICKS + 1)

    def command(self, values: FloatArray) -> FloatArray:
        """Command (8,) at the actuators."""
        return self._through(values, COMMANDED)

    def measurement(self, values: FloatArray) -> FloatArray:
        """Measurement (22,) from the sensors."""
        return self._through(values, MEASURED)

    def _through(self, values: FloatArray, parts: tuple[str, ...]) -> FloatArray:
        if not self._mistakes:
            return values
        out = values.copy()
        for part in parts:
            if part in self._mistakes:
                out[COLUMNS[part]] = self._one(part, values[COLUMNS[part]])
        return out

    def _one(self, part: str, values: FloatArray) -> FloatArray:
        mistake, past = self._mistakes[part], self._past[part]
        past.append(values.copy())
        if mistake == "swapped":
            return np.concatenate([values[1::-1], values[2:]])
        if mistake == "delay":
            return past[0]
        return values * {"sign": -1.0, "gain": HALF, "dead": 0.0}[mistake]
