"""Bounds as text are never on the other side of their number."""

from __future__ import annotations

import math
import random
from fractions import Fraction

from pointing_analysis.formatting.number_text import at_least, at_most


def test_a_bound_from_above_is_rounded_up_and_one_from_below_down() -> None:
    """By no more than one unit of the last digit, and beyond the rounding of units, 1e-14."""
    chance = random.Random(0)
    for _ in range(3000):
        value = chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-12.0, 12.0)
        digits = chance.randrange(2, 8)
        above, below = float(at_most(value, digits)), float(at_least(value, digits))
        slack = Fraction(abs(value)) / 10**13
        assert Fraction(below) - slack <= Fraction(value) <= Fraction(above) + slack
        assert above - below <= 1.0001 * 10.0 ** (math.floor(math.log10(abs(value))) + 2 - digits)


def test_what_has_so_few_digits_stays() -> None:
    for text in ("0.492", "9.947", "1e-07", "40", "0", "0.001", "1093"):
        assert at_most(float(text)) == at_least(float(text)) == text
    assert (at_most(math.inf), at_least(-math.inf)) == ("inf", "-inf")
    assert (at_most(0.1 * 3.0, 4), at_least(0.1 * 3.0, 4)) == ("0.3", "0.3"), "rounding of units"
    assert (at_most(0.44400046), at_least(0.44399999)) == ("0.4441", "0.4439")
