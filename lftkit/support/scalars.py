"""Single numbers that users give: what counts as one, and as one of Python, which files can keep."""

from __future__ import annotations

import operator
from numbers import Real
from typing import Any

import numpy as np

from lftkit.errors import InputError

LONGEST = 200
"""Characters of a message."""
LARGEST = int(np.finfo(float).max)
"""The largest double."""


def is_number(value: Any) -> bool:
    """Whether the value is one real number that a double holds; True and False are none."""
    if isinstance(value, int) and abs(value) > LARGEST:
        return False
    return isinstance(value, Real | np.number) and not isinstance(value, complex | np.complexfloating | bool)


def fits_64_bits(value: int) -> bool:
    """Whether numpy takes the integer for one: larger ones are objects for it."""
    return -(2**63) <= value < 2**63


def as_number(value: Any, what: str) -> float:
    """A real number, also one of numpy or of an array without axes, as one of Python.

    A ValueError that begins with `what` for anything else.
    """
    value = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if not is_number(value):
        raise InputError(f"{what} must be a finite real number, got {value!r}")
    if isinstance(value, int) and not fits_64_bits(value):  # for numpy an object
        value = float(value)
    return value if isinstance(value, int | float) else float(value)


def as_positive(value: Any, what: str) -> float:
    """A finite number above zero; a ValueError that begins with `what` for anything else."""
    if not (is_number(value) and 0.0 < value < np.inf):
        raise InputError(f"{what} must be positive, got {value!r}")
    return float(value)


def as_integer(value: Any, what: str) -> int:
    """An integer, also one of numpy, as one of Python; a ValueError that begins with `what` for anything else."""
    try:
        integer = operator.index(value)
    except TypeError:
        raise InputError(f"{what} must be an integer, got {value!r}") from None
    if not fits_64_bits(integer):
        raise InputError(f"{what} must be an integer within 64 bits, got {integer!r}"[:LONGEST])
    return integer
