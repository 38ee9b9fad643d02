"""Which source a result was made with, and names of controllers by their content."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import numpy as np

from lftkit.systems.sampled.sampled_system import SampledSystem


def commit() -> str:
    """Commit of the source tree; a tree with changes is marked."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return result.stdout.strip()


def digest(system: SampledSystem) -> str:
    """Twelve hexadecimal digits that name the matrices of a controller."""
    content = b"".join(np.ascontiguousarray(getattr(system, key)).tobytes() for key in "ABCD")
    return hashlib.sha256(content).hexdigest()[:12]
