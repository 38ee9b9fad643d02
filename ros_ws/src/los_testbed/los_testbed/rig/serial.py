"""A rig over a serial line (``run --device los_testbed.rig.serial:SerialRig --device-address /dev/ttyUSB0``).

The bytes are those of the packets (:mod:`los_testbed.rig.wire`), one after the other. A receiver begins where the
four bytes of the magic are, reads the length from the header, and accepts both if the check is right; otherwise it
continues one byte later. So it finds the next complete packet after lost, added or changed bytes.
"""

from __future__ import annotations

import contextlib
import os
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from los_testbed.config.run_config import RunConfig
from los_testbed.rig.driver import PacketLine, PacketRig, secret_of
from los_testbed.rig.wire import CHECK, HEAD, MAGIC, MOST_VALUES, fits

BAUD = 4_000_000
"""Samples at 1 kHz are 2.1 Mbit/s with start and stop bits."""

PEER = "serial"


def line_of(text: str) -> tuple[str, int]:
    """Path and speed of ``PATH`` or ``PATH@BAUD``.

    Raises
    ------
    ValueError
        No device with that path, or a speed that a serial line does not have.

    Examples
    --------
    >>> line_of("/dev/null@115200")
    ('/dev/null', 115200)
    """
    path, _, speed = text.partition("@")
    if not Path(path).is_char_device():
        raise InputError(f"device_address must be the path of a serial line, PATH or PATH@BAUD, got {text!r}")
    baud = int(speed) if speed.isdecimal() else BAUD
    if (speed and not speed.isdecimal()) or not hasattr(termios, f"B{baud}"):
        raise InputError(f"device_address must have a standard baud rate (115200, 1000000, 4000000), got {speed!r}")
    return path, baud


class PacketSplitter:
    """Cuts a stream of bytes into packets.

    Parameters
    ----------
    fits : callable
        Whether the check of a packet is right.

    Examples
    --------
    >>> import numpy as np
    >>> from los_testbed.rig.wire import Kind, encode, fits
    >>> data = encode(Kind.FRAME, 1, 5, np.array([1.0]), bytes(8))
    >>> frames = PacketSplitter(lambda packet: fits(packet, bytes(8)))
    >>> frames.feed(b"LOSR" + data[:20]), frames.feed(data[20:]) == [data], frames.skipped
    ([], True, 4)
    """

    def __init__(self, fits: Callable[[bytes], bool]) -> None:
        self._fits = fits
        self._rest = b""
        self.skipped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Packets that are whole with these bytes."""
        self._rest += data
        packets: list[bytes] = []
        while True:
            start = self._rest.find(MAGIC)
            if start < 0:
                start = max(0, len(self._rest) - len(MAGIC) + 1)  # the magic may have begun
                self.skipped += start
                self._rest = self._rest[start:]
                return packets
            self.skipped += start
            self._rest = self._rest[start:]
            if len(self._rest) < HEAD.size:
                return packets
            values = HEAD.unpack_from(self._rest)[6]
            size = HEAD.size + 8 * values + CHECK.size
            if values <= MOST_VALUES and len(self._rest) < size:
                return packets
            if values <= MOST_VALUES and self._fits(self._rest[:size]):
                packets.append(self._rest[:size])
                self._rest = self._rest[size:]
            else:
                self.skipped += 1
                self._rest = self._rest[1:]


class SerialLine:
    """A serial line in raw mode, or the end of a pseudo terminal.

    Parameters
    ----------
    handle : int
        Open file, which is closed with the line.
    name : str
    fits : callable
        As of `PacketSplitter`.
    baud : int, optional
        Speed that is set.
    """

    def __init__(self, handle: int, name: str, fits: Callable[[bytes], bool], baud: int | None = None) -> None:
        self.name = name
        self._handle = handle
        self.frames = PacketSplitter(fits)
        self._unsent = b""
        os.set_blocking(handle, False)
        tty.setraw(handle)
        if baud is not None:
            settings: list[Any] = termios.tcgetattr(handle)
            settings[4] = settings[5] = getattr(termios, f"B{baud}")
            termios.tcsetattr(handle, termios.TCSANOW, settings)
        termios.tcflush(handle, termios.TCIOFLUSH)

    def send(self, data: bytes) -> None:
        """Send a packet; bytes that do not fit the buffer precede the next one; with a full buffer it is dropped."""
        if self._unsent:
            self._unsent = self._unsent[os.write(self._handle, self._unsent) :]
        if self._unsent:
            raise BlockingIOError("the serial buffer is full")
        self._unsent = data[os.write(self._handle, data) :]

    def send_to(self, data: bytes, peer: Any) -> None:
        """Send a packet to the other end."""
        self.send(data)

    def receive(self) -> list[tuple[bytes, int]]:
        """Packets that have come, with the time at which they were read (steady clock [ns])."""
        data = b""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self._handle, 1 << 16):
                data += part
        return [(packet, time.monotonic_ns()) for packet in self.frames.feed(data)] if data else []

    def receive_from(self) -> list[tuple[bytes, int, Any]]:
        """The same with the sender, of which there is one."""
        return [(data, time_ns, PEER) for data, time_ns in self.receive()]

    def close(self) -> None:
        """Close the line after its output is sent."""
        with contextlib.suppress(OSError, termios.error):
            termios.tcdrain(self._handle)
        os.close(self._handle)


class SerialRig(PacketRig):
    """Driver of a rig at the serial line ``device_address``, PATH or PATH@BAUD."""

    def settings(self, config: RunConfig) -> tuple[tuple[str, int], bytes]:
        """Path and speed, and the key that opens the rig."""
        return line_of(config.device_address), secret_of(config)

    def connect(self, address: tuple[str, int]) -> PacketLine:
        """The line."""
        return open_line(*address, lambda packet: fits(packet, self.key))


def open_line(path: str, baud: int, fits: Callable[[bytes], bool]) -> SerialLine:
    """Open a serial line."""
    handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        return SerialLine(handle, path, fits, baud)
    except (OSError, termios.error) as error:
        os.close(handle)
        raise OSError(f"{path} is not a serial line: {error}") from error


def open_pseudo_terminal(fits: Callable[[bytes], bool]) -> SerialLine:
    """One end of a new pseudo terminal; the path of the other one is its name."""
    handle, other = os.openpty()
    name = os.ttyname(other)
    tty.setraw(other)
    return SerialLine(handle, name, fits)
