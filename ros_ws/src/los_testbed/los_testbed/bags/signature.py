"""Ed25519 signature of a bag, beside its file: who holds the key vouches for the digest at the end of the chain."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from pointing_analysis.files.atomic_output import write_text
from pointing_analysis.files.structured_text import read_text
from pointing_analysis.read.mcap.chain import Chain

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

FORMAT = "los-testbed bag signature 1"
SUFFIX = ".sig"


def signature_file(file: Path) -> Path:
    """Where the signature of an MCAP file is."""
    return file.with_name(file.name + SUFFIX)


def _statement(chain: Chain) -> bytes:
    """What is signed."""
    return json.dumps({"format": FORMAT, **chain.seal()}, sort_keys=True).encode()


def _pem(option: str, file: Path) -> bytes:
    try:
        return read_text(file).encode()
    except (OSError, ValueError) as error:
        raise ValueError(f"{option} must be a PEM file, got {file}: {error}") from None


def _check_installed() -> None:
    import importlib.util

    if importlib.util.find_spec("cryptography") is None:
        raise ValueError("cryptography must be installed for signatures: pip install 'los-testbed[sign]'")


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
        raise ValueError(f"{option} must be an Ed25519 private key without password, got {file}: {error}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise ValueError(f"{option} must be an Ed25519 private key, got {file}: {type(key).__name__}")
    return key


def public_key(option: str, file: Path) -> Ed25519PublicKey:
    """Key to check a signature with; raises as `private_key`."""
    _check_installed()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(_pem(option, file))
    except ValueError as error:
        raise ValueError(f"{option} must be an Ed25519 public key, got {file}: {error}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ValueError(f"{option} must be an Ed25519 public key, got {file}: {type(key).__name__}")
    return key


def write_signature(file: Path, chain: Chain, key: Ed25519PrivateKey) -> Path:
    """Sign the digest at the end of the chain of `file`; the path of the signature."""
    target = signature_file(file)
    content = {"format": FORMAT, **chain.seal(), "signature": key.sign(_statement(chain)).hex()}
    write_text(target, json.dumps(content, indent=2) + "\n")
    return target


def is_signed_by(file: Path, chain: Chain, key: Ed25519PublicKey) -> bool:
    """Whether the signature beside `file` is that of `key` for this chain."""
    from cryptography.exceptions import InvalidSignature

    try:
        content = json.loads(read_text(signature_file(file)))
        key.verify(bytes.fromhex(content["signature"]), _statement(chain))
    except (OSError, ValueError, KeyError, TypeError, InvalidSignature):
        return False
    return True
