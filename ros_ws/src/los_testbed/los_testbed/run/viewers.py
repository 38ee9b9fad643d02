"""The server for viewers beside a run: where it listens, whom it serves, what it shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
    """

    host: str = "127.0.0.1"
    port: int = 8765
    tell: Callable[[str, str], None] = lambda foxglove, page: None
    origins: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    tls_cert: str = ""
    tls_key: str = ""

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
        return own + ([f"--tls-cert={self.tls_cert}", f"--tls-key={self.tls_key}"] if self.tls_cert else [])
