"""A rig over UDP (``run --device los_testbed.rig.udp:UdpRig``): a packet of the wire format is a datagram."""

from __future__ import annotations

import ipaddress
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any

from lftkit.errors import InputError
from los_testbed.config.run_config import RunConfig
from los_testbed.rig.driver import PacketLine, PacketRig, secret_of

SO_TIMESTAMPNS = 35
"""Option of a socket of Linux: the kernel says when each packet came."""


def address_of(text: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT``.

    Raises
    ------
    ValueError
        Another form, or a host without an address.
    """
    host, sign, port = text.rpartition(":")
    if not sign or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"device_address must be HOST:PORT, got {text!r}")
    try:
        socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"device_address must have a host with an address, got {text!r}: {error}") from None
    return host.strip("[]"), int(port)


def other_machine(host: str) -> str:
    """The host, if it is not this machine; else ""."""
    try:
        local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    return "" if local else host


class UdpSocket:
    """A socket with times of arrival.

    Parameters
    ----------
    host, port : address
    bound : bool
        Whether it waits there, as a rig does, or sends there.
    """

    def __init__(self, host: str, port: int, *, bound: bool = False) -> None:
        self.name = f"{host}:{port}"
        self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        if bound:
            self._socket.bind((host, port))
        else:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._socket.connect((host, port))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        """Send a packet to the host."""
        self._socket.send(data)

    def send_to(self, data: bytes, peer: Any) -> None:
        """Send a packet to whom one came from."""
        self._socket.sendto(data, peer)

    def receive(self) -> list[tuple[bytes, int]]:
        """Packets that have come, with their times of arrival (steady clock [ns])."""
        return [(data, time_ns) for data, time_ns, _ in self.receive_from()]

    def receive_from(self) -> list[tuple[bytes, int, Any]]:
        """Packets that have come, their times of arrival and their senders."""
        received: list[tuple[bytes, int, Any]] = []
        while True:
            try:
                data, extra, _, peer = self._socket.recvmsg(2048, 64)
            except BlockingIOError:
                return received
            except OSError:
                if received:
                    return received
                raise
            received.append((data, _arrival(extra), peer))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UdpRig(PacketRig):
    """Driver of a rig at ``device_address``, HOST:PORT."""

    def settings(self, config: RunConfig) -> tuple[tuple[str, int], bytes]:
        """Host and port, and the key that opens the rig."""
        address = address_of(config.device_address)
        return address, secret_of(config, other_machine(address[0]))

    def connect(self, address: tuple[str, int]) -> PacketLine:
        """The socket."""
        return UdpSocket(*address)


def _arrival(extra: Sequence[tuple[int, int, bytes]]) -> int:
    """Time of arrival of a packet (steady clock [ns]), by the kernel's note of the wall clock."""
    now, wall = time.monotonic_ns(), time.time_ns()
    for level, kind, data in extra:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) == 16:
            seconds, rest = (int(part) for part in struct.unpack("<qq", data))
            return now - min(max(wall - (seconds * 1_000_000_000 + rest), 0), 1_000_000_000)
    return now
