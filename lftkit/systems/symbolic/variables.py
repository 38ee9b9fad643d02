"""What expressions are made of: s, z, and real, complex and dynamic elements."""

from __future__ import annotations

import numpy as np

from lftkit.errors import InputError
from lftkit.support.scalars import is_number
from lftkit.systems.symbolic.expressions import Expression, scalar, variable
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement
from lftkit.uncertainty.parameters import RealParameter


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
    given = [percent is not None, plus_minus is not None, lower is not None or upper is not None]
    if sum(given) != 1 or (lower is None) != (upper is None):
        raise InputError(f"range of {name!r} must be given once: lower and upper, percent, or plus_minus")
    if lower is None or upper is None:
        size = percent if percent is not None else plus_minus
        ends = (-float(size), float(size)) if is_number(size) else tuple(float(x) for x in size)  # type: ignore
        scale = abs(nominal) / 100.0 if percent is not None else 1.0
        lower, upper = nominal + ends[0] * scale, nominal + ends[1] * scale
    element = RealParameter(name, float(nominal), float(lower), float(upper), unit, description)
    return scalar(element)


def complex_gain(name: str, nominal: float, radius: float, *, unit: str = "1", description: str = "") -> Expression:
    """A constant complex number within `radius` of `nominal` (`ucomplex` in MATLAB): :class:`ComplexParameter`."""
    element = ComplexParameter(name, nominal, radius, unit, description)
    return scalar(element)


def dynamic(name: str, outputs: int = 1, inputs: int = 1, *, bound: float = 1.0, description: str = "") -> Expression:
    """Any stable system of gain at most `bound` (`ultidyn` in MATLAB), nominal 0: :class:`DynamicElement`."""
    element = DynamicElement(name, outputs, inputs, bound, description)
    if outputs == inputs == 1:
        return scalar(element)
    return Expression(np.zeros((outputs, inputs)), {}, ((name, np.eye(outputs), np.eye(inputs)),), (element,))


s = variable()
"""The Laplace variable: differentiation."""


def z(dt: float) -> Expression:
    """The variable of discrete time with the period `dt` [s]: one tick ahead.

    Examples
    --------
    >>> (1 / (z(0.1) - 0.5)).system().poles().real.tolist()
    [0.5]
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"dt must be positive, got {dt}")
    return variable(float(dt))
