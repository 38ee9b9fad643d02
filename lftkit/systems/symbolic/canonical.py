"""Controllable form of a fraction, whose coefficients are polynomials in uncertain elements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lftkit.systems.symbolic.fractions import Fraction


def controllable_form(
    fraction: Fraction, operator: Any, elements: Mapping[str, Any], matrix: Callable[[Any], Any]
) -> Any:
    """An expression of the same function in which s occurs as often as the degree n of the denominator.

    With ``xi`` and its first n derivatives: ``D xi = u, y = N xi``.

    Parameters
    ----------
    fraction : Fraction
        Proper.
    operator : Expression
        s or z.
    elements : mapping of str to Expression
    matrix : callable
        From rows of expressions and numbers to an expression.
    """
    n = fraction.denominator.degree
    denominator, numerator = (
        [_coefficient(polynomial.coefficient(power), elements) for power in range(n + 1)]
        for polynomial in (fraction.denominator, fraction.numerator)
    )
    chain = [[operator if j == i else -1.0 * (j == i + 1) for j in range(n + 1)] for i in range(n)]
    return matrix([numerator]) @ matrix([*chain, denominator]).inverse() @ np.eye(n + 1)[:, -1:]


def _coefficient(terms: Mapping[tuple[str, ...], float], elements: Mapping[str, Any]) -> Any:
    """Sum of products of elements: an expression, or a number."""
    total: Any = 0.0
    for names, number in terms.items():
        product: Any = number
        for name in names:
            product = product * elements[name]
        total = total + product
    return total
