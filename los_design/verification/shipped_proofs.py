"""The proofs of the shipped pair, which lie beside this module, and their bundle.

They are stored small: a file is an `.npz` of ``los-testbed design certify`` in which the Hermitian scalings D and G in
single precision are halves, byte by byte as differences from node to node, compressed by LZMA. A bundle is made of them
with the shipped controllers and the reference telescope.
"""

from __future__ import annotations

import io
import lzma
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.errors import InputError
from lftkit.proofs.trusted.proof import ProofError
from los_design.synthesis.store import load_designs
from los_design.verification.bundle import write_bundle
from titop_plant.telescope.load import load_telescope

FOLDER = Path(__file__).with_name("proofs")
SUFFIX = ".npz.xz"
HALVES = " halves"
"""End of the name of an array that is stored as halves."""

Scalings = NDArray[np.complex64]


def whole(parts: NDArray[np.float32]) -> Scalings:
    """Hermitian matrices, shape (k, m, m), of their halves, shape (k, m^2).

    These are the upper triangles row by row: real parts, then imaginary parts without the diagonal.
    """
    m = round(np.sqrt(parts.shape[1]))
    rows, columns = np.triu_indices(m)
    above = rows < columns
    upper = parts[:, : len(rows)].astype(np.complex64)
    upper[:, above] += np.complex64(1j) * parts[:, len(rows) :]
    matrices = np.zeros((len(parts), m, m), np.complex64)
    matrices[:, columns, rows] = upper.conj()
    matrices[:, rows, columns] = upper
    return matrices


def unplaned(stored: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Numbers, shape (k, n), of the bytes of their words' differences from node to node, shape (4, n, k)."""
    words = np.ascontiguousarray(np.moveaxis(stored, 0, -1)).view(np.uint32)[..., 0]
    return np.ascontiguousarray(np.cumsum(words, axis=1, dtype=np.uint32).view(np.float32).T)


def unpack(stored: Path, target: Path) -> Path:
    """Write a stored proof as the file that ``los-testbed design certify`` writes; returns its path.

    Raises
    ------
    ProofError
        The file is damaged.
    """
    try:
        with np.load(io.BytesIO(lzma.decompress(stored.read_bytes())), allow_pickle=False) as archive:
            arrays: dict[str, Any] = {
                name.removesuffix(HALVES): whole(unplaned(archive[name])) if name.endswith(HALVES) else archive[name]
                for name in archive.files
            }
    except (lzma.LZMAError, zipfile.BadZipFile, EOFError, ValueError, IndexError) as error:
        raise ProofError(f"{stored.name} must be a stored proof, got {error}") from None
    with target.open("wb") as file:
        np.savez(file, **arrays)
    return target


def write_shipped_bundle(target: Path, folder: Path | None = None) -> None:
    """Put the proofs of the shipped pair into one bundle with its controllers and the reference telescope.

    Raises
    ------
    ValueError
        The folder has none.
    ProofError
        One is damaged.
    """
    place = folder or FOLDER
    stored = sorted(place.glob(f"*{SUFFIX}"))
    if not stored:
        raise InputError(f"proofs of the shipped controllers must be in {place}, got none")
    with tempfile.TemporaryDirectory() as unpacked:
        proofs = {}
        for file in stored:
            stage, _, figure = file.name.removesuffix(SUFFIX).rpartition("-")
            proofs[stage, figure] = unpack(file, Path(unpacked) / file.name.removesuffix(".xz"))
        write_bundle(target, load_telescope(), load_designs("implemented"), proofs)
