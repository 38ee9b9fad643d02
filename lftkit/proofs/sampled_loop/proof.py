"""A proof of a sampled loop: the loop, what is claimed, and strips of scalings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.strips import Interval, Strip


@dataclass(frozen=True)
class LoopProof:
    """What a file claims and the strips that prove it.

    Parameters
    ----------
    model : LoopModel
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

    model: LoopModel
    names: tuple[str, ...]
    box: tuple[Interval, ...]
    band: Interval
    level: float
    strips: tuple[Strip, ...]
    about: Mapping[str, Any] = field(default_factory=dict)
