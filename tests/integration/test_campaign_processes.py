"""Processes of a campaign: who can reach them and read their key, schedulers with certificates, what they leave."""

from __future__ import annotations

import datetime
import json
import os
import shutil
import signal
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
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.execution import cluster, evaluate_chunk
from los_testbed.campaign.portable import portable
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.run.identity import identity
from support.command_line import refused
from support.marked_processes import processes_with

pytest.importorskip("distributed")
pytest.importorskip("cryptography")
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

PROGRAM = """
import signal
from los_testbed.cli.app import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts tests in the background ignores it
main()
"""
OPTIONS = ["campaign", "--samples=200", "--duration=1.1", "--loop=isolator", "--scenario=imbalance", "--workers=1"]
BASE = RunConfig(mode="inprocess", duration=1.1, loop="isolator", scenario="imbalance")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_another_campaign_in_the_folder_is_refused_without_a_cluster(temporary: Path, tmp_path: Path) -> None:
    """Told in one line by a process that has ended afterwards, and the folder is as it was."""
    output = tmp_path / "c"
    ResultFolder(output).open(Campaign.of(BASE, "uniform", 100, 1, "time", identity(BASE)), False)
    manifest = (output / "campaign.json").read_bytes()
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM, *OPTIONS, f"--output={output}", "--resume"],
        capture_output=True,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
        check=False,
    )
    message = (
        f"los-testbed: output must be a new folder or one of the same campaign, got {output}, "
        "which holds another: samples must be 100 as there, got 200\n"
    )
    assert (process.returncode, process.stdout, process.stderr) == (2, "", message)
    assert list(temporary.iterdir()) == [] and (output / "campaign.json").read_bytes() == manifest


@pytest.mark.parametrize("started", ["folder", pytest.param("rows", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name",
    ["SIGINT", *(pytest.param(name, marks=pytest.mark.slow) for name in ("keyboard", "SIGTERM", "SIGHUP", "SIGKILL"))],
)
def test_after_a_signal(name: str, started: str, temporary: Path, tmp_path: Path) -> None:
    """While the workers start, and while members are computed; a key of a terminal reaches workers, too."""
    output, variable = tmp_path / "c", f"TMPDIR={temporary}"
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *OPTIONS, f"--output={output}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
        start_new_session=True,
    )
    pattern = {"folder": (temporary, "los_testbed_campaign_*"), "rows": (output, "rows/part-*.parquet")}[started]
    while not list(pattern[0].glob(pattern[1])):
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.01)
    if name == "keyboard":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=600)
    end = time.monotonic() + 60.0
    while (list(temporary.iterdir()) or processes_with(variable)) and time.monotonic() < end:
        assert name == "SIGKILL", "others leave nothing when they have ended"
        time.sleep(0.05)
    assert list(temporary.iterdir()) == [] and processes_with(variable) == []
    if name == "SIGKILL":
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert err.splitlines()[-1] == "los-testbed: interrupted" and "Traceback" not in err


PEM = serialization.Encoding.PEM


class Authority:
    """Signs certificates and writes them to a folder, with their keys."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder, self._key = folder, ec.generate_private_key(ec.SECP256R1())
        self.file = self._write("ca", self._key, None)[0]

    def _write(self, name: str, key: ec.EllipticCurvePrivateKey, password: bytes | None) -> tuple[Path, Path]:
        subject, issuer = (
            x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"{self.folder.name} {of}")]) for of in (name, "ca")
        )
        now = datetime.datetime.now(tz=datetime.timezone.utc)
        built = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key.public_key())
        built = built.serial_number(x509.random_serial_number()).not_valid_before(now - datetime.timedelta(days=1))
        built = built.not_valid_after(now + datetime.timedelta(days=1))
        built = built.add_extension(x509.BasicConstraints(ca=name == "ca", path_length=None), critical=True)
        certificate, secret = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        certificate.write_bytes(built.sign(self._key, hashes.SHA256()).public_bytes(PEM))
        closed = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
        secret.write_bytes(key.private_bytes(PEM, serialization.PrivateFormat.PKCS8, closed))
        return certificate, secret

    def sign(self, name: str, password: bytes | None = None) -> tuple[Path, Path]:
        return self._write(name, ec.generate_private_key(ec.SECP256R1()), password)

    def options(self, trusted: Authority) -> list[str]:
        """Of a client with a certificate of this authority that trusts those of another one."""
        certificate, key = self.sign("me")
        return [f"--tls-ca-file={trusted.file}", f"--tls-cert={certificate}", f"--tls-key={key}"]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("tls") / "own")


@pytest.fixture(scope="module")
def address(own: Authority) -> Iterator[str]:
    """Of a scheduler with one worker, both with certificates of this authority."""
    import distributed

    certificate, key = map(str, own.sign("cluster"))
    roles = ("client", "scheduler", "worker")
    files = {**{f"tls_{role}_cert": certificate for role in roles}, **{f"tls_{role}_key": key for role in roles}}
    security = distributed.Security(require_encryption=True, tls_ca_file=str(own.file), **files)
    with distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None, security=security) as started:
        yield started.scheduler_address


def test_rows_of_a_scheduler_with_certificates_are_those_of_this_process(
    own: Authority, address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "c"
    options = [*OPTIONS[:-1], "--samples=3", f"--output={output}", "--json"]
    assert main([*options, f"--scheduler={address}", *own.options(own)]) == 0
    (_, members), *_ = Campaign.of(BASE, "uniform", 3, 1, "time", identity(BASE)).chunks()
    assert ResultFolder(output).table().to_pylist() == evaluate_chunk(portable(BASE, identity(BASE)), members, "time")
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["status"] == {"ok": 3}


def test_certificate_of_another_authority_is_refused_in_one_line(
    own: Authority, address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ways: the cluster does not know the client, or the client not the cluster."""
    monkeypatch.setattr("los_testbed.campaign.execution.CONNECT", 2.0)
    other = Authority(tmp_path / "other")
    message = f"scheduler must be the address of a running Dask scheduler, got {address}: "
    unknown = "it must trust the CA of --tls-cert"
    for authority, shown, reason in ((own, other, unknown), (other, own, "certificate verify failed")):
        files = shown.options(authority)
        line = refused(capsys, "campaign", f"--scheduler={address}", *files, f"--output={tmp_path / 'c'}")
        assert message in line and reason in line
    assert not (tmp_path / "c").exists()


def test_scheduler_with_certificates_is_not_reached_without(
    address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("los_testbed.campaign.execution.CONNECT", 2.0)
    line = refused(capsys, "campaign", f"--scheduler={address}")
    assert f"--tls-ca-file and --tls-cert must be given with {address}, got none" in line
    plain = address.replace("tls://", "tcp://")
    line = refused(capsys, "campaign", f"--scheduler={plain}")
    assert f"scheduler must be the address of a running Dask scheduler, got {plain}: " in line


def test_mistakes_in_the_options_are_one_line(
    own: Authority, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    certificate, key = own.sign("me")
    _, other_key = own.sign("other")
    closed, closed_key = own.sign("closed", b"word")
    text = tmp_path / "text"
    text.write_text("no certificate")
    there = "--scheduler=tls://127.0.0.1:9"
    files = {"ca-file": own.file, "cert": certificate, "key": key}
    both = "--tls-cert and --tls-key must be a certificate and its key as PEM, got"
    cases = [
        ("", files, "--scheduler must be tls://HOST:PORT with --tls-ca-file, got none"),
        ("--scheduler=tcp://h:1", files, "--scheduler must be tls://HOST:PORT with --tls-ca-file, got tcp://h:1"),
        (there, {"ca-file": own.file}, "--tls-cert must be given with --tls-ca-file, got none"),
        (there, {"key": key}, "--tls-ca-file must be given with --tls-key, got none"),
        (there, {**files, "ca-file": text}, f"--tls-ca-file must be a certificate as PEM, got {text}"),
        (there, {**files, "cert": text}, f"{both} {text}, {key}"),
        (there, {**files, "key": other_key}, f"{both} {certificate}, {other_key}"),
        (there, {"ca-file": own.file, "cert": certificate}, f"{both} {certificate}, no key"),
        (there, {**files, "cert": closed, "key": closed_key}, "--tls-key must be a key without a password"),
        (there, {**files, "key": tmp_path}, f"--tls-key must be a file that can be read, got {tmp_path}: Is a dir"),
        (there, {**files, "cert": tmp_path / "n"}, f"--tls-cert must be a file that can be read, got {tmp_path / 'n'}"),
    ]
    for scheduler, given, message in cases:
        options = [*filter(None, [scheduler]), *(f"--tls-{name}={path}" for name, path in given.items())]
        assert message in refused(capsys, "campaign", *options)


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

    output, log = tmp_path / "c", tmp_path / "log"
    command = [sys.executable, "-c", PROGRAM, *OPTIONS, f"--output={output}"]
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
