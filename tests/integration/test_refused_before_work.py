"""What cannot be written, reached or changed is refused before any work: one line, exit code 2, and no process."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.command_line import refused

from lftkit.support.atomic_output import check_output

UDP, SERIAL = "los_testbed.rig.udp:UdpRig", "los_testbed.rig.serial:SerialRig"
NOWHERE = "/proc/x"
"""The superuser may write to this file system by its permissions, and nobody can."""
FREE = 100
"""A ROS domain that no test has (``ros_runs.private_domain``)."""


@pytest.fixture(autouse=True)
def no_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Nothing is started, and neither a tone nor a state of the loop is computed."""
    from los_testbed.parts.run_parts import RunParts

    def work(*arguments: Any, **options: Any) -> None:
        raise AssertionError("work before the refusal")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(subprocess.Popen, "__init__", work)
    monkeypatch.setattr(RunParts, "find_start", work)
    before = dict(os.environ)  # the clients of a run choose their middleware in it
    yield
    os.environ.clear()
    os.environ.update(before)


def closed_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


OUTPUTS = [
    "run --output",
    "run --mode=realtime --trace",
    "run --mode=inprocess --output",
    "stages --output",
    "campaign --samples=2 --output",
    "design certify --output",
    "design verify --output",
    "export c --output",
]
ADDRESSES = {
    f"run --device={UDP} --device-address=localhost": "device_address must be HOST:PORT, got 'localhost'",
    f"run --device={UDP} --device-address=:47800": "device_address must be HOST:PORT, got ':47800'",
    f"run --device={UDP} --device-address=127.0.0.1:99999": "device_address must be HOST:PORT, got",
    f"run --device={UDP} --device-address=a..b:47800": "device_address must have a host with an address, got",
    f"run --device={UDP} --device-address=192.0.2.1:5": "device_key must be given for a rig on another machine",
    f"run --device={UDP} --device-key=none": "device_key must be a file, got none",
    f"run --device={SERIAL} --device-address=/dev/none": "device_address must be the path of a serial line",
    f"device check {UDP} --device-address=localhost": "device_address must be HOST:PORT, got 'localhost'",
    "run --mode=realtime --live=8765 --live-host=192.0.2.1": "live port must be free on 192.0.2.1, got 8765",
    "campaign --samples=2 --scheduler=tcp://127.0.0.1:{port}": "scheduler must be the address of a running Dask",
    f"control stop --domain={FREE}": f"--domain must be a ROS domain with a run on this machine, got {FREE}",
    f"control start --domain={FREE}": f"--domain must be a ROS domain with a run on this machine, got {FREE}",
    f"control stage fsm --domain={FREE}": f"--domain must be a ROS domain with a run on this machine, got {FREE}",
    f"control fault noise 0 --domain={FREE}": f"--domain must be a ROS domain with a run on this machine, got {FREE}",
    f"control activate controller --domain={FREE}": "--domain must be a ROS domain with a run on this machine, got",
}


@pytest.mark.parametrize("command", OUTPUTS)
def test_an_output_that_cannot_be_written(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"must be a path that can be written, got {NOWHERE}: " in refused(capsys, *command.split(), NOWHERE)


@pytest.mark.parametrize("command", ADDRESSES)
def test_an_address_without_anybody(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    if command.startswith(("control", "run")):
        pytest.importorskip("rclpy")
    assert ADDRESSES[command] in refused(capsys, *command.format(port=closed_port()).split())


@pytest.mark.parametrize("folder", [True, False])
def test_what_can_be_written_is_not_touched(tmp_path: Path, folder: bool) -> None:
    (tmp_path / "there").mkdir()
    check_output(tmp_path / "new", "output", new=True, folder=folder)
    check_output(tmp_path / "there", "output", folder=True)
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]
