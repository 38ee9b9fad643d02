"""Campaigns on real Dask clusters: the rows do not depend on workers, interruptions or where they were computed."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import CHUNK, Campaign, ResultFolder
from los_testbed.campaign.execution import _fetched as fetched
from los_testbed.campaign.execution import _one_by_one as one_by_one
from los_testbed.campaign.execution import check_workers, cluster, evaluate_chunk, run_campaign
from los_testbed.campaign.portable import portable
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.run.identity import identity
from support.command_line import refused
from support.slow_cases import slow

BASE = RunConfig(mode="inprocess", duration=1.1, loop="isolator", scenario="imbalance")
OPTIONS = [
    "campaign",
    "--samples=30",
    "--seed=5",
    "--duration=1.1",
    "--loop=isolator",
    "--scenario=imbalance",
    "--json",
]


def asked(samples: int = 30) -> Campaign:
    return Campaign.of(BASE, "uniform", samples, 5, "time", identity(BASE))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> ResultFolder:
    """Rows computed in this process, without a cluster."""
    pytest.importorskip("pyarrow")
    folder = ResultFolder(tmp_path_factory.mktemp("campaign") / "undisturbed")
    computed(folder, asked(), folder.open(asked(), False), 30)
    return folder


def computed(folder: ResultFolder, campaign: Campaign, skip: frozenset[int], count: int) -> None:
    """Compute the first chunks of a campaign in this process, those in `skip` aside."""
    for number, members in islice(campaign.chunks(skip), count):
        folder.write(number, evaluate_chunk(portable(BASE, identity(BASE)), members, "time"))


@pytest.mark.further
def test_rows_of_a_campaign_that_is_resumed_are_those_of_one_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two chunks in this process: the one that is there is left as it is."""
    pytest.importorskip("pyarrow")
    monkeypatch.setitem(CHUNK, "time", 2)
    whole, parts = ResultFolder(tmp_path / "whole"), ResultFolder(tmp_path / "parts")
    computed(whole, asked(3), whole.open(asked(3), False), 2)
    computed(parts, asked(3), parts.open(asked(3), False), 1)
    there = parts.open(asked(3), True)
    assert there == {0} and len(parts.parts()) == 1
    computed(parts, asked(3), there, 2)
    assert parts.rows_hash() == whole.rows_hash() and len(parts.parts()) == 2


@pytest.mark.slow
def test_interrupted_and_resumed_with_two_workers(
    undisturbed: ResultFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    folder = ResultFolder(tmp_path / "c")

    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    with cluster("", 2) as client, pytest.raises(KeyboardInterrupt):
        run_campaign(asked(), folder, client, folder.open(asked(), False), interrupt)
    assert len(folder.parts()) == 1
    assert main([*OPTIONS, "--json", "--workers", "2", "--resume", "--keep", "1", "--output", str(folder.path)]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["rows_hash"] == undisturbed.rows_hash() == folder.rows_hash()
    assert (summary["members"], summary["status"]) == (30, {"ok": 30})
    assert [Path(bag).exists() for bag in summary["bags"]] == [True]


@pytest.fixture(scope="module")
def one_worker() -> Iterator[Any]:
    """Client of a local cluster that several tests ask; none of them changes it."""
    pytest.importorskip("distributed")
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith("MALLOC_")]:
            patch.delenv(name)
        with cluster("", 1) as client:
            yield client


class Processes:
    """A scheduler and workers as processes, each in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = str(free.getsockname()[1])
        self.folder, self.address = folder, f"tcp://127.0.0.1:{port}"
        self.started: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start(
            "scheduler", "dask", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"
        )

    def _start(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        (self.folder / name).mkdir()
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        with (self.folder / name / "log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", *words], cwd=self.folder / name, stdout=log, stderr=log, env=environment
            )
        self.started.append(process)
        return process

    def worker(self, name: str, *options: str) -> subprocess.Popen[bytes]:
        words = ("dask", "worker", self.address, "--nthreads", "1", "--no-dashboard", "--local-directory", ".")
        return self._start(name, *words, *(options or ("--no-nanny",)))

    def wait(self, workers: int) -> None:
        from distributed import Client

        with Client(self.address, timeout=600) as client:
            client.wait_for_workers(workers, timeout=600)

    def end(self) -> None:
        for process in reversed(self.started):
            process.terminate()
        for process in self.started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


@pytest.fixture
def processes(tmp_path: Path) -> Any:
    pytest.importorskip("distributed")
    started = Processes(tmp_path)
    try:
        yield started
    finally:
        started.end()


@pytest.mark.slow
def test_worker_killed_under_a_scheduler_elsewhere(
    undisturbed: ResultFolder, processes: Processes, tmp_path: Path
) -> None:
    first = processes.worker("first")
    processes.worker("second")
    processes.wait(2)
    folder = ResultFolder(tmp_path / "c")

    with cluster(processes.address, 0) as client:
        run_campaign(asked(), folder, client, folder.open(asked(), False), lambda _: first.kill())
    assert folder.rows_hash() == undisturbed.rows_hash()


@pytest.mark.slow
def test_lost_workers_and_a_lost_scheduler_end_the_campaign_and_resume_completes_it(
    undisturbed: ResultFolder, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("los_testbed.campaign.execution.PATIENCE", 1.0)
    monkeypatch.setattr("los_testbed.campaign.execution.LOOK", 0.2)
    worker = processes.worker("first")
    processes.wait(1)
    folder = ResultFolder(tmp_path / "c")
    message = r"no worker for 1 s, the rows so far are stored; resume with --resume"
    with cluster(processes.address, 0) as client, pytest.raises(RuntimeError, match=message):
        run_campaign(asked(), folder, client, folder.open(asked(), False), lambda _: worker.kill())
    assert len(folder.parts()) == 1

    monkeypatch.setattr("los_testbed.campaign.execution.PATIENCE", 1e9)
    processes.worker("second")
    processes.wait(1)
    message = r"connection to the scheduler lost, the rows so far are stored; resume with --resume"
    with pytest.raises(RuntimeError, match=message), cluster(processes.address, 0) as client:
        run_campaign(asked(), folder, client, folder.open(asked(), True), lambda _: processes.scheduler.kill())
    assert len(folder.parts()) == 2

    with cluster("", 1) as client:
        run_campaign(asked(), folder, client, folder.open(asked(), True))
    assert folder.rows_hash() == undisturbed.rows_hash()


@pytest.mark.slow
def test_rows_that_a_lost_worker_had_are_computed_again_and_not_waited_for_without_workers(
    undisturbed: ResultFolder, processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a chunk that was finished but not fetched, and of members that are computed alone."""
    monkeypatch.setattr("los_testbed.campaign.execution.PATIENCE", 1.0)
    monkeypatch.setattr("los_testbed.campaign.execution.LOOK", 0.2)
    first = processes.worker("first")
    processes.wait(1)
    (_, members), *_ = asked().chunks()
    content = portable(BASE, identity(BASE))
    message = r"no worker for 1 s, the rows so far are stored; resume with --resume"
    with cluster(processes.address, 0) as client:
        future = client.submit(evaluate_chunk, content, members, "time", pure=False)
        while not future.done():
            time.sleep(0.01)
        first.kill()
        while client.scheduler_info(n_workers=-1)["workers"]:
            time.sleep(0.01)
        with pytest.raises(RuntimeError, match=message):
            fetched(client, future)
        with pytest.raises(RuntimeError, match=message):
            one_by_one(client, content, members, asked())
        monkeypatch.setattr("los_testbed.campaign.execution.PATIENCE", 1e9)
        processes.worker("second")
        assert fetched(client, future) == undisturbed.table().slice(0, 10).to_pylist()


@pytest.fixture
def no_second_try(monkeypatch: pytest.MonkeyPatch) -> None:
    """Schedulers started after this give a task up with its first worker: each worker that ends is started anew."""
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")


@pytest.mark.slow
def test_workers_without_memory_end_the_campaign_and_resume_completes_it(
    no_second_try: None, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A nanny ends a worker above its limit and starts another one; depth model takes some 300 MB."""
    monkeypatch.setattr("los_testbed.campaign.execution.CRASHES", 2)
    processes.worker("small", "--memory-limit", "220MB")
    processes.wait(1)
    folder, three = ResultFolder(tmp_path / "c"), Campaign.of(BASE, "uniform", 3, 5, "model", identity(BASE))
    message = r"2 members in a row end their workers, the last of them 1 \(KilledWorker; too little memory\?\)"
    with cluster(processes.address, 0) as client, pytest.raises(RuntimeError, match=message):
        run_campaign(three, folder, client, folder.open(three, False))
    assert folder.parts() == []
    with cluster("", 1) as client:
        run_campaign(three, folder, client, folder.open(three, True))
    (_, members), *_ = three.chunks()
    assert folder.table().to_pylist() == evaluate_chunk(portable(BASE, identity(BASE)), members, "model")


def no_search(*_: object) -> None:
    raise AssertionError("members were searched for")


@pytest.mark.parametrize("sampling", ["uniform", "adversarial"])
def test_unreachable_scheduler_is_one_line_before_members_are_searched_for(
    sampling: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("los_testbed.campaign.execution.CONNECT", 1.0)
    monkeypatch.setattr("los_testbed.campaign.dataset.adversarial_members", no_search)
    options = ["--scheduler", "tcp://127.0.0.1:9", "--sampling", sampling, "--output", str(tmp_path / "c")]
    message = "scheduler must be the address of a running Dask scheduler, got tcp://127.0.0.1:9"
    assert message in refused(capsys, "campaign", *options)
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"", "no answer within 1 s"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "the server is not Dask"),
        (bytes(64), "unpack_from requires a buffer"),
    ],
)
def test_address_of_another_program_is_refused(answer: bytes, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent one, a web server, one that sends zeros."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("los_testbed.campaign.execution.CONNECT", 60.0 if answer else 1.0)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    connections.append(connection)
                    connection.sendall(answer)

        connections: list[socket.socket] = []
        threading.Thread(target=serve, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        message = f"scheduler must be the address of a running Dask scheduler, got {address}: {reason}"
        with pytest.raises(ValueError, match=message), cluster(address, 0):
            pass
    for connection in connections:
        connection.close()


def test_worker_with_other_parameters_is_refused(one_worker: Any) -> None:
    other = Campaign.of(BASE, "uniform", 30, 5, "time", {**identity(BASE), "telescope": "0123"})
    with pytest.raises(ValueError, match=r"worker tls://.*: telescope must be 0123 as here, got [0-9a-f]{16}"):
        check_workers(other, one_worker)


@pytest.mark.further
def test_worker_that_joins_later_is_compared_too(one_worker: Any, tmp_path: Path) -> None:
    other = Campaign.of(BASE, "uniform", 30, 5, "time", {**identity(BASE), "version": "9"})
    folder = ResultFolder(tmp_path / "c")
    message = r"a worker has another installation: version must be 9 as here, got \S+; the rows so far are stored"
    with pytest.raises(RuntimeError, match=message):
        run_campaign(other, folder, one_worker, folder.open(other, False))
    assert folder.parts() == []


@pytest.mark.further
@pytest.mark.parametrize(
    ("module", "name"),
    [("distributed", r"dask\.distributed"), ("pyarrow", "pyarrow"), slow("cryptography", "cryptography")],
)
def test_missing_extra_is_named_before_members_are_searched_for(
    module: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr("los_testbed.campaign.dataset.adversarial_members", no_search)
    expected = rf"{name} must be installed: pip install 'los-testbed\[campaign\]'"
    with pytest.raises(ValueError, match=expected), cluster("", 1):
        pass
    line = refused(capsys, "campaign", "--sampling", "adversarial", "--output", tmp_path / "c")
    assert re.search(expected, line)
