"""The server for viewers beside a run: where it listens, whom it serves, what it shows."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from lftkit.errors import InputError

LIVE = "live"
"""Name of the node that serves viewers."""


@dataclass(frozen=True)
class Live:
    """Server for viewers beside a run.

    Attributes
    ----------
    host, port : where it listens; port 0 takes two free ones
    tell : gets its addresses, Foxglove's and that of the page
    origins : sites whose pages may connect by Foxglove's protocol, beside those of this machine and of Foxglove
    topics : relative names of the topics that are served; empty for all
    tls_cert, tls_key : files of a certificate and its key; empty for connections without encryption
    foxglove_sockets, page_sockets : descriptors of sockets that listen already and are inherited; empty: the server
        opens its own
    """

    host: str = "127.0.0.1"
    port: int = 8765
    tell: Callable[[str, str], None] = lambda foxglove, page: None
    origins: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    tls_cert: str = ""
    tls_key: str = ""
    foxglove_sockets: tuple[int, ...] = ()
    page_sockets: tuple[int, ...] = ()

    @property
    def page_port(self) -> int:
        """Port of the page."""
        return self.port and self.port + 1

    @property
    def sockets(self) -> tuple[int, ...]:
        """Descriptors that the server is to inherit."""
        return self.foxglove_sockets + self.page_sockets

    def arguments(self) -> list[str]:
        """Command line of the node.

        Examples
        --------
        >>> Live(port=0, topics=("truth/los",)).arguments()
        ['--host=127.0.0.1', '--port=0', '--topic=truth/los']
        """
        own = [f"--host={self.host}", f"--port={self.port}"]
        own += [f"--origin={origin}" for origin in self.origins]
        own += [f"--topic={topic}" for topic in self.topics]
        own += [f"--foxglove-socket={number}" for number in self.foxglove_sockets]
        own += [f"--page-socket={number}" for number in self.page_sockets]
        return own + ([f"--tls-cert={self.tls_cert}", f"--tls-key={self.tls_key}"] if self.tls_cert else [])


def listening_sockets(host: str, port: int, inherited: Sequence[int] = ()) -> list[socket.socket]:
    """Sockets that listen there, or those with these descriptors.

    Raises
    ------
    ValueError
        The port is in use, or no address of this machine.
    """
    from tornado.netutil import bind_sockets

    if inherited:
        return [socket.socket(fileno=number) for number in inherited]
    try:
        opened: list[socket.socket] = bind_sockets(port, host)
    except OSError as error:
        raise InputError(f"live port must be free on {host}, got {port} ({error.strerror})") from None
    return opened


@contextlib.contextmanager
def opened_here(live: Live) -> Iterator[Live]:
    """The server with sockets of this process, to be inherited: they belong to its network, wherever the server runs.

    Raises
    ------
    ValueError
        As :func:`listening_sockets`.
    """
    with contextlib.ExitStack() as held:
        foxglove, page = (
            tuple(held.enter_context(one).fileno() for one in listening_sockets(live.host, port))
            for port in (live.port, live.page_port)
        )
        yield replace(live, foxglove_sockets=foxglove, page_sockets=page)
