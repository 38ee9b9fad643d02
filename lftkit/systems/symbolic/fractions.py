"""Fractions of polynomials in s (or z) and in scalar elements, and their realisation in controllable form.

Beside its linear system an expression of one row and column keeps its fraction: where s occurs more often than there
are states, as in ``D2 / (D1 D2 - q^2)``, the linear system is singular, and the fraction is realised instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Term = tuple[int, tuple[str, ...]]
"""Power of s, and names of elements, each as often as its power, in order."""

MOST_TERMS = 2000
"""Of a polynomial: above it the fraction is given up."""


@dataclass(frozen=True)
class ElementPolynomial:
    """Sum of terms with their numbers."""

    terms: Mapping[Term, float] = field(default_factory=dict)

    def __add__(self, other: ElementPolynomial) -> ElementPolynomial:
        found = dict(self.terms)
        for term, number in other.terms.items():
            found[term] = found.get(term, 0.0) + number
        return ElementPolynomial({term: number for term, number in found.items() if number})

    def __mul__(self, other: ElementPolynomial) -> ElementPolynomial:
        found: dict[Term, float] = {}
        for (power, names), number in self.terms.items():
            for (more, others), factor in other.terms.items():
                term = power + more, tuple(sorted(names + others))
                found[term] = found.get(term, 0.0) + number * factor
        return ElementPolynomial({term: number for term, number in found.items() if number})

    @property
    def degree(self) -> int:
        """Highest power of s; -1 of zero."""
        return max((power for power, _ in self.terms), default=-1)

    def coefficient(self, power: int) -> dict[tuple[str, ...], float]:
        """What stands before a power of s: products of elements with their numbers."""
        return {names: number for (own, names), number in self.terms.items() if own == power}


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
        """Sum; over the same denominator where there is one."""
        if self.denominator == other.denominator:
            return _kept(self.numerator + other.numerator, self.denominator)
        crossed = self.numerator * other.denominator + other.numerator * self.denominator
        return _kept(crossed, self.denominator * other.denominator)

    def times(self, other: Fraction) -> Fraction | None:
        """Product."""
        return _kept(self.numerator * other.numerator, self.denominator * other.denominator)

    def inverse(self) -> Fraction | None:
        """Denominator over numerator; None of zero."""
        return Fraction(self.denominator, self.numerator) if self.numerator.terms else None


def _kept(numerator: ElementPolynomial, denominator: ElementPolynomial) -> Fraction | None:
    few = max(len(numerator.terms), len(denominator.terms)) <= MOST_TERMS
    return Fraction(numerator, denominator) if few else None
