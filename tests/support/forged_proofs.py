"""Proofs of cells that somebody alters who makes the digest anew."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

from lftkit.proofs.trusted.cells import digest


def forged(content: Mapping[str, Any], change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """The content with a change, and with the digest of the changed content."""
    found = copy.deepcopy(dict(content))
    change(found)
    found["sha256"] = digest(found)
    return found
