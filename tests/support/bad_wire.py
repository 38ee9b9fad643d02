"""A cable between two network namespaces that delays every packet and loses some.

    python bad_wire.py DEVICE DEVICE DELAY_S LOSS SEED     forwards between two devices of this namespace until SIGTERM
    python bad_wire.py --whole-checksums DEVICE            lets the sender fill in checksums: nobody after it would

In the place of the kernel's netem, which not every kernel has.
"""

from __future__ import annotations

import array
import collections
import contextlib
import fcntl
import os
import random
import select
import signal
import socket
import struct
import sys
import time

SIOCETHTOOL = 0x8946
ETHTOOL_STXCSUM = 0x17
SOL_PACKET, PACKET_IGNORE_OUTGOING = 263, 23
EVERY_PROTOCOL = 3


def whole_checksums(device: str) -> None:
    """Switch off checksum offload: on a veth the field stays empty until a real card would fill it in."""
    command = array.array("B", struct.pack("II", ETHTOOL_STXCSUM, 0))
    request = struct.pack("16sP", device.encode(), command.buffer_info()[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, SIOCETHTOOL, request)


def open_device(device: str) -> socket.socket:
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_PROTOCOL))
    end.bind((device, 0))
    end.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
    end.setblocking(False)
    return end


def forward(devices: list[str], delay: float, loss: float, seed: int) -> None:
    rng = random.Random(seed)
    ends = [open_device(device) for device in devices]
    other = {ends[0].fileno(): ends[1], ends[1].fileno(): ends[0]}
    under_way: collections.deque[tuple[float, socket.socket, bytes]] = collections.deque()
    poll = select.epoll()
    for end in ends:
        poll.register(end, select.EPOLLIN)
    stopped: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    carried = lost = 0
    while not stopped:
        wait = max(0.0, under_way[0][0] - time.monotonic()) if under_way else 0.1
        # epoll counts in milliseconds and would round up: the last one is spent asking
        poll.poll(wait if wait > 1.5e-3 else 0)
        for end in ends:
            with contextlib.suppress(BlockingIOError, OSError):
                while True:
                    data = end.recv(65536)
                    if rng.random() < loss:
                        lost += 1
                    else:
                        under_way.append((time.monotonic() + delay, other[end.fileno()], data))
        while under_way and under_way[0][0] <= time.monotonic():
            _, end, data = under_way.popleft()
            with contextlib.suppress(OSError):
                end.send(data)
            carried += 1
    sys.stdout.write(f"{carried} {lost}\n")


def main() -> None:
    if sys.argv[1] == "--whole-checksums":
        whole_checksums(sys.argv[2])
        return
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    first, second, delay, loss, seed = sys.argv[1:]
    forward([first, second], float(delay), float(loss), int(seed))


if __name__ == "__main__":
    main()
