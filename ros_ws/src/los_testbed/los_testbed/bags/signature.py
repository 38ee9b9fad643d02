"""Ed25519 signature of a bag, stored beside its first file, over the digests at the ends of its files.

Of a bag with several files one signature binds all of them in their order, and ``metadata.yaml`` of its folder.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.input_limits import SECRET
from pointing_analysis.files.structured_text import load_json, read_text

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

FORMAT = "los-testbed bag signature 3"
SUFFIX = ".sig"


def signature_file(file: Path) -> Path:
    """Path of the signature of an MCAP file."""
    return file.with_name(file.name + SUFFIX)


def _text(file: Path, digests: Sequence[bytes], signature: bytes | None = None) -> bytes:
    """The signed bytes, or the content of the file with the signature of them.

    Parameters
    ----------
    file : the first file of the bag
    digests : of all files in their order, see :mod:`pointing_analysis.read.mcap.file_digest`
    signature : of the first; None for the bytes that are signed
    """
    beside = file.with_name("metadata.yaml")
    described = hashlib.sha256(beside.read_bytes()).hexdigest() if beside.is_file() else ""
    content = {"format": FORMAT, "files": [digest.hex() for digest in digests], "metadata.yaml": described}
    signed = {} if signature is None else {"signature": signature.hex()}
    return (json.dumps({**content, **signed}, indent=2) + "\n").encode()


def _pem(option: str, file: Path) -> bytes:
    try:
        return read_text(file, SECRET).encode()
    except (OSError, ValueError) as error:
        raise InputError(f"{option} must be a PEM file, got {file}: {error}") from None


def _check_installed() -> None:
    import importlib.util

    if importlib.util.find_spec("cryptography") is None:
        raise InputError("cryptography must be installed for signatures: pip install 'los-testbed[sign]'")


def private_key(option: str, file: Path) -> Ed25519PrivateKey:
    """Key to sign with.

    Raises
    ------
    ValueError
        No PEM file of an Ed25519 private key without password; `option` names it in the message.
    """
    _check_installed()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(_pem(option, file), None)
    except (ValueError, TypeError) as error:
        why = "one with a password" if isinstance(error, TypeError) else "no key that can be decoded"
        raise InputError(f"{option} must be an Ed25519 private key without password, got {file}: {why}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{option} must be an Ed25519 private key, got {file}: {type(key).__name__}")
    return key


def public_key(option: str, file: Path) -> Ed25519PublicKey:
    """Key to check a signature with; raises as `private_key`."""
    _check_installed()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(_pem(option, file))
    except ValueError:
        raise InputError(f"{option} must be an Ed25519 public key, got {file}: no key that can be decoded") from None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{option} must be an Ed25519 public key, got {file}: {type(key).__name__}")
    return key


def write_signature(file: Path, digests: Sequence[bytes], key: Ed25519PrivateKey) -> Path:
    """Sign the digests of the files of a bag, `file` the first of them; the signature's path."""
    target = signature_file(file)
    write_text(target, _text(file, digests, key.sign(_text(file, digests))).decode())
    return target


def is_signed_by(file: Path, digests: Sequence[bytes], key: Ed25519PublicKey) -> bool:
    """Whether the signature beside the first file is that of `key` for these digests, and nothing else is in it."""
    from cryptography.exceptions import InvalidSignature

    try:
        text = read_text(signature_file(file), SECRET)
        signature = bytes.fromhex(load_json(text, "signature")["signature"])
        key.verify(signature, _text(file, digests))
    except (OSError, ValueError, KeyError, TypeError, InvalidSignature):
        return False
    return text.encode() == _text(file, digests, signature)
