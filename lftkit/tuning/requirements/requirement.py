"""What every requirement of a design says of a loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from lftkit.errors import InputError
from lftkit.systems.system import System

if TYPE_CHECKING:
    from lftkit.tuning.requirements.assembled_loop import AssembledLoop

R = TypeVar("R", bound="TuningRequirement")


class CertifiedValue(NamedTuple):
    """Normalised value of a requirement, a bound that it does not exceed, and the frequency of its peak [rad/s]."""

    value: float
    upper: float
    omega: float = 0.0


class TuningRequirement(ABC):
    """A requirement has one normalised value per model: 1 is "just met", smaller is better.

    The tuner minimises the largest soft value subject to every hard value being at most 1.
    """

    @property
    @abstractmethod
    def hard(self) -> bool:
        """At most 1 (True) or minimised (False)."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Unique in a design."""

    @abstractmethod
    def check(self, model: System) -> None:
        """Raise a ValueError, which names the requirement, where it cannot be asked of `model`."""

    @abstractmethod
    def certified(self, loop: AssembledLoop, rtol: float) -> CertifiedValue:
        """Value of the assembled loop; `rtol` is the relative distance of the sides of an H-infinity norm."""

    @abstractmethod
    def held(self: R, level: float) -> R:
        """The hard requirement that is just met where this one has the value `level`, above 0."""

    def softened(self: R) -> R:
        """The same requirement, minimised."""
        return replace(self, hard=False)  # type: ignore[type-var]

    @abstractmethod
    def on_image(self: R, model: System) -> R:
        """The requirement on the image of the discrete `model` in continuous time.

        See :func:`lftkit.systems.sampled.image.image_of`. The values of both are equal.
        """


def check_names(requirements: Sequence[TuningRequirement]) -> None:
    """Refuse an empty list and names used twice.

    Raises
    ------
    ValueError
        Naming what is wrong.
    """
    if not requirements:
        raise InputError("a design needs at least one requirement, got none")
    names = [r.name for r in requirements]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"requirement names must be unique, got {twice} twice")
