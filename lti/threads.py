"""Linear algebra on one thread."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped, unused-ignore]


def one_thread() -> AbstractContextManager[Any]:
    """Context with one thread of linear algebra: two add up in another order, with other last bits."""
    limit: AbstractContextManager[Any] = threadpool_limits(limits=1, user_api="blas")
    return limit
