"""Options of ``los-testbed run`` for viewers, and their checks before the run."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from lftkit.errors import InputError
from los_testbed.config.topics import IMAGE_NAME, OWN_DIAGNOSTICS, TOPICS
from los_testbed.run.processes.viewers import Live, listening_sockets

LIVE_PORT = 8765
MAX_PORT = 65534
"""Largest port of ``--live``: the page has the next one."""

PANEL = "Viewers"
SERVED = (*(topic.name for topic in TOPICS), IMAGE_NAME, OWN_DIAGNOSTICS)
"""Names that ``--live-topic`` takes."""

Port = Annotated[
    int | None,
    typer.Option(
        metavar="[PORT]",
        help=f"Serve viewers: Foxglove's protocol on PORT ({LIVE_PORT}), a browser page on the next port.",
    ),
]
Host = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS", help="Address where --live listens, and accepted Host name.", rich_help_panel=PANEL
    ),
]
Origins = Annotated[
    list[str] | None,
    typer.Option(metavar="ORIGIN", help="Origin whose pages may connect; repeatable.", rich_help_panel=PANEL),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Topic served to viewers; repeatable; default: all.", rich_help_panel=PANEL),
]
TlsCert = Annotated[Path | None, typer.Option(help="Certificate (PEM): https and wss.", rich_help_panel=PANEL)]
TlsKey = Annotated[Path | None, typer.Option(help="Its private key (PEM).", rich_help_panel=PANEL)]


def server_for_viewers(
    port: int | None,
    host: str,
    origins: Sequence[str] = (),
    topics: Sequence[str] = (),
    tls_cert: Path | None = None,
    tls_key: Path | None = None,
) -> Live | None:
    """The server that the options ask for; None without ``--live``.

    Raises
    ------
    ValueError
        Options of a server without one.
    """
    if port is None:
        others = {"origin": origins, "topic": topics, "tls-cert": tls_cert, "tls-key": tls_key}
        for name, stated in others.items():
            if stated:
                raise InputError(f"--live must be given with --live-{name}, got only the latter")
        return None
    cert, key = ("" if file is None else str(file.resolve()) for file in (tls_cert, tls_key))
    return Live(host, port, _tell_addresses, tuple(origins), tuple(topics), cert, key)


def check_live(mode: str, live: Live) -> None:
    """Reject viewers that cannot be served, as in some modes of a run.

    Raises
    ------
    ValueError
        No such port, address or topic, or one in use, a mode without nodes, no certificate, or the packages missing.
    """
    if not 0 <= live.port <= MAX_PORT:
        raise InputError(f"--live must be a port from 0 to {MAX_PORT}, got {live.port}")
    if mode == "inprocess":
        raise InputError("mode must be realtime or lockstep with --live, got inprocess")
    for topic in live.topics:
        if topic not in SERVED:
            raise InputError(f"--live-topic must be one of {', '.join(SERVED)}, got {topic!r}")
    for package in ("foxglove", "tornado"):
        if importlib.util.find_spec(package) is None:
            raise InputError(f"{package} must be installed for --live: pip install 'los-testbed[live]'")
    from los_testbed.live.access import certificate, check_origin

    for origin in live.origins:
        check_origin(origin)
    certificate(live.tls_cert or None, live.tls_key or None)
    for port in (live.port, live.page_port):
        for one in listening_sockets(live.host, port):
            one.close()


def _tell_addresses(foxglove: str, page: str) -> None:
    sys.stderr.write(f"Foxglove: {foxglove}\npage: {page}\n")
