"""Real parameters that are uncertain or vary slowly, with nominal value and range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.scalars import as_number


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
        if not isinstance(self.name, str):
            raise InputError(f"name of a parameter must be text, got {self.name!r}")
        if not self.name:
            raise InputError("name of a parameter must not be empty, got ''")
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
