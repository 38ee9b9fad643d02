"""Server of Foxglove's protocol (package foxglove-sdk): the bytes and schemas of the topics as they are."""

from __future__ import annotations

from collections.abc import Mapping

import foxglove
from foxglove import Channel, Context, Schema

from los_testbed.bags.schemas import DEFINITIONS

BACKLOG = 16_384
"""Messages that are kept for a viewer that is slow, about 2 s or 3 MB; of older ones it gets none."""


class FoxgloveServer:
    """One channel per topic; who subscribes is served in threads of the library, outside Python.

    Parameters
    ----------
    topics : mapping of str to str
        Message type of each topic.
    host, port : str, int
        Where to listen; port 0 takes a free one.

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """

    def __init__(self, topics: Mapping[str, str], host: str, port: int) -> None:
        self._context = Context()  # nothing else keeps it alive
        try:
            self._server = foxglove.start_server(
                name="los-testbed", host=host, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise ValueError(f"live port must be free on {host}, got {port} ({error})") from None
        self.port = int(self._server.port)
        self._channels = {
            topic: Channel(
                topic,
                schema=Schema(name=kind, encoding="ros2msg", data=DEFINITIONS[kind].encode()),
                message_encoding="cdr",
                context=self._context,
            )
            for topic, kind in topics.items()
        }

    def send(self, topic: str, data: bytes, time_ns: int) -> None:
        """Give a serialised message to those who have subscribed."""
        self._channels[topic].log(data, log_time=time_ns)

    def stop(self) -> None:
        """Close all connections."""
        self._server.stop()
