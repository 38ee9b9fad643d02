"""On PYTHONPATH: Python without ROS 2 and without what only Linux has, as on macOS."""

import ctypes
import os
import platform
import resource
import signal
import sys
from types import ModuleType

ONLY_LINUX: dict[ModuleType, tuple[str, ...]] = {
    os: ("sched_", "SCHED_", "memfd", "MFD_", "pidfd", "eventfd", "timerfd", "setns", "unshare", "posix_fa", "CLONE_"),
    signal: ("sigtimedwait", "sigwaitinfo", "SIGRT", "SIGPWR", "SIGSTKFLT", "SIGPOLL"),
    resource: ("RLIMIT_RTTIME", "RLIMIT_RTPRIO", "RLIMIT_NICE", "prlimit"),
}
for module, beginnings in ONLY_LINUX.items():
    for name in [name for name in dir(module) if name.startswith(beginnings)]:
        delattr(module, name)
platform.system = lambda: "Darwin"
platform.machine = lambda: "arm64"
sys.modules["rclpy"] = None  # type: ignore[assignment]

_found = ctypes.CDLL.__getattr__


def _without(library: ctypes.CDLL, name: str) -> object:
    if name in ("prctl", "mallopt", "malloc_trim", "unshare", "mlockall"):
        raise AttributeError(name)
    return _found(library, name)


ctypes.CDLL.__getattr__ = _without  # type: ignore[assignment, method-assign]
