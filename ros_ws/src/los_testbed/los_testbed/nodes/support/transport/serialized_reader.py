"""Serialised messages with the identifier of their publisher, which rclpy reads but does not expose.

The library ``rcl`` below rclpy returns the publisher of every message (``rcl_take_serialized_message``). It is already
loaded: this module calls the function that rclpy calls.
"""

from __future__ import annotations

import ctypes
import functools
import struct
from pathlib import Path
from typing import Any, NamedTuple

GID_BYTES = 16

_INFO = struct.Struct("<qqQQ8x16s")  # sent, received, two numbers, a pointer, identifier
_INFO_BYTES = 512
"""Space for what later versions append to ``rmw_message_info_t``."""
_CAPACITY = 4096


class Taken(NamedTuple):
    """A message with when it was sent and received (wall clock [ns]) and the identifier of its publisher."""

    data: bytes
    sent: int
    received: int
    gid: bytes


class _Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "free", "reallocate", "zeros", "state")]


class _Array(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _Gid(ctypes.Structure):
    _fields_ = [("layer", ctypes.c_char_p), ("data", ctypes.c_uint8 * GID_BYTES), ("rest", ctypes.c_uint8 * 64)]


@functools.cache
def _function(name: str) -> Any:
    """A function of the library ``rcl`` or of one that it needs, as rclpy has loaded them.

    Raises
    ------
    RuntimeError
        There is none.
    """
    paths = {line.split(maxsplit=5)[-1] for line in Path("/proc/self/maps").read_text().splitlines()}
    for path in paths:
        if path.endswith("/librcl.so") and hasattr(library := ctypes.PyDLL(path), name):
            return getattr(library, name)
    raise RuntimeError(
        f"rclpy must have loaded librcl.so with {name}, got another build: publishers cannot be identified"
    )


class SerializedReader:
    """Takes the messages of a subscription.

    Parameters
    ----------
    handle : rclpy.Subscription
        Handle of a subscription; the caller keeps it alive.
    """

    def __init__(self, handle: Any) -> None:
        default = _function("rcutils_get_default_allocator")
        default.restype = _Allocator
        self._allocator = default()
        self._array = _Array()
        self._info = ctypes.create_string_buffer(_INFO_BYTES)
        begin = _function("rcutils_uint8_array_init")
        if begin(ctypes.byref(self._array), ctypes.c_size_t(_CAPACITY), ctypes.byref(self._allocator)):
            raise MemoryError(f"{_CAPACITY} bytes must be free, got none")
        self._take = _function("rcl_take_serialized_message")
        self._take.argtypes, self._take.restype = [ctypes.c_void_p] * 4, ctypes.c_int
        self._arguments = (
            ctypes.c_void_p(handle.pointer),
            ctypes.byref(self._array),
            ctypes.byref(self._info),
            ctypes.c_void_p(None),
        )
        self._free = _function("rcutils_uint8_array_fini")

    def take(self) -> Taken | None:
        """Oldest message, or None."""
        if self._take(*self._arguments):
            return None
        sent, received, _, _, gid = _INFO.unpack_from(self._info)
        array = self._array
        return Taken(ctypes.string_at(array.buffer, array.length), sent, received, gid)

    def close(self) -> None:
        """Free the buffer."""
        self._free(ctypes.byref(self._array))


def publisher_gid(publisher: Any) -> bytes:
    """Identifier of a publisher of this process.

    Parameters
    ----------
    publisher : rclpy.Publisher
        Handle of a publisher.

    Raises
    ------
    RuntimeError
        The middleware does not provide it.
    """
    handle_of = _function("rcl_publisher_get_rmw_handle")
    handle_of.argtypes, handle_of.restype = [ctypes.c_void_p], ctypes.c_void_p
    gid_of = _function("rmw_get_gid_for_publisher")
    gid_of.argtypes, gid_of.restype = [ctypes.c_void_p] * 2, ctypes.c_int
    gid = _Gid()
    if gid_of(handle_of(publisher.pointer), ctypes.byref(gid)):
        raise RuntimeError("the middleware must provide the identifier of a publisher, got none")
    return bytes(gid.data)
