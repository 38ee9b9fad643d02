"""Proofs of cells that somebody alters who makes the digest anew, and files that unpack to far more than their size."""

from __future__ import annotations

import copy
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lftkit.proofs.trusted.cells import digest


def forged(content: Mapping[str, Any], change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """The content with a change, and with the digest of the changed content."""
    found = copy.deepcopy(dict(content))
    change(found)
    found["sha256"] = digest(found)
    return found


def zip_of_zeros(path: Path, member: str, megabytes: int) -> Path:
    """A compressed file with one member of this many zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(member, "w") as stream:
        for _ in range(megabytes):
            stream.write(bytes(1_000_000))
    return path
