"""Controllers of fixed order side by side, and their responses.

A block is a state space ``D + C (v I - A)^-1 B`` between some of the measurements and some of the commands, with given
factors before and after it: sampling (the variable v of the bilinear map), input filters, holds, delays, fixed gains.
Its parameters are all entries of the gain matrix ``[[A, B], [C, D]]`` that are free.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lti.batched_linalg import solve
from robust_design.structures import gain_sizes

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
FrequencyFunction = Callable[[FloatArray], ComplexArray]


@dataclass(frozen=True)
class ControllerBlock:
    """One controller of a loop.

    Parameters
    ----------
    name : str
    order : int
    measurements, commands : slice
        Of the plant's samples.
    variable : callable
        From N frequencies [rad/s] to the variable v of the state space, shape (N,).
    before : callable
        Factors of the measurements, shape (N, measurements).
    after : callable
        Factor of all commands, shape (N,).
    free : ndarray of bool, shape (order + commands, order + measurements)
        Entries of the gain matrix that are tuned; the others stay.
    """

    name: str
    order: int
    measurements: slice
    commands: slice
    variable: FrequencyFunction
    before: FrequencyFunction
    after: FrequencyFunction
    free: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, int]:
        """Of the gain matrix."""
        rows, columns = self.commands.stop - self.commands.start, self.measurements.stop - self.measurements.start
        return self.order + rows, self.order + columns


def gain_matrices(blocks: Sequence[ControllerBlock], x: FloatArray) -> list[FloatArray]:
    """Gain matrices of all blocks from the vector of all their entries."""
    out: list[FloatArray] = []
    at = 0
    for block in blocks:
        size = block.shape[0] * block.shape[1]
        out.append(x[at : at + size].reshape(block.shape))
        at += size
    return out


def parameters_of(blocks: Sequence[ControllerBlock], matrices: Sequence[FloatArray]) -> FloatArray:
    """The vector of all entries from the gain matrices.

    Raises
    ------
    ValueError
        A matrix of another shape than its block's.
    """
    for block, matrix in zip(blocks, matrices, strict=True):
        if matrix.shape != block.shape:
            raise ValueError(f"gain matrix of {block.name} must have the shape {block.shape}, got {matrix.shape}")
    return np.concatenate([np.asarray(m, dtype=float).ravel() for m in matrices])


def entry_sizes(blocks: Sequence[ControllerBlock], x: FloatArray) -> FloatArray:
    """Size of each entry of all gain matrices (:func:`robust_design.structures.gain_sizes`); one where all are zero."""
    sizes = np.concatenate([gain_sizes(M, block.order).ravel() for block, M in zip(blocks, gain_matrices(blocks, x))])
    return np.asarray(np.where(np.isfinite(sizes), sizes, 1.0))


@dataclass(frozen=True)
class BlockResponse:
    """A block at N frequencies: ``dK = after left dM right before`` with the gain matrix M.

    Parameters
    ----------
    left : ndarray, complex, shape (N, commands, order + commands)
        ``after [C (v I - A)^-1, I]``.
    right : ndarray, complex, shape (N, order + measurements, measurements)
        ``[(v I - A)^-1 B; I] before``.
    K : ndarray, complex, shape (N, commands, measurements)
    """

    left: ComplexArray
    right: ComplexArray
    K: ComplexArray


@dataclass(frozen=True)
class ControllerResponse:
    """All blocks of a loop at N frequencies."""

    blocks: tuple[ControllerBlock, ...]
    parts: tuple[BlockResponse, ...]
    measurements: int
    commands: int

    @classmethod
    def of(
        cls,
        blocks: Sequence[ControllerBlock],
        x: FloatArray,
        omega: FloatArray,
        measurements: int,
        commands: int,
    ) -> ControllerResponse:
        """Evaluate all blocks."""
        parts = []
        for block, M in zip(blocks, gain_matrices(blocks, x)):
            n = block.order
            v = block.variable(omega)
            shifted = v[:, None, None] * np.eye(n) - M[:n, :n]
            # one solution gives (v I - A)^-1 [B, I]
            given = np.broadcast_to(np.hstack([M[:n, n:], np.eye(n)]), (len(omega), n, M.shape[1])).astype(complex)
            solved = solve(shifted.astype(complex), given) if n else given
            states, inverse = solved[:, :, : M.shape[1] - n], solved[:, :, M.shape[1] - n :]
            before, after = block.before(omega), block.after(omega)[:, None, None]
            eye_y, eye_u = np.eye(M.shape[1] - n), np.eye(M.shape[0] - n)
            right = np.concatenate([states, np.broadcast_to(eye_y, (len(omega), *eye_y.shape))], axis=1)
            left = np.concatenate([M[n:, :n] @ inverse, np.broadcast_to(eye_u, (len(omega), *eye_u.shape))], axis=2)
            right, left = right * before[:, None, :], left * after
            K = after * (M[n:, n:] + M[n:, :n] @ states) * before[:, None, :]
            parts.append(BlockResponse(left, right, K))
        return cls(tuple(blocks), tuple(parts), measurements, commands)

    def matrix(self, active: Sequence[int], index: NDArray[np.intp]) -> ComplexArray:
        """Commands by measurements at the frequencies `index`: (len(index), commands, measurements)."""
        K = np.zeros((len(index), self.commands, self.measurements), complex)
        for b in active:
            block = self.blocks[b]
            K[:, block.commands, block.measurements] += self.parts[b].K[index]
        return K
