"""Fractions of polynomials in s (or z) and in scalar elements, and their realisation in controllable form.

Beside its linear system an expression of one row and column keeps its fraction: where s occurs more often than there
are states, as in ``D2 / (D1 D2 - q^2)``, the linear system is singular, and the fraction is realised instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Term = tuple[int, tuple[str, ...]]
"""Power of s, and names of elements, each as often as its power, in order."""


@dataclass(frozen=True)
class ElementPolynomial:
    """Sum of terms with their numbers."""

    terms: Mapping[Term, float] = field(default_factory=dict)

    def __add__(self, other: ElementPolynomial) -> ElementPolynomial:
        return _summed([*self.terms.items(), *other.terms.items()])

    def __mul__(self, other: ElementPolynomial) -> ElementPolynomial:
        return _summed(
            ((power + more, tuple(sorted(names + others))), number * factor)
            for (power, names), number in self.terms.items()
            for (more, others), factor in other.terms.items()
        )

    @property
    def degree(self) -> int:
        """Highest power of s; -1 of zero."""
        return max((power for power, _ in self.terms), default=-1)

    def coefficient(self, power: int) -> dict[tuple[str, ...], float]:
        """Coefficient of a power of s: products of elements with their numbers."""
        return {names: number for (degree, names), number in self.terms.items() if degree == power}


def _summed(terms: Iterable[tuple[Term, float]]) -> ElementPolynomial:
    """The polynomial of terms that may be equal; what is left of those that cancel is rounding."""
    total: dict[Term, float] = {}
    largest: dict[Term, float] = {}
    for term, number in terms:
        total[term] = total.get(term, 0.0) + number
        largest[term] = max(largest.get(term, 0.0), abs(number))
    return ElementPolynomial({term: number for term, number in total.items() if abs(number) > 1e-13 * largest[term]})


@dataclass(frozen=True)
class Fraction:
    """Numerator over denominator."""

    numerator: ElementPolynomial
    denominator: ElementPolynomial

    @classmethod
    def of(cls, number: float, power: int = 0, names: tuple[str, ...] = ()) -> Fraction:
        """A number times a power of s and elements."""
        terms = {(power, names): float(number)} if number else {}
        return cls(ElementPolynomial(terms), ElementPolynomial({(0, ()): 1.0}))

    @property
    def is_proper(self) -> bool:
        """Whether the degree of the numerator is at most that of the denominator."""
        return 0 <= self.denominator.degree >= self.numerator.degree

    def plus(self, other: Fraction) -> Fraction | None:
        """Sum; over the same denominator where there is one. None where there are too many terms."""
        if self.denominator == other.denominator:
            return Fraction(self.numerator + other.numerator, self.denominator)
        if not self._short(other):
            return None
        crossed = self.numerator * other.denominator + other.numerator * self.denominator
        return Fraction(crossed, self.denominator * other.denominator)

    def times(self, other: Fraction) -> Fraction | None:
        """Product; None where there are too many terms."""
        if not self._short(other):
            return None
        return Fraction(self.numerator * other.numerator, self.denominator * other.denominator)

    def _short(self, other: Fraction) -> bool:
        """Whether products of their polynomials have few terms."""
        longest = (max(len(f.numerator.terms), len(f.denominator.terms)) for f in (self, other))
        return math.prod(longest) <= 10_000  # of a product, before equal ones are summed

    def inverse(self) -> Fraction | None:
        """Denominator over numerator; None of zero."""
        return Fraction(self.denominator, self.numerator) if self.numerator.terms else None


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
