"""A scheduler of the user's own that asks for certificates: let in, refused, and mistakes in one line."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.execution import evaluate_chunk
from los_testbed.campaign.portable import portable
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.run.identity import identity
from support.command_line import refused

pytest.importorskip("cryptography")

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

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

    def options(self, name: str) -> list[str]:
        certificate, key = self.sign(name)
        return [f"--tls-ca-file={self.file}", f"--tls-cert={certificate}", f"--tls-key={key}"]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("tls") / "own")


@pytest.fixture(scope="module")
def address(own: Authority) -> Iterator[str]:
    """Of a scheduler with one worker, both with certificates of this authority."""
    distributed = pytest.importorskip("distributed")
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
    options = [
        "--samples=3",
        "--duration=1.1",
        "--loop=isolator",
        "--scenario=imbalance",
        f"--output={output}",
        "--json",
    ]
    assert main(["campaign", *options, f"--scheduler={address}", *own.options("me")]) == 0
    base = RunConfig(mode="inprocess", duration=1.1, loop="isolator", scenario="imbalance")
    here = Campaign.of(base, "uniform", 3, 1, "time", identity(base))
    (_, members), *_ = here.chunks()
    assert ResultFolder(output).table().to_pylist() == evaluate_chunk(portable(base, identity(base)), members, "time")
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
        certificate, key = shown.sign("me")
        files = [f"--tls-ca-file={authority.file}", f"--tls-cert={certificate}", f"--tls-key={key}"]
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
