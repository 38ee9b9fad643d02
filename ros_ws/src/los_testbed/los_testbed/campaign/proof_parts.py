"""Parts of proofs on the worker processes of a Dask cluster, which need nothing but the package.

A part does not depend on the worker that proves it, so that proofs are the same for any number of workers of one kind.
Files are read and written here alone, each part as soon as it is proven.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from functools import partial
from typing import Any

import numpy as np
import scipy

from los_design.verification.certify import PartResult, ProofPart, keep_part, kept_part, prove_task, task_of
from los_testbed import __version__
from los_testbed.campaign.execution import LOOK, PATIENCE, POLL, cluster
from los_testbed.campaign.tls_files import TlsFiles

AHEAD = 2
"""Parts for each worker that are handed out before their turn."""
KEPT = "parts that are proven are kept: the same command goes on"


@contextlib.contextmanager
def prover_on(scheduler: str, tls: TlsFiles | None) -> Iterator[Callable[[Sequence[ProofPart]], Iterator[PartResult]]]:
    """What proves parts on the workers of a scheduler.

    Raises
    ------
    ValueError
        No scheduler at the address, one without workers, or a worker with other versions.
    """
    with cluster(scheduler, 0, tls) as client:
        here = versions()
        for address, found in client.run(versions, on_error="return").items():
            if found != here:
                raise ValueError(f"worker {address} must have {here} as here, got {found}")
        yield partial(prove_on, client)


def versions() -> dict[str, str]:
    """What parts depend on, of the process that calls it."""
    return {"los-testbed": __version__, "numpy": np.__version__, "scipy": scipy.__version__}


def prove_on(client: Any, parts: Sequence[ProofPart]) -> Iterator[PartResult]:
    """Results in the order of the parts; what is kept is read.

    Raises
    ------
    RuntimeError
        The scheduler was lost, no worker is left, or a part ends its workers; what was proven is kept.
    """
    waiting, running, done = deque(range(len(parts))), dict[Any, int](), dict[int, PartResult]()
    try:
        for number in range(len(parts)):
            while number not in done:
                _hand_out(client, parts, waiting, running, done)
                if number not in done:
                    _collect(client, parts, running, done)
            yield done.pop(number)
    except (CancelledError, TimeoutError, OSError) as error:
        raise RuntimeError(f"the scheduler was lost, {KEPT} ({type(error).__name__})") from None
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(running))


def _hand_out(
    client: Any,
    parts: Sequence[ProofPart],
    waiting: deque[int],
    running: dict[Any, int],
    done: dict[int, PartResult],
) -> None:
    """Submit parts in their order, as many as workers need; those that are kept are done."""
    most = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    while waiting and len(running) < most:
        number = waiting.popleft()
        kept = kept_part(parts[number])
        if kept is not None:
            done[number] = kept
            continue
        running[client.submit(prove_task, task_of(parts[number]), pure=False, retries=2)] = number


def _collect(client: Any, parts: Sequence[ProofPart], running: dict[Any, int], done: dict[int, PartResult]) -> None:
    """Wait for a part that is proven, and keep all that are."""
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
                raise RuntimeError(f"no worker is left since {PATIENCE:g} s, {KEPT}")
    for future in [future for future in running if future.done()]:
        number = running.pop(future)
        if future.status == "cancelled":
            raise CancelledError
        if future.status == "error":
            error = future.exception()
            low, high = parts[number].band
            raise RuntimeError(f"the part from {low:g} to {high:g} rad/s failed: {type(error).__name__}, {KEPT}")
        done[number] = future.result()
        keep_part(parts[number], done[number])
