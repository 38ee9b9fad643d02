"""Block structures of the structured singular value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray

REAL, COMPLEX, FULL = "real", "complex", "full"


@dataclass(frozen=True)
class UncertaintyBlock:
    """One block of ``Delta``, with ``w = Delta z`` and ``z = M w``.

    Parameters
    ----------
    kind : str
        ``real`` or ``complex`` (a scalar times the identity) or ``full`` (any complex matrix).
    rows, columns : int
        Sizes of w and z; equal for a scalar.

    Raises
    ------
    ValueError
        Another kind, a size below 1, a scalar that is not square.
    """

    kind: str
    rows: int
    columns: int

    def __post_init__(self) -> None:
        if self.kind not in (REAL, COMPLEX, FULL):
            raise ValueError(f"kind must be real, complex or full, got {self.kind!r}")
        if min(self.rows, self.columns) < 1 or (self.kind != FULL and self.rows != self.columns):
            raise ValueError(
                f"a block must have sizes of 1 at least, equal for a scalar, got {self.rows} x {self.columns}"
            )

    @property
    def scalar(self) -> bool:
        """Whether it has one uncertain number: a full block of 1 x 1 is a complex scalar."""
        return self.kind != FULL or self.rows == self.columns == 1


def real_block(repeated: int = 1) -> UncertaintyBlock:
    """A real scalar, `repeated` times."""
    return UncertaintyBlock(REAL, repeated, repeated)


def complex_block(repeated: int = 1) -> UncertaintyBlock:
    """A complex scalar, `repeated` times."""
    return UncertaintyBlock(COMPLEX, repeated, repeated)


def full_block(rows: int, columns: int | None = None) -> UncertaintyBlock:
    """A complex matrix, `rows` x `columns`, square by default."""
    return UncertaintyBlock(FULL, rows, rows if columns is None else columns)


def parts(structure: Sequence[UncertaintyBlock]) -> Iterator[tuple[UncertaintyBlock, slice, slice]]:
    """Each block with the rows of M (its z) and the columns of M (its w)."""
    z = w = 0
    for block in structure:
        yield block, slice(z, z + block.columns), slice(w, w + block.rows)
        z, w = z + block.columns, w + block.rows


def checked_matrix(M: ComplexArray, structure: Sequence[UncertaintyBlock]) -> ComplexArray:
    """M as a complex matrix.

    Raises
    ------
    ValueError
        No blocks, entries that are not finite, a shape that does not fit the blocks.
    """
    matrix = np.asarray(M, dtype=complex)
    shape = sum(b.columns for b in structure), sum(b.rows for b in structure)
    if not structure or matrix.shape != shape:
        raise ValueError(f"M must have the shape {shape} of its blocks, got {matrix.shape}")
    if not np.all(np.isfinite(matrix)):
        raise ValueError("M must be finite, got entries that are not")
    return matrix
