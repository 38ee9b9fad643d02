"""Connections that have not yet done anything: their number is limited, the oldest is closed for a new one."""

from __future__ import annotations

from collections import OrderedDict

from tornado.iostream import IOStream


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
