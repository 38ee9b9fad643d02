"""What expressions are made of: s, z, and real, complex and dynamic elements."""

from __future__ import annotations

from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.scalars import as_number, as_positive, is_number
from lftkit.systems.arguments import checked
from lftkit.systems.symbolic.expressions import Expression, scalar, variable
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, RealParameter


@checked
def real(
    name: str,
    nominal: float,
    lower: float | None = None,
    upper: float | None = None,
    *,
    percent: float | tuple[float, float] | None = None,
    plus_minus: float | tuple[float, float] | None = None,
    unit: str = "1",
    description: str = "",
) -> Expression:
    """A real number in a range (`ureal` in MATLAB).

    Parameters
    ----------
    name : str
        Expressions of the same name are the same number.
    nominal : float
    lower, upper : float, optional
        Ends of the range; one way of giving it is needed.
    percent, plus_minus : float or (float, float), optional
        The range as deviations from the nominal value, relative [%] or absolute; two numbers are those of both ends.

    Raises
    ------
    ValueError
        No range or two, or a nominal value outside it.

    Examples
    --------
    >>> real("k", 10.0, percent=(-20, 50)).elements[0]
    RealParameter(name='k', nominal=10.0, lower=8.0, upper=15.0, unit='1', description='')
    """
    ways = [percent is not None, plus_minus is not None, lower is not None or upper is not None]
    if sum(ways) != 1 or (lower is None) != (upper is None):
        raise InputError(f"range of {name!r} must be given once: lower and upper, percent, or plus_minus")
    if lower is None or upper is None:
        size: Any = percent if percent is not None else plus_minus
        ends = (-size, size) if is_number(size) else tuple(size) if np.shape(size) == (2,) else ()
        if not (ends and all(map(is_number, ends))):
            raise InputError(f"range of {name!r} must be one number or those of both ends, got {size!r}")
        middle = as_number(nominal, f"parameter {name!r}: nominal")
        if percent is not None and middle == 0.0:
            raise InputError(f"range of {name!r} must be lower and upper or plus_minus, got percent of nominal 0")
        scale = abs(middle) / 100.0 if percent is not None else 1.0
        lower, upper = middle + float(ends[0]) * scale, middle + float(ends[1]) * scale
    return scalar(RealParameter(name, nominal, lower, upper, unit, description))


@checked
def complex_gain(name: str, nominal: float, radius: float, *, unit: str = "1", description: str = "") -> Expression:
    """A constant complex number within `radius` of `nominal` (`ucomplex` in MATLAB): :class:`ComplexParameter`."""
    element = ComplexParameter(name, nominal, radius, unit, description)
    return scalar(element)


@checked
def dynamic(name: str, outputs: int = 1, inputs: int = 1, *, bound: float = 1.0, description: str = "") -> Expression:
    """Any stable system of gain at most `bound` (`ultidyn` in MATLAB), nominal 0: :class:`DynamicElement`."""
    element = DynamicElement(name, outputs, inputs, bound, description)
    if outputs == inputs == 1:
        return scalar(element)
    return Expression(np.zeros((outputs, inputs)), {}, ((name, np.eye(outputs), np.eye(inputs)),), (element,))


s = variable()
"""The Laplace variable: differentiation."""


@checked
def z(dt: float) -> Expression:
    """The variable of discrete time with the period `dt` [s]: one tick ahead.

    Examples
    --------
    >>> (1 / (z(0.1) - 0.5)).system().poles().real.tolist()
    [0.5]
    """
    return variable(as_positive(dt, "dt"))
