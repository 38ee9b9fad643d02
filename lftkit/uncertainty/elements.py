"""Uncertain elements: real and complex parameters with nominal value and range, and unmodelled dynamics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, as_number, as_positive


@dataclass(frozen=True)
class RealParameter:
    """A real parameter with its nominal value and its range.

    Parameters
    ----------
    name : str
        Unique; blocks that use the same name share the parameter.
    nominal, lower, upper : float
        ``lower <= nominal <= upper``, in `unit`.
    unit : str
        SI unit.
    description : str
        One line for tables and help texts.

    Raises
    ------
    ValueError
        Not finite, or a nominal value outside its range.

    Examples
    --------
    The map to [-1, 1] keeps both ends and the nominal value, also for asymmetric ranges:

    >>> k = RealParameter("stiffness", 1.0, 0.9, 1.4, "N/m")
    >>> [round(k.from_normalised(v), 12) for v in (-1, 0, 1)]
    [0.9, 1.0, 1.4]
    """

    name: str
    nominal: float
    lower: float
    upper: float
    unit: str = "1"
    description: str = ""

    def __post_init__(self) -> None:
        _check_name(self.name, "a parameter")
        for key in ("nominal", "lower", "upper"):
            object.__setattr__(self, key, as_number(getattr(self, key), f"parameter {self.name!r}: {key}"))
        bounds = (self.lower, self.nominal, self.upper)
        if not all(math.isfinite(v) for v in bounds):
            raise InputError(f"parameter {self.name!r}: lower, nominal and upper must be finite, got {bounds}")
        if not self.lower <= self.nominal <= self.upper:
            raise InputError(
                f"parameter {self.name!r} must have lower <= nominal <= upper, "
                f"got {self.lower} <= {self.nominal} <= {self.upper}{self.in_unit}"
            )

    def check(self, value: float) -> float:
        """Return `value` as a float.

        Raises
        ------
        ValueError
            Not a number in [lower, upper] (a rounding error of 1e-12 of the range is accepted).
        """
        number = float(value)
        slack = 1e-12 * max(self.upper - self.lower, abs(self.nominal))
        if not self.lower - slack <= number <= self.upper + slack:
            raise InputError(
                f"parameter {self.name!r} must be in [{self.lower:g}, {self.upper:g}]{self.in_unit}, got {number:g}"
            )
        return number

    @property
    def in_unit(self) -> str:
        """The unit behind a number; nothing for a plain number."""
        return "" if self.unit == "1" else f" {self.unit}"

    @property
    def bilinear(self) -> tuple[float, float]:
        """Coefficients (a, b) of ``value - nominal = a nu / (1 + b nu)`` with nu in [-1, 1].

        If one side of the range has zero width the bilinear map is singular; then the map is affine, with a the
        width of the other side and b = 0, and half of the interval of nu is not used.
        """
        up, down = self.upper - self.nominal, self.nominal - self.lower
        if up == 0.0 or down == 0.0:
            return up + down, 0.0
        return 2.0 * up * down / (up + down), (down - up) / (down + up)

    def from_normalised(self, nu: float) -> float:
        """Physical value of the normalised value nu in [-1, 1]."""
        a, b = self.bilinear
        return self.nominal + a * nu / (1.0 + b * nu)


def checked_values(
    parameters: Mapping[str, RealParameter], values: Mapping[str, float], *, beyond_range: bool = False
) -> dict[str, float]:
    """Value of every parameter: the given one, else the nominal one.

    Raises
    ------
    ValueError
        An unknown name, or a value outside its range unless `beyond_range`.
    """
    unknown = sorted(set(values) - set(parameters))
    if unknown:
        raise InputError(f"parameter must be one of {', '.join(parameters) or '(none)'}, got {unknown[0]!r}")
    result = {}
    for name, parameter in parameters.items():
        value = as_number(values.get(name, parameter.nominal), f"parameter {name!r}")
        result[name] = value if beyond_range and math.isfinite(value) else parameter.check(value)
    return result


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
        as_positive(self.radius, f"element {self.name!r}: radius")

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
        as_positive(self.bound, f"element {self.name!r}: bound")


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


def _check_name(name: str, kind: str = "an element") -> None:
    if not isinstance(name, str):
        raise InputError(f"name of {kind} must be text, got {name!r}")
    if not name:
        raise InputError(f"name of {kind} must not be empty, got ''")
