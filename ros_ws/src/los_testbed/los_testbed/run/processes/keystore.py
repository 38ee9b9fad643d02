"""Keys, certificates and signed permissions for the nodes of a run, in the folders that SROS 2 expects.

FOLDER/public/ca.cert.pem, identity_ca.cert.pem, permissions_ca.cert.pem      one authority for both
FOLDER/private/ca.key.pem ...                                                 its key
FOLDER/enclaves/governance.xml, governance.p7s                                rules of the domain, signed
FOLDER/enclaves/NAMESPACE/NODE/cert.pem, key.pem, permissions.xml, .p7s       one for each node
"""

from __future__ import annotations

import importlib.util
import os
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_folder
from los_testbed.run.processes.enclaves import ENCLAVES, enclave_path, governance, permissions

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate

AUTHORITIES = ("identity_ca", "permissions_ca")
AUTHORITY_NAME = "los-testbed CA"
MAX_NAME = 64
"""Characters of the name in a certificate (X.520)."""
EARLIER = timedelta(days=1)
"""Certificates are valid from this long ago, for hosts whose clocks differ."""

Identity = tuple["EllipticCurvePrivateKey", "Certificate"]


def write_keystore(folder: Path, namespace: str, domain: int | None, days: int) -> list[str]:
    """Write keys for all nodes of a run; the enclaves.

    Parameters
    ----------
    folder : a new folder; only its owner can enter it
    namespace : of the run
    domain : ROS domain for which they are valid; None for all
    days : validity

    Raises
    ------
    ValueError
        The folder exists, a name is too long for a certificate, or cryptography is not installed.
    """
    if importlib.util.find_spec("cryptography") is None:
        raise InputError("cryptography must be installed for keys: pip install 'los-testbed[sign]'")
    names = {name: enclave_path(name, namespace) for name in ENCLAVES}
    longest = max(names.values(), key=len)
    if len(longest) > MAX_NAME:
        raise InputError(f"--namespace must give enclaves of at most {MAX_NAME} characters, got {longest}")
    now = datetime.now(timezone.utc).replace(microsecond=0, tzinfo=None)
    validity = now - EARLIER, now + timedelta(days=days)
    with atomic_folder(folder) as made:
        made.mkdir(mode=0o700)
        public, private, enclaves = (made / name for name in ("public", "private", "enclaves"))
        for part in (public, private, enclaves):
            part.mkdir()
        authority = new_identity(AUTHORITY_NAME, validity, None)
        _write_identity(authority, public / "ca.cert.pem", private / "ca.key.pem")
        for name in AUTHORITIES:
            (public / f"{name}.cert.pem").symlink_to("ca.cert.pem")
            (private / f"{name}.key.pem").symlink_to("ca.key.pem")
        _write_signed(authority, enclaves / "governance", governance(domain))
        for name, enclave in names.items():
            place = enclaves / enclave.lstrip("/")
            place.mkdir(parents=True)
            _write_identity(new_identity(enclave, validity, authority), place / "cert.pem", place / "key.pem")
            _write_signed(authority, place / "permissions", permissions(name, namespace, domain, *validity))
            for ca in AUTHORITIES:
                (place / f"{ca}.cert.pem").symlink_to(os.path.relpath(public / f"{ca}.cert.pem", place))
            (place / "governance.p7s").symlink_to(os.path.relpath(enclaves / "governance.p7s", place))
    return list(names.values())


def new_identity(name: str, validity: tuple[datetime, datetime], authority: Identity | None) -> Identity:
    """Key and certificate of this name; of an authority itself where none is given.

    DDS security asks for the curve prime256v1.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    alone = authority is None
    certificate = (
        x509.CertificateBuilder()
        .issuer_name(subject if authority is None else authority[1].subject)
        .subject_name(subject)
        .serial_number(x509.random_serial_number())
        .not_valid_before(validity[0])
        .not_valid_after(validity[1])
        .public_key(key.public_key())
        .add_extension(x509.BasicConstraints(ca=alone, path_length=1 if alone else None), critical=alone)
        .sign(key if authority is None else authority[0], hashes.SHA256())
    )
    return key, certificate


def _write_identity(identity: Identity, certificate: Path, key: Path) -> None:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    certificate.write_bytes(identity[1].public_bytes(Encoding.PEM))
    content = identity[0].private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with open(os.open(key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
        stream.write(content)


def _write_signed(authority: Identity, stem: Path, text: str) -> None:
    """The document, and beside it the same signed as an S/MIME message with a signature apart from the text."""
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.serialization import Encoding, pkcs7

    stem.with_suffix(".xml").write_text(text, "utf-8")
    builder = (
        pkcs7.PKCS7SignatureBuilder().set_data(text.encode()).add_signer(authority[1], authority[0], hashes.SHA256())
    )
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    stem.with_suffix(".p7s").write_bytes(builder.sign(Encoding.SMIME, options))
