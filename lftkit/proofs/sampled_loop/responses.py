"""What the inequality of a strip needs to know of a system: its responses over windows of a variable."""

from __future__ import annotations

from typing import Protocol

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.trusted.polynomials import Polynomial
from lftkit.proofs.trusted.proof import Strip


class Responses(Protocol):
    """Responses of an uncertain system whose channels are ``w = delta z``.

    The variable of the windows is the frequency, or a function of it.
    """

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Channels, measurements, errors, disturbances, commands."""
        ...

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Channels of each parameter."""
        ...

    @property
    def angle(self) -> tuple[bool, ...]:
        """Whether a parameter is tan(theta / 2) of an angle theta."""
        ...

    @property
    def slowest(self) -> float:
        """Value of the variable well below which all responses are nearly real."""
        ...

    def at(self, x: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d), without bounds."""
        ...

    def amplitudes(self, x: float, /) -> tuple[float, FloatArray]:
        """Weight of the bounded output and amplitudes of the disturbances, without bounds."""
        ...

    def performance(self, middle: float, half: float) -> tuple[Polynomial, Polynomial]:
        """Squares of the output's weight (1,), and of one over the disturbances' amplitudes (d,)."""
        ...

    def responses(self, middle: float, half: float, V: ComplexArray) -> tuple[Polynomial, Polynomial]:
        """``z`` and the bounded output over a window, as maps from the coordinates of V."""
        ...

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square. Nobody trusts them."""
        ...
