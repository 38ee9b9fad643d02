"""Controllers of fixed order side by side, and their responses.

A block is a state space ``D + C (v I - A)^-1 B`` between some of the measurements and some of the commands, with given
factors before and after it: sampling (the variable v of the bilinear map), input filters, holds, delays, fixed gains.
Its parameters are all entries of the gain matrix ``[[A, B], [C, D]]`` that are free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.analysis.batched_linalg import solve
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.tuning.structures.structures import gain_sizes

FrequencyFunction = Callable[[FloatArray], ComplexArray]


@dataclass(frozen=True)
class ControllerBlock:
    """One controller of a loop.

    Parameters
    ----------
    name : str
    order : int
    measurements : slice or ndarray of int
        Of the plant's samples.
    commands : slice
        The same.
    variable : callable
        From N frequencies [rad/s] to the variable v of the state space, shape (N,).
    before : callable
        Factors of the measurements, shape (N, measurements).
    after : callable
        Factor of all commands, shape (N,).
    free : ndarray of bool, shape (order + commands, order + measurements)
        Entries of the gain matrix that are tuned; the others stay.
    least_decay : float, optional
        Every pole of A has a real part of at most minus this; default: A is as the descent makes it.
    """

    name: str
    order: int
    measurements: slice | IntArray
    commands: slice
    variable: FrequencyFunction
    before: FrequencyFunction
    after: FrequencyFunction
    free: BoolArray
    least_decay: float | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Of the gain matrix."""
        places = self.measurements
        columns = places.stop - places.start if isinstance(places, slice) else len(places)
        return self.order + self.commands.stop - self.commands.start, self.order + columns


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
            raise InputError(f"gain matrix of {block.name} must have the shape {block.shape}, got {matrix.shape}")
    return np.concatenate([np.asarray(m, dtype=float).ravel() for m in matrices])


def with_least_decay(blocks: Sequence[ControllerBlock], x: FloatArray) -> FloatArray:
    """The entries with the poles of each block that decay too slowly moved to its least decay; else `x` itself.

    Poles are moved along the real axis, eigenvectors stay. Responses hardly feel a slow pole, so that a descent may
    carry it across the imaginary axis; moved back it costs nothing visible.
    """
    moved = x
    for k, (block, M) in enumerate(zip(blocks, gain_matrices(blocks, x))):
        n = block.order
        if block.least_decay is None or n == 0 or not block.free[:n, :n].all():
            continue
        poles, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(M[:n, :n]))
        if poles.real.max() <= -block.least_decay:
            continue
        if moved is x:
            moved = x.copy()
        A = gain_matrices(blocks, moved)[k][:n, :n]
        sizes = linalg.svdvals(vectors)
        if sizes[0] < 1e8 * sizes[-1]:
            decaying = np.minimum(poles.real, -block.least_decay) + 1j * poles.imag
            A[:] = ((vectors * decaying) @ linalg.inv(vectors)).real
        else:  # nearly a Jordan block: all poles alike
            A -= (poles.real.max() + block.least_decay) * np.eye(n)
    return moved


def entry_sizes(blocks: Sequence[ControllerBlock], x: FloatArray) -> FloatArray:
    """Size of each entry of all gain matrices, as :func:`gain_sizes`; one where all are zero."""
    sizes = np.concatenate([gain_sizes(M, block.order).ravel() for block, M in zip(blocks, gain_matrices(blocks, x))])
    return np.asarray(np.where(np.isfinite(sizes), sizes, 1.0))


@dataclass(frozen=True)
class BlockFactors:
    """What a block has at N frequencies whatever its gain matrix is: variable, factors before and after it."""

    variable: ComplexArray
    before: ComplexArray
    after: ComplexArray

    @classmethod
    def of(cls, block: ControllerBlock, omega: FloatArray) -> BlockFactors:
        """At frequencies [rad/s]."""
        return cls(block.variable(omega), block.before(omega), block.after(omega))

    def chosen(self, index: IntArray) -> BlockFactors:
        """Those at some of the frequencies."""
        return BlockFactors(self.variable[index], self.before[index], self.after[index])


class BlockResponse:
    """A block at N frequencies: ``dK = left dM right`` with the gain matrix M.

    Parameters
    ----------
    M : ndarray, shape (order + commands, order + measurements)
    order : int
    factors : BlockFactors
    """

    def __init__(self, M: FloatArray, order: int, factors: BlockFactors) -> None:
        self._M, self._n, self._factors = M, order, factors
        shifted = factors.variable[:, None, None] * np.eye(order) - M[:order, :order]
        identity = np.broadcast_to(np.eye(order), (len(shifted), order, order)).astype(complex)
        self._inverse = solve(shifted.astype(complex), identity) if order else identity

    @cached_property
    def _observed(self) -> ComplexArray:
        """``C (v I - A)^-1``."""
        return np.asarray(self._M[self._n :, : self._n] @ self._inverse)

    @cached_property
    def K(self) -> ComplexArray:
        """Response, shape (N, commands, measurements)."""
        n, factors = self._n, self._factors
        inner = self._M[n:, n:] + self._observed @ self._M[:n, n:]
        return np.asarray(factors.after[:, None, None] * inner * factors.before[:, None, :])

    @cached_property
    def left(self) -> ComplexArray:
        """``after [C (v I - A)^-1, I]``, shape (N, commands, order + commands)."""
        eye = np.eye(len(self._M) - self._n)
        both = np.concatenate([self._observed, np.broadcast_to(eye, (len(self._inverse), *eye.shape))], axis=2)
        return np.asarray(both * self._factors.after[:, None, None])

    @cached_property
    def right(self) -> ComplexArray:
        """``[(v I - A)^-1 B; I] before``, shape (N, order + measurements, measurements)."""
        n, eye = self._n, np.eye(self._M.shape[1] - self._n)
        states = self._inverse @ self._M[:n, n:]
        both = np.concatenate([states, np.broadcast_to(eye, (len(states), *eye.shape))], axis=1)
        return np.asarray(both * self._factors.before[:, None, :])


class ControllerResponse:
    """All blocks of a loop at N frequencies.

    Parameters
    ----------
    blocks : sequence of ControllerBlock
    x : ndarray
        Entries of all gain matrices.
    factors : sequence of BlockFactors
        Of each block.
    measurements : int
        Of the plant.
    """

    def __init__(
        self, blocks: Sequence[ControllerBlock], x: FloatArray, factors: Sequence[BlockFactors], measurements: int
    ) -> None:
        self.blocks, self.measurements = tuple(blocks), measurements
        self.parts = tuple(
            BlockResponse(M, block.order, of_block)
            for block, M, of_block in zip(blocks, gain_matrices(blocks, x), factors)
        )

    def compute(self, active: Iterable[int]) -> None:
        """Compute the responses of these blocks now, for threads that share this object."""
        for b in active:
            _ = self.parts[b].K

    def matrix(self, active: Sequence[int], index: IntArray) -> ComplexArray:
        """Commands of the active blocks, one after the other, by measurements: (len(index), commands, measurements)."""
        rows = active_commands(self.blocks, active)
        K = np.zeros((len(index), len(rows.commands), self.measurements), complex)
        for b in active:
            K[:, rows.of_block[b], self.blocks[b].measurements] = self.parts[b].K[index]
        return K


@dataclass(frozen=True)
class ActiveCommands:
    """Commands of the blocks of a loop.

    Parameters
    ----------
    commands : ndarray of int
        Numbers of the plant's commands, one block after the other.
    of_block : dict of int to slice
        Places of a block's commands among them.
    """

    commands: IntArray
    of_block: dict[int, slice]

    @property
    def index(self) -> slice | IntArray:
        """Of the plant's commands: a slice if they follow each other, so that arrays are not copied."""
        return _slice_if_consecutive(self.commands)

    def rows(self, active: Sequence[int]) -> slice | IntArray:
        """Places of the commands of some of the blocks, one block after the other."""
        return _slice_if_consecutive(
            np.concatenate([np.arange(self.of_block[b].start, self.of_block[b].stop) for b in active])
        )

    def positions(self, commands: slice) -> slice | IntArray:
        """Places of some commands of the plant among those of the loop.

        Raises
        ------
        ValueError
            Another command than those of the loop.
        """
        asked = np.arange(commands.start, commands.stop)
        table = {int(command): position for position, command in enumerate(self.commands)}
        if missing := [int(k) for k in asked if int(k) not in table]:
            raise InputError(f"commands must be of the blocks that are active, got {missing}")
        return _slice_if_consecutive(np.array([table[int(k)] for k in asked], dtype=np.intp))


def _slice_if_consecutive(index: IntArray) -> slice | IntArray:
    first, count = int(index[0]), len(index)
    return slice(first, first + count) if np.array_equal(index, np.arange(first, first + count)) else index


def active_commands(blocks: Sequence[ControllerBlock], active: Sequence[int]) -> ActiveCommands:
    """The commands of some blocks."""
    numbers, of_block, at = [], {}, 0
    for b in active:
        rows_of_block = np.arange(blocks[b].commands.start, blocks[b].commands.stop)
        numbers.append(rows_of_block)
        of_block[b] = slice(at, at + len(rows_of_block))
        at += len(rows_of_block)
    return ActiveCommands(np.concatenate(numbers), of_block)
