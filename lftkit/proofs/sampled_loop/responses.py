"""What a search for scalings asks of responses beyond what the check asks."""

from __future__ import annotations

from typing import Protocol

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.trusted.strips import Responses


class SearchedResponses(Responses, Protocol):
    """Responses for which scalings are searched; ``complex`` and ``full`` elements are never bisected."""

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
