"""Uncertain elements beside the real parameter: complex parameters and unmodelled dynamics."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, as_number
from lftkit.uncertainty.parameters import RealParameter


@dataclass(frozen=True)
class ComplexParameter:
    """A constant complex number in a disk: ``|value - nominal| <= radius`` (`ucomplex` in MATLAB).

    Parameters
    ----------
    name : str
        Unique; elements of the same name are the same number.
    nominal : float
        Centre of the disk, real.
    radius : float
        Positive.
    unit, description : str

    Raises
    ------
    ValueError
        A centre that is no finite real number, or a radius that is not positive.
    """

    name: str
    nominal: float
    radius: float
    unit: str = "1"
    description: str = ""

    def __post_init__(self) -> None:
        _check_name(self.name)
        for key in ("nominal", "radius"):
            object.__setattr__(self, key, as_number(getattr(self, key), f"element {self.name!r}: {key}"))
        if not math.isfinite(self.nominal):
            raise InputError(f"element {self.name!r}: nominal must be a finite real number, got {self.nominal}")
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"element {self.name!r}: radius must be positive, got {self.radius}")

    def check(self, value: complex) -> complex:
        """Return `value`; a ValueError says that it is not in the disk (to 1e-12 of its radius)."""
        if not abs(value - self.nominal) <= self.radius * (1 + 1e-12):
            raise InputError(
                f"element {self.name!r} must be within {self.radius:g} of {self.nominal:g}, got {complex(value):g}"
            )
        return value


@dataclass(frozen=True)
class DynamicElement:
    """Any stable linear system with a gain of at most `bound` at every frequency (`ultidyn` in MATLAB); nominal 0.

    Parameters
    ----------
    name : str
        Unique; elements of the same name are the same system.
    outputs, inputs : int
        Sizes, at least 1.
    bound : float
        Largest singular value, positive.
    description : str

    Raises
    ------
    ValueError
        A size below 1 or a bound that is not positive.
    """

    name: str
    outputs: int = 1
    inputs: int = 1
    bound: float = 1.0
    description: str = ""

    def __post_init__(self) -> None:
        _check_name(self.name)
        for key in ("outputs", "inputs"):
            object.__setattr__(self, key, as_integer(getattr(self, key), f"element {self.name!r}: {key}"))
        object.__setattr__(self, "bound", as_number(self.bound, f"element {self.name!r}: bound"))
        if self.outputs < 1 or self.inputs < 1:
            raise InputError(f"element {self.name!r}: sizes must be at least 1, got {self.outputs} x {self.inputs}")
        if not (math.isfinite(self.bound) and self.bound > 0):
            raise InputError(f"element {self.name!r}: bound must be positive, got {self.bound}")


Element = RealParameter | ComplexParameter | DynamicElement


def width(element: Element) -> int:
    """Delta channels of one occurrence: 1, of a matrix of dynamics its larger size (the rest is zero)."""
    return max(element.outputs, element.inputs) if isinstance(element, DynamicElement) else 1


def description(element: Element) -> str:
    """Nominal value and range in words.

    Examples
    --------
    >>> description(RealParameter("k", 1.0, 0.5, 2.0, "N/m"))
    'real, 1 in [0.5, 2] N/m'
    """
    if isinstance(element, RealParameter):
        return f"real, {element.nominal:.6g} in [{element.lower:.6g}, {element.upper:.6g}]{element.in_unit}"
    if isinstance(element, ComplexParameter):
        return f"complex, within {element.radius:.6g} of {element.nominal:.6g}"
    return f"dynamic {element.outputs} x {element.inputs}, gain at most {element.bound:.6g}"


def element_table(elements: Iterable[Element]) -> dict[str, Element]:
    """Elements by name.

    Raises
    ------
    ValueError
        One name with two different definitions.
    """
    table: dict[str, Element] = {}
    for element in elements:
        known = table.setdefault(element.name, element)
        if known != element:
            kind = "parameter" if isinstance(known, RealParameter) and isinstance(element, RealParameter) else "element"
            raise InputError(
                f"{kind} {element.name!r} must have one definition, got two: {description(known)} and "
                f"{description(element)}"
            )
    return table


def _check_name(name: str) -> None:
    if not isinstance(name, str):
        raise InputError(f"name of an element must be text, got {name!r}")
    if not name:
        raise InputError("name of an element must not be empty, got ''")
