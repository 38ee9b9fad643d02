"""Processor time of a call."""

from __future__ import annotations

import time
from collections.abc import Callable


def least(run: Callable[[], object], repeats: int = 5) -> float:
    """Processor seconds of a call, the least of some measurements."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return min(seconds)
