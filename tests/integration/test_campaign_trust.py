"""Who can reach the processes of a campaign on this machine, and read what lets one reach them."""

from __future__ import annotations

import json
import os
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from los_testbed.campaign.execution import cluster

NOBODY = 65534

STRANGER = """
import asyncio, json, os, sys
from distributed import Client
from distributed.core import rpc
from distributed.security import Security

given = json.load(sys.stdin)
own = Security(require_encryption=True, **given["tls"]) if given["tls"] else Security.temporary()
if given["uid"]:
    os.setgroups([])
    os.setgid(given["uid"])
    os.setuid(given["uid"])

async def identity(address, security):
    arguments = security.get_connection_args("client")
    async with rpc(address, timeout=5, connection_args=arguments) as there:
        return (await there.identity())["type"]

async def function(address, security):
    async with Client(address, security=security, timeout=5, asynchronous=True) as client:
        return "ran with uid %d" % await client.submit(os.getuid, pure=False)

async def outcome(call, address, security):
    try:
        return await asyncio.wait_for(call(address, security), 15)
    except Exception:
        return "refused"

async def read(path):
    try:
        return open(path).read()
    except OSError:
        return "refused"

async def main():
    calls = {}
    for scheme, security in {"tcp": Security(), "tls": own}.items():
        for address in given["addresses"]:
            calls[f"{scheme} {address}"] = outcome(identity, f"{scheme}://{address}", security)
        address = given["addresses"][0]
        calls[f"{scheme} function"] = outcome(function, f"{scheme}://{address}", security)
    for path in given["files"]:
        calls[path] = read(path)
    print(json.dumps(dict(zip(calls, await asyncio.gather(*calls.values())))))

asyncio.run(main())
"""
"""What a process of this or another user gets from the addresses of a cluster, the scheduler's first, and from files:
over TCP, and over TLS with the certificate that it is given or else one of its own."""


def got(
    addresses: list[str], files: tuple[str, ...] = (), uid: int = 0, tls: dict[str, str] | None = None
) -> dict[str, str]:
    given = {"addresses": addresses, "files": files, "uid": uid, "tls": tls}
    done = subprocess.run(
        [sys.executable, "-c", STRANGER], input=json.dumps(given), capture_output=True, text=True, check=True, cwd="/"
    )
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.fixture
def open_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A temporary folder that every user can enter, like /tmp; those of tests, made before, have an owner."""
    pytest.importorskip("distributed")
    folder = Path(tempfile.mkdtemp(dir="/tmp"))
    folder.chmod(0o755)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def addresses_of(client: Any) -> list[str]:
    """HOST:PORT of scheduler, workers and nannies."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    found = [client.scheduler.address, *workers, *(worker["nanny"] for worker in workers.values())]
    return [address.partition("://")[2] for address in found]


@pytest.mark.parametrize(
    "uid", [pytest.param(0, id="same-user"), pytest.param(NOBODY, id="other-user", marks=pytest.mark.slow)]
)
def test_client_without_the_certificate_is_refused(uid: int, open_folder: Path) -> None:
    """By scheduler, worker and nanny; the same program with the certificate is let in, so it is that which it lacks."""
    if uid and os.getuid() != 0:
        pytest.skip("only root can start a process of another user")
    with cluster("", 1) as client:
        addresses = addresses_of(client)
        assert len(addresses) == 3
        found = got(addresses, uid=uid)
        assert len(found) == 8 and set(found.values()) == {"refused"}, found
        content = {
            name: Path(getattr(client.security, name)).read_text("utf-8")
            for name in ("tls_ca_file", "tls_client_cert", "tls_client_key")
        }
        let_in = got(addresses, uid=uid, tls=content)
        assert let_in["tls function"] == f"ran with uid {os.getuid()}"
        assert "refused" not in {let_in[f"tls {address}"] for address in addresses}
        assert {outcome for name, outcome in let_in.items() if name.startswith("tcp")} == {"refused"}


def test_key_can_be_read_by_its_owner_only(open_folder: Path) -> None:
    """In files, environments and command lines of the processes; and nothing of it stays."""
    import psutil

    with cluster("", 1) as client:
        key = Path(client.security.tls_client_key)
        secret = key.read_text("utf-8").splitlines()[1]
        assert key.read_text("utf-8").startswith("-----BEGIN PRIVATE KEY-----") and len(secret) == 64
        copies = [path for path in open_folder.rglob("*") if path.is_file() and secret.encode() in path.read_bytes()]
        assert copies == [key]
        assert (stat.S_IMODE(key.stat().st_mode), stat.S_IMODE(key.parent.stat().st_mode)) == (0o600, 0o700)
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        assert len(processes) >= 3  # also the worker and what removes the folder
        for process in processes:
            seen = [Path(f"/proc/{process.pid}/{name}").read_bytes() for name in ("environ", "cmdline")]
            assert not any(secret.encode() in content for content in seen)
        if os.getuid() == 0:
            found = got(addresses_of(client), files=(str(key),), uid=NOBODY)
            assert found[str(key)] == "refused"
    assert list(open_folder.iterdir()) == []


def answers_http(port: int) -> bool:
    with socket.create_connection(("127.0.0.1", port), 10) as connection:
        connection.sendall(b"GET / HTTP/1.0\r\n\r\n")
        try:
            return connection.recv(5) == b"HTTP/"
        except ConnectionError:
            return False


def test_every_socket_of_a_campaign_is_on_loopback_and_no_web_server_listens(open_folder: Path, tmp_path: Path) -> None:
    """Of the command with its worker, while it computes: scheduler, worker and nanny."""
    import psutil

    program = "import sys; from los_testbed.cli.app import main; sys.exit(main())"
    options = ["--samples=200", "--duration=1.1", "--loop=isolator", "--scenario=imbalance", "--workers=1"]
    output = tmp_path / "c"
    command = [sys.executable, "-c", program, "campaign", *options, f"--output={output}"]
    log = tmp_path / "log"
    with log.open("wb") as stream, subprocess.Popen(command, stdout=stream, stderr=stream) as process:
        try:
            while not (output / "campaign.json").exists():  # the workers were asked what they have
                assert process.poll() is None, log.read_text("utf-8")
                time.sleep(0.01)
            tree = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            sockets = [(one.pid, socket) for one in tree for socket in connections(one)]
            listening = {at.laddr.port for _, at in sockets if at.status == psutil.CONN_LISTEN}
            hosts = {at.laddr.ip for _, at in sockets}
            http = [port for port in sorted(listening) if answers_http(port)]
        finally:
            process.terminate()
    assert (hosts, len(listening), http) == ({"127.0.0.1"}, 3, [])
    assert "dashboard" not in log.read_text("utf-8")


def connections(process: Any) -> list[Any]:
    """Internet sockets of a process, those without a peer included."""
    listed = getattr(process, "net_connections", None) or process.connections
    found: list[Any] = listed(kind="inet")
    return found
