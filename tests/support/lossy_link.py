"""A network link between two devices that delays every packet and loses the data of some ticks.

    python lossy_link.py DEVICE DEVICE DELAY_S PERIOD      forwards between two devices of this namespace until SIGTERM
    python lossy_link.py --whole-checksums DEVICE          lets the sender fill in checksums: no later stage would

Used instead of the kernel's netem, which not every kernel has. What is lost follows from the tick in a message alone,
so a test can count: of each PERIOD ticks one loses all its samples on the way from the first device to the second,
another one all its samples on the way back. Only the first transmission to a receiver is lost; what a reliable reader
asks for again passes. PERIOD 0 loses nothing.

On SIGTERM one JSON object is written: packets carried, packets lost, and the stamps of the lost ticks of both
directions.
"""

from __future__ import annotations

import array
import collections
import contextlib
import fcntl
import json
import os
import select
import signal
import socket
import struct
import sys
import time
from collections.abc import Iterator

from los_testbed.bags.cdr import ENCAPSULATION, stamp_of

from titop_plant.interface import TICK_NS

SIOCETHTOOL = 0x8946
ETHTOOL_STXCSUM = 0x17
SOL_PACKET, PACKET_IGNORE_OUTGOING = 263, 23
EVERY_PROTOCOL = 3
RECEIVE_BUFFER = 4 << 20
SPIN_S = 60e-6
"""The last stretch before a packet is due is spent polling: a sleeping thread wakes up this late."""

LOST_OUTWARD, LOST_RETURNING = 10, 60
"""Ticks, modulo the period: from the first device to the second, and back."""

ETHERNET, IPV4, UDP = 14, 0x0800, 17
RTPS_HEADER, DATA, INLINE_QOS, SERIALISED = 20, 0x15, 0x02, 0x04


def whole_checksums(device: str) -> None:
    """Switch off checksum offload: on a veth the field stays empty until a real card would fill it in."""
    command = array.array("B", struct.pack("II", ETHTOOL_STXCSUM, 0))
    request = struct.pack("16sP", device.encode(), command.buffer_info()[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, SIOCETHTOOL, request)


def open_device(device: str) -> socket.socket:
    """Raw socket that receives every packet of a device."""
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_PROTOCOL))
    end.bind((device, 0))
    end.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    end.setblocking(False)
    return end


def samples(frame: bytes) -> Iterator[tuple[bytes, int]]:
    """Samples of an Ethernet frame with DDS data: (receiver, writer and sequence number as bytes, stamp [ns])."""
    if len(frame) < 62 or int.from_bytes(frame[12:14], "big") != IPV4 or frame[23] != UDP:
        return
    udp = ETHERNET + 4 * (frame[14] & 15)
    message = udp + 8
    if frame[message : message + 4] != b"RTPS":
        return
    receiver, sender = frame[udp + 2 : udp + 4], frame[message + 8 : message + RTPS_HEADER]
    at = message + RTPS_HEADER
    while at + 4 <= len(frame):
        kind, flags = frame[at], frame[at + 1]
        order = "little" if flags & 1 else "big"
        length = int.from_bytes(frame[at + 2 : at + 4], order) or len(frame) - at - 4
        if kind == DATA and flags & SERIALISED and not flags & INLINE_QOS:
            to_qos = int.from_bytes(frame[at + 6 : at + 8], order)
            payload = frame[at + 8 + to_qos : at + 4 + length]
            if len(payload) >= 12 and payload[:4] == bytes(ENCAPSULATION):
                yield receiver + sender + frame[at + 12 : at + 24], stamp_of(payload)
        at += 4 + length


class Schedule:
    """Which frames are lost.

    Parameters
    ----------
    period : int
        Ticks after which the losses repeat; 0 for none.
    """

    def __init__(self, period: int) -> None:
        self._period = period
        self._sent: set[bytes] = set()
        self.stamps: tuple[set[int], set[int]] = (set(), set())

    def loses(self, direction: int, frame: bytes) -> bool:
        """Whether `frame` is lost on its way outward (0) or returning (1)."""
        if not self._period:
            return False
        due = (LOST_OUTWARD, LOST_RETURNING)[direction]
        for sample, stamp in samples(frame):
            if stamp <= 0 or stamp % TICK_NS or stamp // TICK_NS % self._period != due or sample in self._sent:
                continue
            self._sent.add(sample)
            self.stamps[direction].add(stamp)
            return True
        return False


def forward(devices: list[str], delay: float, period: int) -> None:
    """Forward between two devices until SIGTERM; the account is written to the standard output."""
    ends = [open_device(device) for device in devices]
    schedule = Schedule(period)
    under_way: collections.deque[tuple[float, socket.socket, bytes]] = collections.deque()
    stopped: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    carried = lost = 0
    while not stopped:
        wait = max(0.0, under_way[0][0] - time.monotonic() - SPIN_S) if under_way else 0.1
        select.select(ends, [], [], wait)
        for direction, end in enumerate(ends):
            with contextlib.suppress(BlockingIOError, OSError):
                while True:
                    frame = end.recv(65536)
                    if schedule.loses(direction, frame):
                        lost += 1
                    else:
                        under_way.append((time.monotonic() + delay, ends[1 - direction], frame))
        while under_way and under_way[0][0] <= time.monotonic():
            _, end, frame = under_way.popleft()
            with contextlib.suppress(OSError):
                end.send(frame)
            carried += 1
    account = {"carried": carried, "lost": lost, "stamps": [sorted(stamps) for stamps in schedule.stamps]}
    sys.stdout.write(json.dumps(account) + "\n")


def main() -> None:
    """Forward, or set up one device."""
    if sys.argv[1] == "--whole-checksums":
        whole_checksums(sys.argv[2])
        return
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    first, second, delay, period = sys.argv[1:]
    forward([first, second], float(delay), int(period))


if __name__ == "__main__":
    main()
