"""Ed25519 signature of a bag, stored beside its first file, over the digests that end the hash chains.

Of a bag with several files one signature binds all of them in their order.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.input_limits import SECRET
from pointing_analysis.files.structured_text import load_json, read_text
from pointing_analysis.read.mcap.chain import Chain

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

FORMAT, FORMAT_OF_SEVERAL = "los-testbed bag signature 1", "los-testbed bag signature 2"
SUFFIX = ".sig"


def signature_file(file: Path) -> Path:
    """Path of the signature of an MCAP file."""
    return file.with_name(file.name + SUFFIX)


def _content(chains: Sequence[Chain]) -> dict[str, Any]:
    """The signed bytes."""
    if len(chains) == 1:
        return {"format": FORMAT, **chains[0].seal()}
    return {"format": FORMAT_OF_SEVERAL, "files": [chain.seal() for chain in chains]}


def _statement(chains: Sequence[Chain]) -> bytes:
    return json.dumps(_content(chains), sort_keys=True).encode()


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


def write_signature(file: Path, chains: Sequence[Chain], key: Ed25519PrivateKey) -> Path:
    """Sign the digests that end the chains of the files of a bag, `file` the first of them; the signature's path."""
    target = signature_file(file)
    content = {**_content(chains), "signature": key.sign(_statement(chains)).hex()}
    write_text(target, json.dumps(content, indent=2) + "\n")
    return target


def is_signed_by(file: Path, chains: Sequence[Chain], key: Ed25519PublicKey) -> bool:
    """Whether the signature beside the first file is that of `key` for these chains."""
    from cryptography.exceptions import InvalidSignature

    try:
        content = load_json(read_text(signature_file(file), SECRET), "signature")
        key.verify(bytes.fromhex(content["signature"]), _statement(chains))
    except (OSError, ValueError, KeyError, TypeError, InvalidSignature):
        return False
    return True
