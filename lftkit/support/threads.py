"""Linear algebra on one thread."""

from __future__ import annotations

import importlib
import os
import sys
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped, unused-ignore]

THREADS = "OPENBLAS_NUM_THREADS"
"""Environment variable: with 1, as commands and nodes have it, a library has one thread from the start."""


def one_thread() -> AbstractContextManager[Any]:
    """Context with one thread of linear algebra: two add up in another order, with other last bits."""
    if os.environ.get(THREADS) != "1":
        importlib.import_module(
            "scipy.linalg"
        )  # a library that is loaded inside the context would have its own threads
    limit: AbstractContextManager[Any] = _controller("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas")
    return limit


@cache
def _controller(with_scipy: bool) -> Any:
    """The libraries of this process, scipy's beside numpy's if it is loaded: to look for them takes 6 ms."""
    return ThreadpoolController()
