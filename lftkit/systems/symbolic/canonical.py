"""Controllable form of a fraction, whose coefficients are polynomials in uncertain elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lftkit.systems.symbolic.expressions import OPERATOR, Expression, constant, matrix
from lftkit.systems.symbolic.fractions import Fraction
from lftkit.uncertainty.elements import DynamicElement, Element


def controllable_form(fraction: Fraction, elements: Sequence[Element], dt: float) -> Expression:
    """An expression of the same function in which s occurs as often as the degree n of the denominator.

    With ``xi`` and its first n derivatives: ``D xi = u, y = N xi``. `fraction` is proper.
    """
    n = fraction.denominator.degree
    scalars = [e for e in elements if not isinstance(e, DynamicElement)]  # others have no fraction
    named = {e.name: Expression(np.array([[e.nominal]]), {e.name: np.eye(1)}, (), (e,)) for e in scalars}
    denominator, numerator = (
        [_coefficient(polynomial.coefficient(power), named) for power in range(n + 1)]
        for polynomial in (fraction.denominator, fraction.numerator)
    )
    chain = Expression(-np.eye(n, n + 1, 1), {OPERATOR: np.eye(n, n + 1)}, dt=dt)
    equations = matrix([[chain], [matrix([denominator])]]) if n else matrix([denominator])
    found: Expression = matrix([numerator]) @ equations.inverse() @ constant(np.eye(n + 1)[:, -1:])
    return found


def _coefficient(terms: Mapping[tuple[str, ...], float], named: Mapping[str, Expression]) -> Expression:
    """Sum of products of elements."""
    total = constant(np.zeros((1, 1)))
    for names, number in terms.items():
        product = constant(np.array([[number]]))
        for name in names:
            product = product * named[name]
        total = total + product
    return total
