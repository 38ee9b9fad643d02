"""Fade of an output to zero and back along a raised cosine, so that it does not step."""

from __future__ import annotations

import math

from lftkit.arrays import FloatArray

FADE_TICKS = 20
"""Ticks of a fade where nothing else is chosen."""


def fade_weights(ticks: int) -> list[float]:
    """Factors from zero to one, (ticks + 1,).

    Examples
    --------
    >>> [round(weight, 3) for weight in fade_weights(4)]
    [0.0, 0.146, 0.5, 0.854, 1.0]
    """
    return [0.5 - 0.5 * math.cos(math.pi * i / ticks) for i in range(ticks)] + [1.0]


class Fade:
    """Weight of an output: 1 while it is active, else down to 0 along a raised cosine, and back.

    Parameters
    ----------
    ticks : int
        Length of the fade.

    Examples
    --------
    >>> fade = Fade(2)
    >>> fade.turn(False)
    >>> [round(fade.weight(), 3) for _ in range(3)]
    [0.5, 0.0, 0.0]
    """

    def __init__(self, ticks: int) -> None:
        self._weights = fade_weights(ticks)
        self._last = self._at = ticks
        self._step = 1

    def turn(self, active: bool) -> None:
        """Fade in, or out, from the next tick on."""
        self._step = 1 if active else -1

    def settle(self) -> None:
        """Be at once where the fade leads to."""
        self._at = self._last if self._step > 0 else 0

    @property
    def whole(self) -> bool:
        """Whether the weight is 1 and stays so."""
        return self._at == self._last and self._step > 0

    @property
    def settled(self) -> bool:
        """Whether the weight, 0 or 1, stays as it is."""
        return self.whole or (self.over and self._step < 0)

    @property
    def over(self) -> bool:
        """Whether the weight of the last tick was 0."""
        return self._at == 0

    def scale(self, outputs: FloatArray) -> None:
        """Weigh the outputs (k, p) of as many ticks, in place."""
        if not self.whole:
            for row in outputs:
                row *= self.weight()

    def weight(self) -> float:
        """Weight of this tick; called once a tick unless it is whole."""
        self._at = min(max(self._at + self._step, 0), self._last)
        return self._weights[self._at]
