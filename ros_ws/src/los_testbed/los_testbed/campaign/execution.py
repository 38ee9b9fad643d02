"""Computes the chunks of a campaign on the worker processes of a Dask cluster and writes their rows as they finish."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import ssl
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from lftkit.errors import InputError
from lftkit.support.progress import Progress
from lftkit.support.workers import Workers, processors
from los_testbed.campaign.cluster.local_cluster import local_cluster
from los_testbed.campaign.cluster.tls_files import SCHEME, TlsFiles, client_security
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import CRASHED, MemberEvaluator, finished_row
from los_testbed.campaign.portable import base_of, portable
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import identity
from pointing_analysis.command.screen import warn

AHEAD = 3  # chunks per worker that are handed out before their turn: what bounds the memory of client and scheduler
CONNECT = 15.0
"""Seconds to reach a scheduler."""

POLL, LOOK = 0.02, 5.0
"""Polling interval of finished chunks and of workers [s]."""

PATIENCE = 120.0
"""Longest wait for a worker after all were lost [s]."""

CRASHES = 3
"""Consecutive members that end their workers, each alone, after which the workers are considered at fault."""

EXTRA = {"distributed": "dask.distributed", "pyarrow": "pyarrow", "cryptography": "cryptography"}
"""Modules of the extra ``campaign``, and their names."""


class WorkerMismatchError(RuntimeError):
    """A worker has another version of the package, other parameters or controllers."""


@contextlib.contextmanager
def cluster(scheduler: str, workers: int, tls: TlsFiles | None = None) -> Iterator[Any]:
    """Client of the cluster at an address, or of a new one on this machine.

    Parameters
    ----------
    scheduler : str
        For example ``tcp://host:8786`` or ``tls://host:8786``; empty for a local cluster.
    workers : int
        Processes of a local cluster; 0 for one each processor.
    tls : TlsFiles, optional
        Certificates for an address ``tls://``; default: those that Dask is configured with.

    Raises
    ------
    ValueError
        The extra is not installed; no scheduler at the address, one that refuses, or one without workers.
    """
    check_cluster(scheduler, tls)
    from distributed import Client

    if scheduler:
        with Client(scheduler, timeout=CONNECT, security=client_security(scheduler, tls)) as client:
            if not client.scheduler_info(n_workers=-1)["workers"]:
                raise InputError(f"scheduler must have workers, got none at {scheduler}")
            yield client
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    count = workers or processors()
    with local_cluster(count) as processes, Client(processes) as client:
        yield client


def check_cluster(scheduler: str, tls: TlsFiles | None = None) -> None:
    """Reject, before any computation, an invalid cluster.

    Parameters
    ----------
    scheduler : str
    tls : TlsFiles, optional
        As of :func:`cluster`.

    Raises
    ------
    ValueError
        The extra is not installed; no Dask scheduler answers at the address.
    """
    for module, name in EXTRA.items():
        if find_spec(module) is None:
            raise InputError(f"{name} must be installed: pip install 'los-testbed[campaign]'")
    if scheduler:
        _check_address(scheduler, client_security(scheduler, tls).get_connection_args("client"))


def _check_address(scheduler: str, arguments: dict[str, Any]) -> None:
    """Reject an address without a Dask scheduler: no server, a silent one, or another program.

    Dask itself waits for a silent server without a timeout.
    """
    from distributed.comm import get_address_host_port
    from distributed.core import rpc

    async def identity_there() -> dict[str, Any]:
        async with rpc(scheduler, timeout=CONNECT, connection_args=arguments) as there:
            answered: dict[str, Any] = await there.identity()
            return answered

    try:
        if scheduler.startswith(("tcp:", SCHEME)):  # Dask would try a port that nobody has, too, until the time is over
            socket.create_connection(get_address_host_port(scheduler, strict=True), CONNECT).close()
        kind = asyncio.run(asyncio.wait_for(identity_there(), CONNECT + 1.0)).get("type")
    except asyncio.TimeoutError:
        reason = f"no answer within {CONNECT:g} s"
    except MemoryError:  # for a length that is none
        reason = "the server is not Dask"
    except Exception as error:  # whatever Dask makes of the bytes of another program
        reason = _first_cause(error, scheduler)
    else:
        if kind == "Scheduler":
            return
        reason = f"a {kind} answers"
    raise InputError(f"scheduler must be the address of a running Dask scheduler, got {scheduler}: {reason}")


def _first_cause(error: BaseException, scheduler: str) -> str:
    """Cause of Dask's exception, in one line.

    A scheduler that refuses this client's certificate does so after the handshake (TLS 1.3): the client sees its alert,
    or only the end of the connection, whichever comes first.
    """
    while error.__cause__ is not None:
        error = error.__cause__
    ended = isinstance(error, (ssl.SSLEOFError, ConnectionError)) or "_ALERT_" in str(error)
    if scheduler.startswith(SCHEME) and ended and not isinstance(error, ConnectionRefusedError):
        return f"it closed the connection: it must trust the CA of --tls-cert ({_one_line(error)})"
    return _one_line(error)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


@dataclass(frozen=True)
class CampaignOptions:
    """What is asked of a campaign beside the settings of its members' runs.

    Parameters
    ----------
    samples, seed, sampling, depth
        As of :class:`los_testbed.campaign.dataset.Campaign`.
    resume : bool
        Continue in the folder.
    workers : int
        Processes of a local cluster; 0 for one each processor.
    scheduler, tls
        As of :func:`cluster`.
    """

    samples: int = 100
    seed: int = 1
    sampling: str = "uniform"
    depth: str = "time"
    resume: bool = False
    workers: int = 0
    scheduler: str = ""
    tls: TlsFiles | None = None


def evaluate_campaign(
    base: RunConfig,
    folder: ResultFolder,
    options: CampaignOptions,
    searching: AbstractContextManager[Workers | None] | None = None,
    evaluating: AbstractContextManager[None] | None = None,
) -> tuple[Campaign, tuple[str, ...]]:
    """Check a campaign, write warnings and progress to the error output, and compute the rows that are missing.

    Parameters
    ----------
    base : RunConfig
        Settings that all members share.
    folder : ResultFolder
    options : CampaignOptions
    searching : context manager, optional
        Of the workers of a search for adversarial members; default: none.
    evaluating : context manager, optional
        Around the computation of the rows.

    Returns
    -------
    campaign : Campaign
    warnings : tuple of str
        Of the controllers, see :meth:`los_testbed.parts.run_parts.RunParts.check`.

    Raises
    ------
    ValueError
        Settings that do not fit, a folder that exists, or another campaign in it; what :func:`cluster` and
        :func:`check_workers` refuse.
    """
    folder.check(options.resume)
    warnings = RunParts(base).check()
    warn(warnings)
    check_cluster(options.scheduler, options.tls)  # before a search for adversarial members, which takes minutes
    with Progress("parameters of the members"), searching or nullcontext() as pool:
        sampling = options.sampling, options.samples, options.seed, options.depth
        campaign = Campaign.of(base, *sampling, identity(base), pool)
    if options.resume:
        folder.compare(campaign)
    with contextlib.ExitStack() as stack:
        with Progress("workers"):
            client = stack.enter_context(cluster(options.scheduler, options.workers, options.tls))
            check_workers(campaign, client)
            done = folder.open(campaign, options.resume)
        if client.dashboard_link:
            sys.stderr.write(f"dashboard  {client.dashboard_link}\n")
        stack.enter_context(evaluating or nullcontext())
        bar = stack.enter_context(Progress("members", equal=True))
        finished = campaign.samples - sum(len(members) for _, members in campaign.chunks(done))
        before, start = finished, time.monotonic()

        def progress(members: int) -> None:
            nonlocal finished
            finished += members
            rate = (finished - before) / max(time.monotonic() - start, 1e-9)
            bar.report(finished, campaign.samples, what=f"members, {rate:.3g} per second")

        run_campaign(campaign, folder, client, done, progress)
    return campaign, warnings


def check_workers(campaign: Campaign, client: Any) -> None:
    """Reject a cluster before work begins: workers that join later are compared before their first member.

    Raises
    ------
    ValueError
        Workers with another version of the package, other parameters or controllers.
    """
    content = portable(campaign.base, campaign.identity)
    for address, answer in client.run(worker_identity, content, on_error="return").items():
        if isinstance(answer, BaseException):
            reason = " ".join(str(answer).split()) or type(answer).__name__
            raise InputError(f"worker {address} must have this version of los-testbed installed, got: {reason}")
        if difference := _difference(campaign.identity, answer):
            raise InputError(f"worker {address}: {difference}")


def run_campaign(
    campaign: Campaign,
    folder: ResultFolder,
    client: Any,
    done: frozenset[int] = frozenset(),
    progress: Callable[[int], None] = lambda members: None,
) -> None:
    """Compute the chunks that are not in `done`, and write each when it is finished.

    Parameters
    ----------
    campaign : Campaign
    folder : ResultFolder
        Opened.
    client : distributed.Client
    done : frozenset of int
        Chunks that are there already.
    progress : callable
        Called with the number of members of each chunk that was written.

    Raises
    ------
    ValueError
        Another process writes to the folder.
    RuntimeError
        The connection to the scheduler was lost, a worker has another installation, or rows cannot be written; written
        rows remain.
    """
    with folder.alone():
        try:
            _compute(campaign, folder, client, done, progress)
        except (CancelledError, TimeoutError, asyncio.TimeoutError, OSError) as error:
            text = " ".join(str(error).split()) or type(error).__name__
            raise RuntimeError(f"connection to the scheduler lost, {KEPT} ({text})") from None
        except WorkerMismatchError as error:
            raise RuntimeError(f"{error}; {KEPT}") from None


def _compute(
    campaign: Campaign, folder: ResultFolder, client: Any, done: frozenset[int], progress: Callable[[int], None]
) -> None:
    from distributed import as_completed

    content = portable(campaign.base, campaign.identity)
    waiting = campaign.chunks(done)
    known: dict[Any, tuple[int, list[dict[str, Any]]]] = {}

    def submit() -> Any:
        for number, members in waiting:
            future = client.submit(evaluate_chunk, content, members, campaign.depth, pure=False, retries=2)
            known[future] = number, members
            return future
        return None

    slots = AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    pending = as_completed([future for future in (submit() for _ in range(slots)) if future is not None])
    while not pending.is_empty():
        _wait(pending.has_ready, client)
        for future in pending.next_batch(block=False):
            number, members = known.pop(future)
            rows = _rows(client, future, content, members, campaign)
            try:
                folder.write(number, rows)
            except OSError as error:
                raise RuntimeError(f"rows cannot be written to {folder.path}: {error.strerror}, {KEPT}") from None
            progress(len(rows))
            following = submit()
            if following is not None:
                pending.add(following)


KEPT = "the rows so far are stored; resume with --resume"


def _wait(ready: Callable[[], bool], client: Any) -> None:
    """Wait, never without a worker for longer than :data:`PATIENCE`."""
    looked = seen = time.monotonic()
    while not ready():
        time.sleep(POLL)
        now = time.monotonic()
        if client.status == "closed":
            raise CancelledError("the client was closed")
        if now - looked > LOOK:
            looked = now
            if client.status != "running" or client.scheduler_info(n_workers=-1)["workers"]:
                seen = now
            if now - seen > PATIENCE:
                raise RuntimeError(f"no worker for {PATIENCE:g} s, {KEPT}")


def _fetched(client: Any, future: Any) -> list[dict[str, Any]] | None:
    """Wait for the rows of a task; None if it failed. Those of a lost worker are computed again."""
    while True:
        _wait(future.done, client)
        if future.status == "cancelled":
            raise CancelledError("tasks were cancelled")
        if future.status == "error":
            return None
        with contextlib.suppress(TimeoutError, asyncio.TimeoutError):
            rows: list[dict[str, Any]] = future.result(timeout=LOOK)
            return rows


def _rows(
    client: Any, future: Any, content: str, members: list[dict[str, Any]], campaign: Campaign
) -> list[dict[str, Any]]:
    """Rows of a chunk that is done; member by member where it failed."""
    fetched = _fetched(client, future)
    if fetched is not None:
        return fetched
    error = future.exception()
    if isinstance(error, WorkerMismatchError):
        raise error
    return _one_by_one(client, content, members, campaign)


def evaluate_chunk(content: str, members: list[dict[str, Any]], depth: str) -> list[dict[str, Any]]:
    """Rows of some members, on a worker."""
    return _evaluator(content).rows(members, depth)


def _one_by_one(client: Any, content: str, members: list[dict[str, Any]], campaign: Campaign) -> list[dict[str, Any]]:
    """Rows of a chunk that ended its workers: each member alone; a row with the reason for the one that ends them.

    Raises
    ------
    RuntimeError
        Several consecutive ones do: the workers are at fault, for instance with too little memory.
    """
    rows: list[dict[str, Any]] = []
    crashes = 0
    for member in members:
        future = client.submit(evaluate_chunk, content, [member], campaign.depth, pure=False)
        fetched = _fetched(client, future)
        if fetched is not None:
            rows += fetched
            crashes = 0
            continue
        error = future.exception()
        if isinstance(error, (WorkerMismatchError, CancelledError)):
            raise error
        crashes += 1
        if crashes == CRASHES:
            raise RuntimeError(
                f"{CRASHES} members in a row end their workers, the last of them {member['index']} "
                f"({type(error).__name__}; too little memory?), {KEPT}"
            )
        nothing = dict.fromkeys(campaign.metrics, float("nan"))
        reason = f"its worker ended: {type(error).__name__}"
        rows.append(finished_row(member["index"], member, nothing, CRASHED, reason))
    return rows


def _difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Difference between a worker and this process; empty without one."""
    for key, value in here.items():
        if there.get(key) != value:
            return f"{key} must be {value} as here, got {there.get(key)}"
    return ""


def worker_identity(content: str) -> dict[str, str]:
    """:func:`identity` of the process that calls it."""
    return identity(base_of(content))


@lru_cache(maxsize=2)
def _evaluator(content: str) -> MemberEvaluator:
    """Evaluator of this process, which may have joined the cluster after the others were compared."""
    if difference := _difference(json.loads(content)["identity"], worker_identity(content)):
        raise WorkerMismatchError(f"a worker has another installation: {difference}")
    return MemberEvaluator.of(base_of(content))
