"""Make a network of its own, or enter one: a program of the standard library alone, with a thread of its own.

    python namespaces.py make SOCKET                    sends descriptors of the new namespaces, or a reason
    python namespaces.py enter FD[,FD] COMMAND ...      becomes the command, in these namespaces

A user namespace can be made and entered by a process with one thread only, so this is neither done in the runner nor
between its ``fork`` and ``exec``.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import socket
import struct
import sys
from pathlib import Path

CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 0x1
LOOPBACK = b"lo"
LIMIT = "the limit of /proc/sys/user is reached"


def _call(name: str, *arguments: int) -> None:
    """A function of the C library.

    Raises
    ------
    OSError
        It failed.
    """
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(*map(ctypes.c_int, arguments)):
        number = ctypes.get_errno()
        raise OSError(number, LIMIT if number == errno.ENOSPC else os.strerror(number), name)


def raise_loopback() -> None:
    """Switch the loopback interface of this network on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = struct.pack("16sh22x", LOOPBACK, 0)
        _, flags = struct.unpack("16sh22x", fcntl.ioctl(control, SIOCGIFFLAGS, request))
        fcntl.ioctl(control, SIOCSIFFLAGS, struct.pack("16sh22x", LOOPBACK, flags | IFF_UP))


def make() -> list[int]:
    """Leave for a new network; descriptors of the namespaces, in the order in which they are to be entered.

    Root needs no user namespace. With one, the rights of root to real-time scheduling would be lost; those that the
    limits of a user give are kept.

    Raises
    ------
    OSError
        Not permitted.
    """
    user, group = os.geteuid(), os.getegid()
    kinds = ["net"]
    try:
        _call("unshare", CLONE_NEWNET)
    except PermissionError:
        _call("unshare", CLONE_NEWUSER | CLONE_NEWNET)
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
        kinds = ["user", "net"]
    raise_loopback()
    return [os.open(f"/proc/self/ns/{kind}", os.O_RDONLY) for kind in kinds]


def enter(descriptors: list[int], command: list[str]) -> None:
    """Become this command inside the namespaces; it does not inherit the descriptors."""
    for descriptor in descriptors:
        _call("setns", descriptor, 0)
        os.close(descriptor)
    os.execvp(command[0], command)


def main(arguments: list[str]) -> int:
    """Perform the command line; the exit code."""
    if arguments[0] == "enter":
        enter([int(number) for number in arguments[1].split(",")], arguments[2:])
    with socket.socket(fileno=int(arguments[1])) as answer:
        try:
            descriptors = make()
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            answer.send(f"{place}{error.strerror}".encode())
            return 1
        with contextlib.suppress(BrokenPipeError):
            socket.send_fds(answer, [b"\0"], descriptors)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
