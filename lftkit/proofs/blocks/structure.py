"""Blocks of uncertainty, by what they are."""

from __future__ import annotations

from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock
from lftkit.systems.arguments import checked


@checked
def real_block(repeated: int = 1) -> UncertaintyBlock:
    """A real scalar, `repeated` times."""
    return UncertaintyBlock(REAL, repeated, repeated)


@checked
def complex_block(repeated: int = 1) -> UncertaintyBlock:
    """A complex scalar, `repeated` times."""
    return UncertaintyBlock(COMPLEX, repeated, repeated)


@checked
def full_block(rows: int, columns: int | None = None) -> UncertaintyBlock:
    """A complex matrix, `rows` x `columns`, square by default."""
    return UncertaintyBlock(FULL, rows, rows if columns is None else columns)
