"""Access control of a server of a run: header Host, header Origin, certificate.

A page of another site can reach a server on 127.0.0.1 through the browser of the user in two ways. It gives its own
name the address 127.0.0.1 (DNS rebinding): then Host has that name. Or it opens a web socket to 127.0.0.1, which a
browser permits to every site: then Origin has its name. Programs other than browsers can send any header; neither
check protects against them.
"""

from __future__ import annotations

import ipaddress
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import SECRET

MAX_VIEWERS = 16
"""Viewers that each server of a run has at a time; each one costs some percent of a processor."""

FOXGLOVE_SITE = "https://app.foxglove.dev"
"""Origin of the viewer of Foxglove in a browser."""


@dataclass(frozen=True)
class Access:
    """Names under which a server may be addressed, and the sites whose pages may open a web socket.

    Attributes
    ----------
    listens : address or name on which the server listens; this name is permitted, and with an address that stands for
        all (0.0.0.0, ::) every IP address and the name of this machine
    origins : further origins (SCHEME://HOST[:PORT]), as a browser sends them

    Examples
    --------
    >>> access = Access("192.0.2.7")
    >>> access.host("localhost:8766"), access.host("192.0.2.7:8766"), access.host("192.0.2.8"), access.host("a.example")
    (True, True, False, False)
    >>> access.origin("http://127.0.0.1:8080"), access.origin("https://a.example"), access.origin("null")
    (True, False, False)
    >>> Access("0.0.0.0").origin("http://203.0.113.9", "192.0.2.7:8765")
    False
    """

    listens: str = "127.0.0.1"
    origins: tuple[str, ...] = ()

    def host(self, header: str) -> bool:
        """Whether this is a name of the server, with or without a port."""
        return self._own(_name(f"http://{header}"))

    def origin(self, header: str, host: str = "") -> bool:
        """Whether pages of this origin may open a web socket to the server that `host`, the header Host, names.

        A page may come from any address of the internet: where every address is permitted as a name of the server, only
        pages of the address under which it is addressed are those of this machine.
        """
        if header in self.origins:
            return True
        name = _name(header)
        if header.partition("://")[0] not in ("http", "https") or not self._own(name):
            return False
        address, listens = _address(name), _address(self.listens)
        if address is None or address.is_loopback or listens is None or not listens.is_unspecified:
            return True
        return address == _address(_name(f"http://{host}"))

    def _own(self, name: str) -> bool:
        if not name:
            return False
        listens = _address(self.listens)
        address = _address(name)
        if address is not None:
            everywhere = listens is not None and listens.is_unspecified
            return address.is_loopback or address == listens or everywhere
        names = {"localhost", self.listens.lower()}
        if listens is not None and listens.is_unspecified:
            names.add(socket.gethostname().lower())
        return name in names


def _name(address: str) -> str:
    """Host of an address that has nothing but scheme, host and port; empty for others."""
    try:
        parts = urlsplit(address)
        name, _ = parts.hostname or "", parts.port
    except ValueError:
        return ""
    return "" if "@" in parts.netloc or parts.path or parts.query or parts.fragment else name


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def check_origin(origin: str) -> None:
    """Reject an invalid Origin of a page.

    Raises
    ------
    ValueError
        Not of the form SCHEME://HOST[:PORT].
    """
    scheme, sign, rest = origin.partition("://")
    if origin != "null" and (not sign or not scheme or (not rest and scheme != "file") or "/" in rest):
        raise InputError(f"--live-origin must be SCHEME://HOST[:PORT], file:// or null, got {origin!r}")


def certificate(cert: Path | str | None, key: Path | str | None) -> ssl.SSLContext | None:
    """Context of a server with this certificate and key (PEM); None without them.

    Raises
    ------
    ValueError
        One without the other, or files that are no certificate and its key.
    """
    if cert is None and key is None:
        return None
    if cert is None or key is None:
        raise InputError("--live-tls-cert and --live-tls-key must be given together, got one of them")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        for path in (cert, key):
            check_file(path, SECRET)
        context.load_cert_chain(cert, key, password=lambda: "")
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"--live-tls-cert must be a certificate and --live-tls-key its key, got {cert}, {key} ({reason})"
        ) from None
    return context
