"""Which source a result was made with."""

from __future__ import annotations

import subprocess
from pathlib import Path


def commit() -> str:
    """Commit of the source tree; a tree with changes is marked."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return result.stdout.strip()
