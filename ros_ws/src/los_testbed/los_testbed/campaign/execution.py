"""Computes the chunks of a campaign on the worker processes of a Dask cluster and writes their rows as they finish."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from los_testbed import __version__
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import DEPTHS, MemberEvaluator, finished_row
from los_testbed.config import RunConfig
from los_testbed.factories import controller_files

AHEAD = 3  # chunks per worker that are handed out before their turn: what bounds the memory of client and scheduler
CONNECT = 15.0
"""Seconds to reach a scheduler."""

FILES = ("k_fsm", "k_pma", "parameters")
"""Settings that are files; their content travels with the campaign, so that workers need nothing but the package."""


def identity(base: RunConfig) -> dict[str, str]:
    """Version of the package and hashes of what the rows depend on: the same on all workers, or there is no campaign.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    from titop_plant.telescope.parameters import REFERENCE, load_parameters, parameters_hash

    controllers = {name: _digest(path) for name, path in controller_files(base).items()}
    return {
        "version": __version__,
        "numpy": np.__version__,
        "parameters": parameters_hash(load_parameters(base.parameters or REFERENCE)),
        **controllers,
    }


@contextlib.contextmanager
def cluster(scheduler: str, workers: int) -> Iterator[Any]:
    """Client of the cluster at an address, or of a new one on this machine.

    Parameters
    ----------
    scheduler : str
        For example ``tcp://host:8786``; empty for a local cluster.
    workers : int
        Processes of a local cluster; 0 for one each processor.

    Raises
    ------
    ValueError
        The extra is not installed; no scheduler at the address, or one without workers.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError("dask.distributed must be installed: pip install 'los-testbed[campaign]'") from None
    if scheduler:
        try:
            client = Client(scheduler, timeout=CONNECT)
        except (OSError, ValueError, TypeError) as error:
            text = str(error) or type(error).__name__
            raise ValueError(
                f"scheduler must be the address of a running Dask scheduler, got {scheduler}: {text}"
            ) from None
        with client:
            if not client.scheduler_info(n_workers=-1)["workers"]:
                raise ValueError(f"scheduler must have workers, got none at {scheduler}")
            yield client
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    count = workers or len(os.sched_getaffinity(0))
    with (
        tempfile.TemporaryDirectory(prefix="los_testbed_campaign_") as local,
        LocalCluster(
            n_workers=count, threads_per_worker=1, dashboard_address=":0", local_directory=local, silence_logs=40
        ) as processes,
        Client(processes) as client,
    ):
        yield client


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
        Workers with another version of the package, other parameters or controllers.
    RuntimeError
        The scheduler was lost, or rows cannot be written; what was written stays.
    """
    from distributed import as_completed

    content = _portable(campaign.base)
    _check_workers(campaign, client, content)
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
    try:
        for future in pending:
            number, members = known.pop(future)
            if future.status == "cancelled":
                raise CancelledError("tasks were cancelled")
            rows = future.result() if future.status == "finished" else _one_by_one(client, content, members, campaign)
            _written(folder, number, rows)
            progress(len(rows))
            following = submit()
            if following is not None:
                pending.add(following)
    except (CancelledError, TimeoutError, OSError) as error:
        text = " ".join(str(error).split())
        raise RuntimeError(f"the scheduler was lost, the rows so far are kept; go on with --resume ({text})") from None


def _written(folder: ResultFolder, number: int, rows: list[dict[str, Any]]) -> None:
    try:
        folder.write(number, rows)
    except OSError as error:
        raise RuntimeError(f"rows cannot be written to {folder.path}: {error.strerror}; go on with --resume") from None


def evaluate_chunk(content: str, members: list[dict[str, Any]], depth: str) -> list[dict[str, Any]]:
    """Rows of some members, on a worker."""
    evaluator = _evaluator(content)
    return [evaluator.row(member["index"], member, depth) for member in members]


def _one_by_one(client: Any, content: str, members: list[dict[str, Any]], campaign: Campaign) -> list[dict[str, Any]]:
    """Rows of a chunk that ended its workers: each member alone, and a row with the reason for the one that does it."""
    rows: list[dict[str, Any]] = []
    for member in members:
        future = client.submit(evaluate_chunk, content, [member], campaign.depth, pure=False)
        error = future.exception()
        if error is None:
            rows += future.result()
        else:
            nothing = dict.fromkeys(DEPTHS[campaign.depth], float("nan"))
            rows.append(finished_row(member["index"], member, nothing, "failed", type(error).__name__))
    return rows


def _check_workers(campaign: Campaign, client: Any, content: str) -> None:
    for address, found in client.run(worker_identity, content, on_error="return").items():
        if isinstance(found, BaseException):
            reason = " ".join(str(found).split()) or type(found).__name__
            raise ValueError(f"worker {address} must have this version of los-testbed installed, got: {reason}")
        for key, value in campaign.identity.items():
            if found.get(key) != value:
                raise ValueError(f"worker {address}: {key} must be {value} as here, got {found.get(key)}")


def worker_identity(content: str) -> dict[str, str]:
    """:func:`identity` of the process that calls it."""
    return identity(_base(content))


def _portable(base: RunConfig) -> str:
    """Configuration and content of its files as one text."""
    files = {name: Path(path).read_text("utf-8") for name in FILES if (path := getattr(base, name))}
    return json.dumps({"run": base.to_mapping(), "files": files}, sort_keys=True)


def _worker_folder() -> str | None:
    """Folder of this Dask worker, which is removed when the worker ends; None outside of one."""
    from distributed import get_worker

    try:
        return str(get_worker().local_directory)
    except ValueError:
        return None


@lru_cache(maxsize=2)
def _base(content: str) -> RunConfig:
    """Configuration with its files on this machine."""
    given = json.loads(content)
    if not given["files"]:
        return RunConfig.from_mapping(given["run"])
    folder = Path(tempfile.mkdtemp(prefix="los_testbed_files_", dir=_worker_folder()))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name, text in given["files"].items():
        path = folder / f"{name}{Path(given['run'][name]).suffix}"
        path.write_text(text, "utf-8")
        given["run"][name] = str(path)
    return RunConfig.from_mapping(given["run"])


@lru_cache(maxsize=2)
def _evaluator(content: str) -> MemberEvaluator:
    return MemberEvaluator.of(_base(content))


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise ValueError(f"cannot read the controller file {path}: {error.strerror}") from None
