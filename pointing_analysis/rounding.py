"""Numbers as text that are rounded to the side on which a statement stays true."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

EXACT = 14
"""Significant digits of a double that count: later ones are those of the conversion between units."""


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
