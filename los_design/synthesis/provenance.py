"""Which source a result was made with, and names of controllers by their content."""

from __future__ import annotations

import hashlib
import subprocess
from functools import cache
from pathlib import Path

import lftkit
import los_design
import los_loop
import titop_plant
from lftkit.proofs.trusted.digests import digest
from lftkit.systems.sampled.sampled_system import SampledSystem


@cache
def commit() -> str:
    """Commit of the source tree when it was first asked for, after which it is loaded; one with changes is marked."""
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


def law_digest(system: SampledSystem) -> str:
    """128 bits, as hexadecimal digits, that name all numbers of a controller which a law uses.

    Matrices and their shapes, the period, the ports, and of ``design_basis`` the mirror's sensitivity, by which the
    mirror law divides, and the authorities; the name of the telescope in it and the provenance do not count.
    """
    basis = {name: value for name, value in system.design_basis.items() if name != "parameters_hash"}
    ports = [[vars(port) for port in side] for side in (system.inputs, system.outputs)]
    numbers = {name: float(value).hex() for name, value in {"dt": system.dt, **basis}.items()}
    return digest([ports, numbers], {name: getattr(system, name) for name in "ABCD"})
