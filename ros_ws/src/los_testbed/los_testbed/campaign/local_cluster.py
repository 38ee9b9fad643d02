"""Dask cluster on this machine that leaves nothing behind, whatever ends the process that started it."""

from __future__ import annotations

import contextlib
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

SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.worker.profile.enabled": False,
}
"""Dask lets its workers give memory back to the system at every turn: a member would fault 9000 pages anew. And it
records call stacks a hundred times a second: 4 MB a minute for the thousand seconds that it keeps."""

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
    """A ``distributed.LocalCluster`` of so many processes with one thread each, closed with the block.

    Its files are in a :func:`scratch_folder`. A signal that comes while processes start is answered when they have
    started and can be closed in order. SIGINT, which a terminal sends to all processes, is left to this one.
    """
    from dask import config
    from distributed import LocalCluster

    with scratch_folder() as folder, _loop_without_interrupts() as loop, contextlib.ExitStack() as closed:
        with _signals_later():
            with config.set(SETTINGS):
                started = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=50,
                    loop=loop,
                    local_directory=str(folder),
                    scheduler_kwargs={"local_directory": str(folder)},
                )
            closed.enter_context(started)
        yield started


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
    """Event loop in a thread with SIGINT blocked, which the processes that it starts inherit."""
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
