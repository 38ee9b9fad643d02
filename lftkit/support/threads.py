"""Linear algebra on one thread."""

from __future__ import annotations

import importlib
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped, unused-ignore]


def one_thread() -> AbstractContextManager[Any]:
    """Context with one thread of linear algebra: two add up in another order, with other last bits."""
    limit: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return limit


@cache
def _controller() -> Any:
    """The libraries of this process, scipy's beside numpy's: to look for them takes 6 ms."""
    importlib.import_module("scipy.linalg")
    return ThreadpoolController()
