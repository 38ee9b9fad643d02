"""Campaigns on real Dask clusters: the rows do not depend on workers, interruptions or where they were computed."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.execution import _portable as portable
from los_testbed.campaign.execution import cluster, evaluate_chunk, identity, run_campaign
from los_testbed.cli.app import main
from los_testbed.config import RunConfig

BASE = RunConfig(mode="inprocess", duration=1.1, loop="isolator", scenario="imbalance")
OPTIONS = ["campaign", "--samples", "30", "--seed", "5", "--duration", "1.1", "--loop", "isolator",
           "--scenario", "imbalance", "--json"]  # fmt: skip


def asked(samples: int = 30) -> Campaign:
    return Campaign.of(BASE, "uniform", samples, 5, "time", identity(BASE))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> ResultFolder:
    """Rows computed in this process, without a cluster."""
    pytest.importorskip("pyarrow")
    folder = ResultFolder(tmp_path_factory.mktemp("campaign") / "undisturbed")
    folder.open(asked(), False)
    for number, members in asked().chunks():
        folder.write(number, evaluate_chunk(portable(BASE), members, "time"))
    return folder


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
    assert main([*OPTIONS, "--workers", "2", "--resume", "--keep", "1", "--output", str(folder.path)]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["rows_hash"] == undisturbed.rows_hash() == folder.rows_hash()
    assert (summary["members"], summary["status"]) == (30, {"ok": 30})
    assert [Path(bag).exists() for bag in summary["bags"]] == [True]


@pytest.fixture
def scheduler(tmp_path: Path) -> Any:
    """Address of a scheduler with two worker processes in folders of their own, and the processes of the workers."""
    pytest.importorskip("distributed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    started = []

    def start(name: str, *words: str) -> subprocess.Popen[bytes]:
        (tmp_path / name).mkdir()
        with (tmp_path / name / "log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *words], cwd=tmp_path / name, stdout=log, stderr=log,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )  # fmt: skip
        started.append(process)
        return process

    port = address.rsplit(":", 1)[1]
    start("scheduler", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
    options = ("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", ".")
    workers = [start(name, *options) for name in ("first", "second")]
    try:
        yield address, workers
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_worker_killed_under_a_scheduler_elsewhere(undisturbed: ResultFolder, scheduler: Any, tmp_path: Path) -> None:
    from distributed import Client

    address, workers = scheduler
    with Client(address, timeout=60) as client:
        client.wait_for_workers(2, timeout=120)
    folder = ResultFolder(tmp_path / "c")

    def kill(_: int) -> None:
        workers[0].kill()

    with cluster(address, 0) as client:
        run_campaign(asked(), folder, client, folder.open(asked(), False), kill)
    assert folder.rows_hash() == undisturbed.rows_hash()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--samples", "0"], "samples must be 1 or more, got 0"),
        (["--sampling", "sobol"], "must be one of uniform, lhs, corners, adversarial or a CSV file, got sobol"),
        (["--depth", "deep"], "depth must be one of time, model, got 'deep'"),
        (["--resume"], "--output must be given with --resume, got none"),
        (["--loop", "open"], "loop must be one of"),
    ],
)
def test_mistakes_are_one_line_before_work_begins(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["campaign", *options])
    captured = capsys.readouterr().err
    assert stopped.value.code == 2 and message in captured and len(captured.splitlines()) == 1


def test_unreachable_scheduler_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("los_testbed.campaign.execution.CONNECT", 1.0)
    with pytest.raises(SystemExit) as stopped:
        main(["campaign", "--scheduler", "tcp://127.0.0.1:9", "--output", str(tmp_path / "c")])
    captured = capsys.readouterr().err
    assert (
        stopped.value.code == 2
        and "scheduler must be the address of a running Dask scheduler, got tcp://127.0.0.1:9" in captured
    )
    assert not (tmp_path / "c").exists()


def test_worker_with_other_parameters_is_refused(undisturbed: ResultFolder, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    other = Campaign.of(BASE, "uniform", 30, 5, "time", {**identity(BASE), "parameters": "0123"})
    with (
        cluster("", 1) as client,
        pytest.raises(ValueError, match=r"worker tcp://.*: parameters must be 0123 as here, got [0-9a-f]{12}"),
    ):
        run_campaign(other, ResultFolder(tmp_path / "c"), client)


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    expected = r"dask\.distributed must be installed: pip install 'los-testbed\[campaign\]'"
    with pytest.raises(ValueError, match=expected), cluster("", 1):
        pass
