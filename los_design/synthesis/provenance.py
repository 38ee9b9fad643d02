"""Which source a result was made with, and names of controllers by their content."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import numpy as np

import lftkit
import los_design
import los_loop
import titop_plant
from lftkit.systems.sampled.sampled_system import SampledSystem


def commit() -> str:
    """Commit of the source tree; a tree with changes is marked."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return result.stdout.strip()


def source_digest() -> str:
    """SHA-256 of the source files that designs and their verification are computed with, changed ones as they are."""
    total = hashlib.sha256()
    for package in (lftkit, titop_plant, los_loop, los_design):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            total.update(path.read_bytes())
    return total.hexdigest()


def digest(system: SampledSystem) -> str:
    """Twelve hexadecimal digits that name the matrices of a controller."""
    content = b"".join(np.ascontiguousarray(getattr(system, key)).tobytes() for key in "ABCD")
    return hashlib.sha256(content).hexdigest()[:12]
