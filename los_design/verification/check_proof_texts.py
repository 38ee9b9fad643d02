"""Texts of a proof's file that a check prints: names, what a proof is about, requirements.

Whoever made the file chose them. One with line breaks, or with characters that control a terminal, could look like
lines of the check itself, so that a file with one is refused.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from typing import Any

from lftkit.proofs.trusted.proof import ProofFileError

REFUSED = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Categories of Unicode: controls, formats such as the direction of writing, half characters, ends of lines."""


def require_plain(content: Any, what: str) -> None:
    r"""Refuse a text with characters that are not printed, anywhere in some content of a file.

    Parameters
    ----------
    content : object
        Text, mapping or sequence of such; anything else has no text.
    what : str
        Its name in the message.

    Raises
    ------
    ProofFileError
        There is one.

    Examples
    --------
    >>> require_plain({"stage": "fsm+pma", "limit": 1e-7}, "about")
    >>> require_plain(["k\nproven: stable"], "names")
    Traceback (most recent call last):
    ...
    lftkit.proofs.trusted.proof.ProofFileError: names must have no control characters, got 'k\nproven: stable'
    """
    left = [content]
    while left:
        item = left.pop()
        if isinstance(item, Mapping):
            left += [*item.keys(), *item.values()]
        elif isinstance(item, (list, tuple, set, frozenset)):
            left += item
        elif isinstance(item, str) and any(unicodedata.category(c) in REFUSED for c in item):
            raise ProofFileError(f"{what} must have no control characters, got {item[:60]!a}")
