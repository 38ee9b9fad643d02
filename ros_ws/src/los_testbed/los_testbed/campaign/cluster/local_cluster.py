"""Dask cluster on this machine for one campaign: closed to others, and removed however it ends."""

from __future__ import annotations

import contextlib
import logging
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

PREFIX = "los_testbed_campaign_"

SETTINGS: dict[str, Any] = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Dask's workers return memory to the system at every turn: a member would fault 9000 pages again. Dask records call
stacks a hundred times a second: 4 MB a minute for the thousand seconds that it stores. And it serves pages without a
certificate."""

LOOPBACK = "127.0.0.1"

REMOVE = """
import os, shutil, sys, time
sys.stdin.read()  # until the other end is closed: by the block, or by the system with its process
end = time.monotonic() + 60.0
while os.path.lexists(sys.argv[1]) and time.monotonic() < end:  # its workers may need a moment to end
    shutil.rmtree(sys.argv[1], ignore_errors=True)
    time.sleep(0.05)
"""


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """A ``distributed.SpecCluster`` of so many processes with one thread each, closed with the block.

    It listens on the loopback interface with TLS and requires its own certificate; it
    has no web server. Its files, the key among them, are in a :func:`scratch_folder`. A signal that comes while
    processes start is answered when they have started and can be closed in order. SIGINT, which a terminal sends to
    all processes, is left to this one.
    """
    from dask import config
    from distributed import SpecCluster

    with scratch_folder() as folder, _loop_without_interrupts() as loop, contextlib.ExitStack() as closed:
        with _signals_later():
            with config.set(SETTINGS):
                started = SpecCluster(**_specification(workers, folder), loop=loop, silence_logs=50)
            closed.enter_context(started)
        yield started


def _specification(workers: int, folder: Path) -> dict[str, Any]:
    """Scheduler and workers as ``distributed.LocalCluster`` has them, but without their web servers."""
    from distributed import Nanny
    from distributed.worker_memory import parse_memory_limit

    from los_testbed.campaign.cluster.dask_servers import SchedulerWithoutPages, WorkerWithoutPages

    security = _security(folder)
    common = {"host": LOOPBACK, "protocol": "tls://", "security": security, "local_directory": str(folder)}
    scheduler = {"cls": SchedulerWithoutPages, "options": {**common, "port": 0, "dashboard": False}}
    options = {
        **common,
        "worker_class": WorkerWithoutPages,
        "nthreads": 1,
        "dashboard": False,
        "silence_logs": 50,
        "memory_limit": parse_memory_limit("auto", 1, workers, logger=logging.getLogger(__name__)),
    }
    worker = {"cls": Nanny, "options": options}
    return {
        "scheduler": scheduler,
        "workers": dict.fromkeys(range(workers), worker),
        "worker": worker,
        "security": security,
    }


def _security(folder: Path) -> Any:
    """New certificate and key that scheduler, workers and client share, in files that their owner alone can read.

    As text in memory each process would write them to a folder of its own, which a process that is killed leaves.
    """
    from distributed.security import Security

    made = Security.temporary()
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    for path, content in ((certificate, made.tls_client_cert), (key, made.tls_client_key)):
        path.touch(mode=0o600, exist_ok=False)
        path.write_text(content, "utf-8")
    roles = ("client", "scheduler", "worker")
    files = {f"tls_{role}_{name}": str(path) for role in roles for name, path in (("cert", certificate), ("key", key))}
    return Security(require_encryption=True, tls_ca_file=str(certificate), **files)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder for this block. A process of its own removes it, also after a second signal or SIGKILL.

    Examples
    --------
    >>> with scratch_folder() as folder:
    ...     _ = (folder / "spilled").write_text("data")
    >>> folder.exists()
    False
    """
    folder = Path(tempfile.gettempdir()) / f"{PREFIX}{secrets.token_hex(4)}"
    command = [sys.executable, "-I", "-S", "-c", REMOVE, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as remover:  # before the folder
        try:
            folder.mkdir(mode=0o700)
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            if remover.stdin is not None:
                remover.stdin.close()


@contextlib.contextmanager
def _loop_without_interrupts() -> Iterator[Any]:
    """Event loop in a thread with SIGINT blocked, which its child processes inherit."""
    from distributed.utils import LoopRunner

    resource_tracker.ensure_running()  # it would unblock the signal in the thread that starts it
    runner, before = LoopRunner(), signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        runner.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield runner.loop
    finally:
        runner.stop()


@contextlib.contextmanager
def _signals_later() -> Iterator[None]:
    """Signals that end a command are answered at the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if callable(signal.getsignal(number))
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])
