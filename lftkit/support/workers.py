"""Work in several processes with the results of one."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import connection, get_context, parent_process
from types import TracebackType
from typing import TypeVar

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped, unused-ignore]

from lftkit.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")

_LARGEST_KEPT = 31 << 20  # bytes; glibc's largest bound is 32 MB
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # malloc.h


def processors() -> int:
    """Number of processors that this process may use; all of the machine where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """Maps functions over items, in this process or in others: a context manager.

    Each item is computed by itself, with one thread of linear algebra, and results come in the order of the items: they
    do not depend on the number of processes. Processes start with the first items and end with the context, or with
    this process, however it ends; an exception, an interrupt among them, ends them at once, in the midst of an item.

    Parameters
    ----------
    count : int
        Processes; 1: this one.

    Examples
    --------
    >>> with Workers() as workers:
    ...     workers.map(abs, [-1, 2])
    [1, 2]
    """

    def __init__(self, count: int = 1) -> None:
        if count < 1:
            raise InputError(f"workers must be at least 1, got {count}")
        self.count = count
        self._pool: ProcessPoolExecutor | None = None
        self._stop: connection.Connection | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pool, stop = self._pool, self._stop
        self._pool = self._stop = None
        if pool is None or stop is None:
            return
        if kind is not None:
            # Nobody reads any more what is on its way to the processes: Python up to 3.10 waits for the thread that
            # writes it, for ever where the pipe is full.
            pool._call_queue.cancel_join_thread()  # type: ignore[attr-defined]
            stop.close()
        pool.shutdown(wait=True, cancel_futures=True)
        stop.close()

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Results of the function for the items; functions and items that go to other processes must be picklable."""
        return list(self.each(function, items))

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Results of :meth:`map`, one by one."""
        if self.count == 1 or len(items) < 2:
            return map(function, items)
        if self._pool is None:
            context = get_context("spawn")
            stopped, self._stop = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self.count, context, initializer=_begin, initargs=(stopped,))
        # Processes that start here inherit a blocked SIGINT: a terminal sends it to them, too, while they import
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return _results([self._pool.submit(function, item) for item in items])
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _results(futures: list[Future[Result]]) -> Iterator[Result]:
    """Results in order. None is ever cancelled, as `ProcessPoolExecutor.map` does when its iterator is left.

    Up to 3.11 an executor whose processes end at once does not get past a cancelled one (InvalidStateError), leaves
    its pipes open and waits for ever at the end of the program.
    """
    futures.reverse()
    while futures:
        yield futures.pop().result()


def _begin(stopped: connection.Connection) -> None:
    """In a new process: one thread of linear algebra, no interrupts of its own, and an end with the parent's end.

    It ends, too, when the other end of `stopped` is closed, which only the parent has.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1, user_api="blas")
    # Let arrays of up to 31 MB reuse the memory of earlier ones, in a process that makes and drops many
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        mallopt(_TRIM_THRESHOLD, 2 * _LARGEST_KEPT)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel, stopped), daemon=True).start()


def _end_with(sentinel: int, stopped: connection.Connection) -> None:
    connection.wait([sentinel, stopped])
    os._exit(1)
