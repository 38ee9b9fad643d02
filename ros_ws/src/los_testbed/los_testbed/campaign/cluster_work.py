"""Items of work on the worker processes of a Dask cluster, which need only the package.

An item's result does not depend on the worker that computes it, and results come in the order of the items, so that
they are the same for any number of workers of one kind. Files are read and written by the caller alone.
"""

from __future__ import annotations

import contextlib
import pickle
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
import scipy
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped, unused-ignore]

from lftkit.errors import InputError
from lftkit.support.workers import Workers
from los_testbed import __version__
from los_testbed.campaign.cluster.tls_files import TlsFiles
from los_testbed.campaign.execution import LOOK, PATIENCE, POLL, cluster

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2
"""Items queued per worker."""


def _itself(item: Any) -> Any:
    return item


def _never(item: Any) -> Any:
    return None


def _nowhere(item: Any, result: Any) -> None:
    return None


@dataclass(frozen=True)
class Work(Generic[Item, Result]):
    """Processing of each item: `function` by a worker, the rest by the caller.

    Parameters
    ----------
    function : callable
        Result from what `sent` gives; picklable.
    sent : callable
        What a worker receives of an item, as it is handed out.
    kept : callable
        Stored result, or None.
    keep : callable
        Receives each item and result immediately, in any order.
    named : callable
        Text for messages.
    advice : str
        End of a message about lost workers.
    """

    function: Callable[[Any], Result]
    sent: Callable[[Item], Any] = _itself
    kept: Callable[[Item], Result | None] = _never
    keep: Callable[[Item, Result], None] = _nowhere
    named: Callable[[Item], str] = lambda item: "an item"
    advice: str = "run the command again"


class ClusterWorkers(Workers):
    """Workers of a cluster instead of processes of this machine.

    Parameters
    ----------
    client : distributed.Client
    count : int
        Threads on this machine, for what is not handed out.
    """

    def __init__(self, client: Any, count: int = 1) -> None:
        super().__init__(count)
        self.client = client

    def each(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Results of :meth:`map`, one by one."""
        return results_on(self.client, Work[Item, Result](function), items)


@contextlib.contextmanager
def connected(scheduler: str, tls: TlsFiles | None) -> Iterator[Any]:
    """Client of a running scheduler whose workers have the versions of this process.

    Raises
    ------
    ValueError
        No scheduler at the address, one without workers, or a worker with other versions.
    """
    with cluster(scheduler, 0, tls) as client:
        here = versions()
        for address, there in client.run(versions, on_error="return").items():
            if there != here:
                raise InputError(f"worker {address} must have {here} as here, got {there}")
        yield client


def versions() -> dict[str, str]:
    """Versions in this process that results depend on."""
    return {"los-testbed": __version__, "numpy": np.__version__, "scipy": scipy.__version__}


def results_on(client: Any, work: Work[Item, Result], items: Sequence[Item]) -> Iterator[Result]:
    """Results in the order of the items.

    Raises
    ------
    RuntimeError
        The connection to the scheduler or all workers were lost, or an item fails or ends its workers.
    """
    waiting, running, done = deque(range(len(items))), dict[Any, int](), dict[int, Result]()
    try:
        # a task, which the scheduler repeats if the worker that holds its result is lost
        function = client.submit(bytes, pickle.dumps(work.function, protocol=5), pure=False)
        for number in range(len(items)):
            while number not in done:
                most = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
                while waiting and len(running) < most:
                    following = waiting.popleft()
                    kept = work.kept(items[following])
                    if kept is not None:
                        done[following] = kept
                        continue
                    sent = work.sent(items[following])
                    running[client.submit(_computed, function, sent, versions(), pure=False, retries=2)] = following
                if number not in done:
                    _collect(client, work, items, running, done)
            yield done.pop(number)
    except (CancelledError, TimeoutError, OSError) as error:
        raise RuntimeError(f"connection to the scheduler lost, {work.advice} ({type(error).__name__})") from None
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(running))


def _computed(function: bytes, item: Any, expected: dict[str, str]) -> Any:
    """Result of an item, on a worker, with one thread of linear algebra."""
    if versions() != expected:  # of a worker that joined later
        raise InputError(f"a worker must have {expected} as the client, got {versions()}")
    _one_thread()
    return _unpickled(function)(item)


@lru_cache(maxsize=1)
def _one_thread() -> None:
    """In this process from now on: the threads of a worker share the limit."""
    threadpool_limits(limits=1, user_api="blas")


@lru_cache(maxsize=2)
def _unpickled(function: bytes) -> Callable[[Any], Any]:
    work: Callable[[Any], Any] = pickle.loads(function)
    return work


def _collect(
    client: Any,
    work: Work[Item, Result],
    items: Sequence[Item],
    running: dict[Any, int],
    done: dict[int, Result],
) -> None:
    """Wait for a finished item, and store all finished ones."""
    looked = seen = time.monotonic()
    while not any(future.done() for future in running):
        time.sleep(POLL)
        now = time.monotonic()
        if client.status == "closed":
            raise CancelledError
        if now - looked > LOOK:
            looked = now
            seen = now if client.scheduler_info(n_workers=-1)["workers"] else seen
            if now - seen > PATIENCE:
                raise RuntimeError(f"no worker for {PATIENCE:g} s, {work.advice}")
    for future in [future for future in running if future.done()]:
        number = running.pop(future)
        if future.status == "cancelled":
            raise CancelledError
        if future.status == "error":
            error = future.exception()
            raise RuntimeError(f"{work.named(items[number])} failed: {_text(error)}, {work.advice}")
        done[number] = future.result()
        work.keep(items[number], done[number])


def _text(error: BaseException) -> str:
    """Type and message of an error in one line."""
    return ": ".join(text for text in (type(error).__name__, " ".join(str(error).split())) if text)
