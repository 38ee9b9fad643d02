"""Blocks of uncertainty, and scales of channels and blocks that bring rows and columns of a matrix in balance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.trusted.proof import COMPLEX, FULL, REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts
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


def balanced(M: ComplexArray, inner: int, sweeps: int = 8) -> FloatArray:
    """Diagonal scales of the channels, and one of the gain's block last, that bring rows and columns of M in balance.

    Osborne's iteration, with so many `sweeps`; the scales are s in ``s_i M_ij / s_j``.
    """
    squares = np.zeros((inner + 1, inner + 1))
    power = np.abs(M) ** 2
    squares[:inner, :inner] = power[:inner, :inner]
    squares[inner, :inner] = power[inner:, :inner].sum(axis=0)
    squares[:inner, inner] = power[:inner, inner:].sum(axis=1)
    np.fill_diagonal(squares, 0.0)
    scale = np.ones(inner + 1)
    floor = 1e-30 * float(squares.max(initial=0.0)) or 1.0
    for _ in range(sweeps):
        for i in range(inner + 1):
            row = float(scale[i] ** 2 * (squares[i] / scale**2).sum()) + floor
            column = float((squares[:, i] * scale**2).sum() / scale[i] ** 2) + floor
            scale[i] *= (column / row) ** 0.25
    return np.asarray(scale / scale[inner])


def balanced_matrix(M: ComplexArray, structure: Sequence[UncertaintyBlock]) -> tuple[ComplexArray, FloatArray]:
    """M with the norms of its blocks' rows and columns in balance, and the scale of each block."""
    blocks = list(parts(structure))
    sizes = np.array([[linalg.norm(M[z, w]) for _, _, w in blocks] for _, z, _ in blocks])
    scale = balanced(sizes, len(sizes) - 1)
    rows = np.concatenate([np.full(b.columns, s) for b, s in zip(structure, scale)])
    columns = np.concatenate([np.full(b.rows, s) for b, s in zip(structure, scale)])
    return np.asarray(M * rows[:, None] / columns), scale
