"""What a check is given, as types: responses over windows of a variable, and what it uses without trusting it.

No check loads this module; what it trusts of the responses is in the modules that implement them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.polynomials import Polynomial
from lftkit.proofs.trusted.proof import Box, Interval, Strip


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
    def kinds(self) -> tuple[str, ...]:
        """``real`` for each parameter; else ``complex`` or ``full``, whose intervals are never bisected."""
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


class GivenLoop(Loop):
    """A sampled loop with what its owner adds to it: none of this is trusted."""

    def at(self, omega: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d) at one frequency, without bounds."""
        raise NotImplementedError

    @property
    def kinds(self) -> tuple[str, ...]:
        """As of :class:`Responses`."""
        raise NotImplementedError

    @property
    def slowest(self) -> float:
        """Smallest magnitude of the plant's poles [rad/s], at most 1 / dt."""
        raise NotImplementedError

    def amplitudes(self, omega: float, /) -> tuple[float, FloatArray]:
        """Weight of the bounded output (over the limit) and amplitudes of the disturbances, without bounds."""
        raise NotImplementedError

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """As of :class:`Responses`."""
        raise NotImplementedError

    def to_bisect(self, M: Polynomial, part: Box, /) -> int | None:
        """Parameter to bisect where the channels are M over a window, or None where a narrower window helps."""
        raise NotImplementedError


@dataclass(frozen=True)
class LoopProof:
    """What a file claims and the strips that prove it.

    Parameters
    ----------
    model : GivenLoop
    names : tuple of str
        Of the parameters.
    box : tuple of (low, high)
        As in :class:`Strip`.
    band : (low, high)
        Frequencies [rad/s].
    level : float
        The gain is below this part of the limit.
    strips : tuple of Strip
    about : mapping
        What the loop is, for people: figure, stage, designs.
    """

    model: GivenLoop
    names: tuple[str, ...]
    box: Box
    band: Interval
    level: float
    strips: tuple[Strip, ...]
    about: Mapping[str, Any] = field(default_factory=dict)
