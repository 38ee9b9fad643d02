"""Names of file formats, those of earlier versions among them."""

from __future__ import annotations

from typing import TypeVar

EARLIER_NAMES = {
    "los-testbed/sampled-system": "lftkit/sampled-system",
    "los-testbed proof 1": "lftkit proof 1",
    "los-testbed proof in discrete time 1": "lftkit proof in discrete time 1",
    "los-testbed loop proof 1": "lftkit loop proof 1",
    "los-testbed noise proof 2": "lftkit noise proof 2",
}
"""Present name of each format that files of versions up to 0.1 have under another one."""

Name = TypeVar("Name")


def current_name(name: Name) -> Name | str:
    """Present name of the format that a file names; anything else as it is given.

    Examples
    --------
    >>> [current_name(name) for name in (*list(EARLIER_NAMES)[:1], "lftkit/system", None)]
    ['lftkit/sampled-system', 'lftkit/system', None]
    """
    return EARLIER_NAMES.get(name, name) if isinstance(name, str) else name


__all__ = ["EARLIER_NAMES", "current_name"]
