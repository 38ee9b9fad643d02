"""Numbers as text: the same digits on the screen, on pages and in files."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

ABSENT = "–"
"""In place of a number that does not exist."""
UNBOUNDED = "no bound"
"""In place of an infinite one."""
EXACT = 14
"""Significant digits of a double that count: later ones are those of the conversion between units."""


def digits(value: float | None, places: int = 3, none: str = ABSENT, infinite: str = UNBOUNDED) -> str:
    """Number for a table: a few significant digits, no power of ten for large ones.

    Parameters
    ----------
    value : None and NaN give `none`, infinities `infinite`
    places : significant digits; numbers with more before the point, and those above 1000, are rounded to a whole number
    none, infinite : in place of a number

    Examples
    --------
    >>> [digits(value) for value in (12.3456, 999.6, -1234567.8, 0.0, math.nan, math.inf)]
    ['12.3', '1000', '-1234568', '0', '–', 'no bound']
    >>> digits(99.6, 2), digits(99.4, 2)
    ('100', '99')
    """
    if value is None or math.isnan(value):
        return none
    if math.isinf(value):
        return infinite
    whole = min(10.0**places - 0.5, 1000.0 - 0.5 * 10.0 ** (3 - places))  # what would be rounded to a power of ten
    return f"{value:.0f}" if abs(value) >= whole else f"{value:.{places}g}"


def digits_beside(value: float, limit: float) -> str:
    """As :func:`digits`, with as many more as show on which side of the limit the value is.

    Examples
    --------
    >>> [digits_beside(value, 40.0) for value in (41.23, 40.0026, 39.9996, 40.0)]
    ['41.2', '40.003', '39.9996', '40']
    """
    if math.isinf(value):
        return f"{value:g}"
    if math.isnan(value) or value == limit:
        return digits(value)
    texts = (digits(value, places) for places in range(3, 17))
    return next((text for text in texts if (float(text) - limit) * (value - limit) > 0.0), repr(value))


def percent(share: float, places: int = 3) -> str:
    """A share in percent; a dash where there is none.

    Examples
    --------
    >>> percent(0.12345), percent(math.nan), percent(12.0)
    ('12.3 %', '–', '1200 %')
    """
    return ABSENT if math.isnan(share) else f"{digits(100 * share, places)} %"


def with_unit(text: str, unit: str) -> str:
    """A number with its unit, alone where it has none."""
    return f"{text} {unit}" if unit else text


def number(value: float) -> float | None:
    """Six digits for JSON; infinities and NaN become None."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def at_most(value: float, digits: int = 4) -> str:
    """A bound from above with some significant digits, rounded up.

    Examples
    --------
    >>> at_most(0.49200001), at_most(0.492), at_most(3141.592653589793, 6), at_most(-1.00001), at_most(1e-7, 3)
    ('0.4921', '0.492', '3141.6', '-1', '1e-07')
    """
    return _rounded(value, digits, ROUND_CEILING)


def at_least(value: float, digits: int = 4) -> str:
    """A bound from below, such as a margin that is guaranteed, rounded down.

    Examples
    --------
    >>> at_least(0.49199999), at_least(0.492), at_least(28.957), at_least(float("inf"))
    ('0.4919', '0.492', '28.95', 'inf')
    """
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: float, digits: int, side: str) -> str:
    known = Decimal(f"{value:.{EXACT}g}")
    rounded = Context(prec=digits, rounding=side).plus(known) if known.is_finite() else known
    return f"{float(rounded):.{digits}g}"
