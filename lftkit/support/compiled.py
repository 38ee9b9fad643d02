"""Functions that numba compiles; a module with such functions is imported only where numba is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compiled at its first call, or read from the cache; without a cache where none can be written."""
    try:
        made = njit(cache=True, fastmath=False)(function)
    except RuntimeError:  # no folder for a cache
        made = njit(fastmath=False)(function)
    return made  # type: ignore[no-any-return]
