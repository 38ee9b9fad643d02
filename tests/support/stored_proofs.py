"""Store proofs of the shipped pair as ``los_design/verification/shipped_proofs.py`` reads them, rounded and compressed.

Any scalings that pass the check prove the level. So each strip keeps the fewest bits of its scalings with which the
checker still accepts it; loop, claim and nodes are kept as they are. The file of the fast tones with both stages holds
all bits of the proof that the command wrote: its 506 strips take an hour. To store proofs anew::

    los-testbed design certify --output FOLDER
    .venv/bin/python tests/support/stored_proofs.py FOLDER

What they prove (``los_design/verification/statements.json``)::

    los-testbed design check-proof --json
"""

from __future__ import annotations

import io
import lzma
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import ComplexArray
from lftkit.proofs.sampled_loop import LoopProof
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof, write_loop_proof
from lftkit.proofs.trusted.proof import Strip
from lftkit.proofs.trusted.strips import check_strip
from los_design.verification.noise_certificate import NOISE
from los_design.verification.shipped_proofs import FOLDER, HALVES, SUFFIX, Scalings

BITS = (7, 9, 11, 13, 16, 23)
"""Bits of the fraction that are tried, fewest first; single precision has 23."""


def rounded(values: NDArray[Any], bits: int) -> NDArray[np.float32]:
    """Single precision with this many bits of the fraction, to nearest."""
    dropped = np.uint32(23 - bits)
    words = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    half = np.uint32((1 << int(dropped)) >> 1)
    return np.asarray((((words + half) >> dropped) << dropped).view(np.float32))


def rounded_matrices(matrices: NDArray[Any], bits: int) -> ComplexArray:
    """Real and imaginary parts :func:`rounded`: Hermitian matrices stay so."""
    return np.asarray(rounded(matrices.real, bits) + 1j * rounded(matrices.imag, bits), dtype=complex)


def rounded_strip(proof: LoopProof, strip: Strip) -> tuple[Strip, int]:
    """The strip with the fewest bits that the checker accepts, and how many."""
    for bits in BITS:
        coarse = replace(
            strip,
            D=tuple(rounded_matrices(matrices, bits) for matrices in strip.D),
            G=tuple(rounded_matrices(matrices, bits) for matrices in strip.G),
        )
        if isinstance(check_strip((proof.model, coarse, proof.level)), int):
            return coarse, bits
    raise ValueError("a strip must be accepted with all its bits, got one that is refused")


def halves(matrices: Scalings) -> NDArray[np.float32]:
    """Upper triangles of Hermitian matrices, shape (k, m, m): real parts, then imaginary parts, shape (k, m^2)."""
    rows, columns = np.triu_indices(matrices.shape[1])
    above = rows < columns
    return np.hstack([matrices.real[:, rows, columns], matrices.imag[:, rows[above], columns[above]]])


def planes(parts: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Differences of the words from node to node, one plane for each byte: what a compressor finds."""
    words = np.ascontiguousarray(parts.T).view(np.uint32)
    words = np.hstack([words[:, :1], words[:, 1:] - words[:, :-1]])
    return np.ascontiguousarray(np.moveaxis(words.view(np.uint8).reshape(*words.shape, 4), -1, 0))


def is_scaling(name: str, array: NDArray[Any]) -> bool:
    """Whether an array of a proof's file holds D or G of a parameter in single precision."""
    return name[0] in "DG" and name[1:].isdecimal() and array.dtype == np.complex64


def pack(source: Path, target: Path) -> Iterator[int]:
    """Store a proof; yields the bits of each strip."""
    coarse_file, bits = target.with_suffix(".tmp"), list[int]()

    def rounded_strips(proof: LoopProof) -> tuple[Strip, ...]:
        found = [rounded_strip(proof, strip) for strip in proof.strips]
        bits.extend(own for _, own in found)
        return tuple(strip for strip, _ in found)

    if source.stem.endswith(f"-{NOISE}"):
        noise = read_noise_proof(source)
        parts = [replace(part, strips=rounded_strips(noise.of_part(part))) for part in noise.parts]
        write_loop_proof(replace(noise, parts=tuple(parts)), coarse_file)
    else:
        proof = read_loop_proof(source)
        write_loop_proof(replace(proof, strips=rounded_strips(proof)), coarse_file)
    yield from bits
    plain = io.BytesIO()
    with np.load(coarse_file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    coarse_file.unlink()
    np.savez(
        plain,
        **{
            f"{name}{HALVES}" if is_scaling(name, array) else name: planes(halves(array))
            if is_scaling(name, array)
            else array
            for name, array in arrays.items()
        },
    )
    target.write_bytes(lzma.compress(plain.getvalue(), preset=9))


def main(folder: Path) -> None:
    """Store the proofs of a folder as those of the shipped pair."""
    for source in sorted(folder.glob("*.npz")):
        target = FOLDER / f"{source.stem}{SUFFIX}"
        bits = list(pack(source, target))
        counts = {b: bits.count(b) for b in BITS if b in bits}
        sizes = f"{source.stat().st_size} bytes -> {target.stat().st_size}"
        sys.stdout.write(f"{source.name}: {sizes}; strips by bits: {counts}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
