"""Real parameters that are uncertain or vary slowly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class RealParameter:
    """A real parameter with its nominal value and its range.

    Parameters
    ----------
    name : str
        Unique; blocks that use the same name move together.
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
    The map to [-1, 1] keeps both ends and the nominal value, also for lopsided ranges:

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
        if not self.name:
            raise ValueError("a parameter needs a name, got an empty string")
        if not all(math.isfinite(v) for v in (self.nominal, self.lower, self.upper)):
            raise ValueError(f"parameter {self.name!r}: nominal, lower and upper must be finite numbers")
        if not self.lower <= self.nominal <= self.upper:
            raise ValueError(
                f"parameter {self.name!r}: expected lower <= nominal <= upper, "
                f"got {self.lower} <= {self.nominal} <= {self.upper} {self.unit}"
            )

    def check(self, value: float) -> float:
        """Return `value` as a float.

        Raises
        ------
        ValueError
            Not a number in [lower, upper] (a rounding error of 1e-12 of the range is let through).
        """
        number = float(value)
        slack = 1e-12 * max(self.upper - self.lower, abs(self.nominal))
        if not self.lower - slack <= number <= self.upper + slack:
            raise ValueError(
                f"parameter {self.name!r}: expected a value in [{self.lower:g}, {self.upper:g}] {self.unit}, "
                f"got {number:g}"
            )
        return number

    @property
    def bilinear(self) -> tuple[float, float]:
        """Coefficients (a, b) of ``value - nominal = a nu / (1 + b nu)`` with nu in [-1, 1].

        With one side of zero width the map would degenerate; then nu runs over the other side only
        through the affine map with half of it unused: a = the larger side, b = 0.
        """
        up, down = self.upper - self.nominal, self.nominal - self.lower
        if up == 0.0 or down == 0.0:
            return up + down, 0.0
        return 2.0 * up * down / (up + down), (down - up) / (down + up)

    def from_normalised(self, nu: float) -> float:
        """Physical value that belongs to the normalised one, nu in [-1, 1]."""
        a, b = self.bilinear
        return self.nominal + a * nu / (1.0 + b * nu)

    def to_normalised(self, value: float) -> float:
        """Normalised value in [-1, 1] that belongs to a physical one."""
        a, b = self.bilinear
        deviation = self.check(value) - self.nominal
        return 0.0 if deviation == 0.0 else deviation / (a - b * deviation)


def parameter_table(parameters: Iterable[RealParameter]) -> dict[str, RealParameter]:
    """Parameters by name.

    Raises
    ------
    ValueError
        One name with two different definitions.
    """
    table: dict[str, RealParameter] = {}
    for parameter in parameters:
        known = table.setdefault(parameter.name, parameter)
        if known != parameter:
            raise ValueError(
                f"parameter {parameter.name!r} has two definitions: nominal {known.nominal:g} in "
                f"[{known.lower:g}, {known.upper:g}] {known.unit} and nominal {parameter.nominal:g} in "
                f"[{parameter.lower:g}, {parameter.upper:g}] {parameter.unit}"
            )
    return table


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
        raise ValueError(f"unknown parameter {unknown[0]!r}, expected one of: {', '.join(parameters) or '(none)'}")
    result = {}
    for name, parameter in parameters.items():
        value = float(values.get(name, parameter.nominal))
        result[name] = value if beyond_range and math.isfinite(value) else parameter.check(value)
    return result
