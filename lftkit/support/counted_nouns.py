"""Counts in messages: the number agrees with its noun."""

from __future__ import annotations


def counted(count: int, noun: str, rest: str = "") -> str:
    """A count with its noun, in the plural but for one; `rest` follows the noun.

    Examples
    --------
    >>> counted(1, "gap"), counted(2, "gap"), counted(0, "sample", " missing")
    ('1 gap', '2 gaps', '0 samples missing')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}{rest}"
