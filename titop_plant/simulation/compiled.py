"""Functions that numba compiles; a module with such functions is imported only where numba is installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compiled at its first call, or read from the cache; without a cache where none can be written."""
    try:
        made = njit(cache=True, fastmath=False)(function)
    except RuntimeError:  # no folder for a cache
        return njit(fastmath=False)(function)  # type: ignore[no-any-return]
    _drop_unreadable(made)
    return made  # type: ignore[no-any-return]


def _drop_unreadable(made: Any) -> None:
    """Remove the index of a cache that names types which are no longer there: numba would end the call in an error."""
    file = getattr(getattr(made, "_cache", None), "_cache_file", None)
    if file is None:  # another version of numba
        return
    try:
        file.load(None)
    except OSError:
        return
    except Exception:  # of unpickling, which raises whatever the content leads to
        Path(file._index_path).unlink(missing_ok=True)
