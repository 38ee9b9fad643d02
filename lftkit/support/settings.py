"""Numbers of an algorithm that a caller may change: frozen dataclasses whose fields are checked."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from lftkit.errors import InputError
from lftkit.support.scalars import as_integer, as_positive, is_number


@dataclass(frozen=True)
class AlgorithmSettings:
    """Base of the settings of an algorithm.

    A field of one number must be positive and finite, an integer where its type is one; a field of several numbers must
    have finite numbers that are not negative.

    Raises
    ------
    ValueError
        A field that is not in its range; its name is in the message.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class SearchSettings(AlgorithmSettings):
    ...     steps: int = 20
    >>> SearchSettings(steps=0)
    Traceback (most recent call last):
    lftkit.errors.InputError: steps must be positive, got 0
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                if not all(is_number(number) and 0.0 <= number < np.inf for number in np.ravel(value)):
                    raise InputError(f"{field.name} must be finite numbers that are not negative, got {value!r}")
                continue
            as_positive(value, field.name)
            if isinstance(field.default, int):
                as_integer(value, field.name)
