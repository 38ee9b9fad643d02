"""Scheduling of a node's process: priority, processor, locked memory, timers, power saving."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

PRIORITIES = {"plant": 80, "estimator": 70, "controller": 60, "recorder": 1}
"""SCHED_FIFO priority of each node: the plant keeps the time, the recorder only has to keep up on average."""

CPU_INDEX = {"plant": 0, "estimator": 1, "controller": 1, "recorder": None}
"""Index of a node's processor among those that its process may use; a pinned thread keeps its cache. The plant has one
for itself: its work between two ticks (clock, requests, reports) must not delay a late command. The recorder is not
pinned: on a slow machine estimator and controller leave too little time on theirs, and messages that it does not take
within 0.1 s are lost."""

_RESENDING = "dds.asyn"
"""Beginning of the name of Fast DDS's thread that sends lost messages again.

It polls for a lock. At the priority of the thread that holds the lock, on the same processor, it would never let that
thread run: so its priority is one lower.
"""

MAX_BUSY_S = 1.0
"""CPU time [s] that a real-time thread may use without blocking; then the kernel ends its process (SIGXCPU). No process
of lower priority on the same processor could."""

PAUSE_NS, PAUSE_S = 200_000_000, 2e-4
"""Processor time [ns] after which a loop that is late at every tick blocks, and for how long [s]. A sleep of 20 us ends
before the thread has left the processor: the kernel does not count it."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29


class Pauses:
    """Instants in which a thread blocks that would else compute without end, as the kernel asks for (`MAX_BUSY_S`).

    By the processor time of the thread: a loop that waits for its ticks needs none of them for seconds.
    """

    def __init__(self) -> None:
        self._last = time.thread_time_ns()

    def take(self) -> None:
        """Block for an instant if the thread has used `PAUSE_NS` since the last one; where nothing is urgent."""
        if not 0 <= time.thread_time_ns() - self._last < PAUSE_NS:
            time.sleep(PAUSE_S)
            self._last = time.thread_time_ns()


def sharpen_timers() -> None:
    """Set the timer slack of this process to 1 ns instead of 50 us; call it before threads start."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


def end_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM to this process when its parent, of this number, has ended."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it ended before the request
        os.kill(os.getpid(), signal.SIGTERM)


def disable_idle_states() -> bool:
    """Disable idle states of all processors during this process; whether the kernel permitted it.

    An idle processor of a virtual machine takes tens of microseconds to wake up.
    """
    try:
        _latency_files.append(os.open("/dev/cpu_dma_latency", os.O_WRONLY))
        os.write(_latency_files[-1], bytes(4))  # 0 us; the kernel forgets it when the file is closed
    except OSError:
        return False
    return True


_latency_files: list[int] = []


def enlarge_receive_buffers(size: int) -> int:
    """Let the UDP sockets of this process take in `size` bytes, or what net.core.rmem_max permits; their number.

    To be called when the middleware has made them.
    """
    count = 0
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # closed since
            if not os.readlink(entry).startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry.name))) as opened:
                if opened.type == socket.SOCK_DGRAM and opened.family in (socket.AF_INET, socket.AF_INET6):
                    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
                    count += 1
    return count


def prefer(nice: int) -> bool:
    """Raise the priority of this thread and its children; whether the kernel permitted it.

    Parameters
    ----------
    nice : int
        Below 0 for more than an ordinary share of the time that real-time threads leave.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
    except OSError:
        return False
    return True


@contextlib.contextmanager
def real_time_thread(priority: int) -> Iterator[None]:
    """Give the calling thread SCHED_FIFO for a while, where it is permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:  # not permitted: ordinary scheduling
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def become_real_time(priority: int, cpu: int | None = None) -> list[str]:
    """Give all threads SCHED_FIFO and a processor, lock the memory, switch the garbage collector off.

    To be called when everything is built: the threads that exist, those of the middleware included, are set one by
    one; later ones inherit.

    Parameters
    ----------
    priority : int
        SCHED_FIFO priority, 1 to 99.
    cpu : int, optional
        Index of the processor to run on among those this process may use, modulo their number; None: any of them.

    Returns
    -------
    list of str
        What was not permitted; empty if all of it was.
    """
    refused = []
    gc.collect()
    gc.freeze()
    gc.disable()
    # Every page is touched now: 0.1 s of the processor. On a virtual machine whose host has taken back free memory a
    # page may take seven times as long (measured), and the kernel ended nodes there: so before the limit holds.
    locked = not ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE)
    limit = int(MAX_BUSY_S * 1e6)
    resource.setrlimit(resource.RLIMIT_RTTIME, (limit, 2 * limit))
    try:
        processors = sorted(os.sched_getaffinity(0))
        for thread in os.listdir("/proc/self/task"):
            with open(f"/proc/self/task/{thread}/comm") as name:
                level = priority - name.read().startswith(_RESENDING)
            os.sched_setscheduler(int(thread), os.SCHED_FIFO if level else os.SCHED_OTHER, os.sched_param(level))
            if cpu is not None:
                os.sched_setaffinity(int(thread), {processors[cpu % len(processors)]})
    except (OSError, AttributeError):
        refused.append("real-time scheduling")
    return refused if locked else [*refused, "locked memory"]
