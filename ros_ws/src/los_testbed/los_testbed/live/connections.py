"""Idle connections: their number is limited, the oldest is closed for a new one."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import TypeVar

from tornado.iostream import IOStream

from los_testbed.live.access import MAX_VIEWERS

Viewer = TypeVar("Viewer")


def place_is_free(
    viewers: list[Viewer] | set[Viewer],
    active: Callable[[Viewer], float],
    stale_s: float,
    close: Callable[[Viewer], None],
) -> bool:
    """Whether one more viewer can be served; the least recently active one is closed for it if it is stale.

    Parameters
    ----------
    viewers : list or set
        Those that are served; the closed one is removed.
    active : callable
        Time at which a viewer gave its last sign of life, of `time.monotonic` [s].
    stale_s : float
        A viewer that has been silent so long is stale [s].
    close : callable
    """
    if len(viewers) < MAX_VIEWERS:
        return True
    oldest = min(viewers, key=active)
    if time.monotonic() - active(oldest) < stale_s:
        return False
    viewers.remove(oldest)
    close(oldest)
    return True


class SilentConnections:
    """Connections in the order of their last sign of life.

    Parameters
    ----------
    limit : int
        Largest number; the least recently active one is closed for another.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._streams: OrderedDict[IOStream, None] = OrderedDict()

    def add(self, stream: IOStream) -> None:
        """A new connection, or a sign of life of one that is known."""
        self._streams[stream] = None
        self._streams.move_to_end(stream)
        if len(self._streams) <= self._limit:
            return
        for other in [other for other in self._streams if other.closed()]:
            del self._streams[other]
        while len(self._streams) > self._limit:
            self._streams.popitem(last=False)[0].close()

    def remove(self, stream: IOStream) -> None:
        """It is a viewer now, or closed."""
        self._streams.pop(stream, None)

    def close(self) -> None:
        """Close all."""
        while self._streams:
            self._streams.popitem()[0].close()
