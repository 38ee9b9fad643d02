"""Frequency responses of linear fractional transformations (LFT), closed over Delta, and with a controller.

The response of a system whose first inputs and outputs are the channels of Delta is

    [z]   [M    T21] [w]
    [e] = [T12  T11] [d],    w = Delta z,

and closed with Delta it is the upper LFT (Zhou, Doyle and Glover, Robust and Optimal Control, 1996, chapter 10)

    F_u(Delta) = T11 + T12 Delta (I - M Delta)^-1 T21.

Delta is diagonal (:meth:`LftResponse.closed`) or a real matrix that is the same at all frequencies
(:meth:`LftResponse.closed_with_matrix`). Channels that share one entry, those of a repeated parameter, are closed with
many values at once: with the eigenvalues and eigenvectors of their matrix an LFT is a sum of terms
``delta / (1 - delta pole) residue``, so that many values are one product of matrices, and what is left to be solved has
the order of the other channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import linalg

from lftkit.analysis.batched_linalg import singular_triples, solve
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class LftResponse:
    """Response of an LFT at one frequency, or at N frequencies with N as the first axis of all arrays.

    Parameters
    ----------
    M : ndarray, complex, shape ([N,] q, q)
        From the outputs of Delta to its inputs.
    T12 : ndarray, complex, shape ([N,] p, q)
        From the outputs of Delta to the outputs.
    T21 : ndarray, complex, shape ([N,] q, m)
        From the inputs to the inputs of Delta.
    T11 : ndarray, complex, shape ([N,] p, m)
        From the inputs to the outputs.
    """

    M: ComplexArray
    T12: ComplexArray
    T21: ComplexArray
    T11: ComplexArray

    @classmethod
    def of(cls, matrix: ComplexArray, channels: int) -> LftResponse:
        """Response of a matrix ([N,] q + p, q + m) whose first `channels` = q rows and columns are those of Delta."""
        q = channels
        return cls(matrix[..., :q, :q], matrix[..., q:, :q], matrix[..., :q, q:], matrix[..., q:, q:])

    def part(self, rows: slice, columns: slice) -> LftResponse:
        """From some of the inputs to some of the outputs."""
        return LftResponse(self.M, self.T12[..., rows, :], self.T21[..., columns], self.T11[..., rows, columns])

    def __getitem__(self, index: int | slice | IntArray) -> LftResponse:
        """At some of the frequencies."""
        return LftResponse(self.M[index], self.T12[index], self.T21[index], self.T11[index])

    def closed(
        self,
        delta: ComplexArray,
        repeated: BoolArray | None = None,
        *,
        many: int = 40,
        condition: float = 1e9,
        together: int = 80,
    ) -> ComplexArray:
        """``F_u(diag(delta))`` for N diagonals of Delta.

        Parameters
        ----------
        delta : ndarray, complex, shape (N, q)
            Values of Delta at the one frequency of the LFT, or one value for each of its N frequencies.
        repeated : ndarray of bool, shape (q,), optional
            Channels that have the same entry as each other in every diagonal. From `many` diagonals on, at one
            frequency, they are closed for all of them at once; where their matrix has no basis of eigenvectors they
            are not.
        many : int
            Diagonals from which on the eigenvectors of these channels take less time than they save.
        condition : float
            Condition number (1-norm) of the eigenvectors up to which they are used.
        together : int
            Diagonals whose matrices are in the cache at once.

        Returns
        -------
        ndarray, complex, shape (N, p, m)

        Raises
        ------
        LinAlgError
            A loop that is singular.
        """
        if repeated is not None and repeated.any() and self.M.ndim == 2 and len(delta) >= many:
            form = RepeatedClosed.of(self, repeated, condition)
            if form is not None:
                return form.closed(delta, together)
        response: ComplexArray = self.through(delta) @ self.T21
        response += self.T11
        return response

    def through(self, delta: ComplexArray) -> ComplexArray:
        """``T12 Delta (I - M Delta)^-1`` for N diagonals of Delta (N, q): shape (N, p, q)."""
        # rows are fewer than columns: solutions with the transposed matrices; that of one frequency is contiguous
        M = self.M.swapaxes(-1, -2)
        loop = (np.ascontiguousarray(M) if M.ndim == 2 else M) * -delta[:, :, None]
        each = np.arange(delta.shape[1])
        loop[:, each, each] += 1.0
        return np.asarray(solve(loop, self.T12.swapaxes(-1, -2) * delta[:, :, None]).swapaxes(1, 2))

    def closed_with_matrix(self, delta: FloatArray) -> ComplexArray:
        """``F_u(Delta)`` at N frequencies for a real matrix Delta (w, z), the same at all of them: shape (N, p, m).

        M is (N, z, w); Delta need not be square.
        """
        count, z, w = self.M.shape
        loop = np.eye(w) - (delta @ np.ascontiguousarray(self.M).view(float)).view(complex)
        rows = solve(loop.swapaxes(1, 2), self.T12.swapaxes(1, 2)).swapaxes(1, 2)
        through = (rows.reshape(-1, w) @ delta).reshape(count, -1, z)
        return np.asarray(self.T11 + through @ self.T21)

    def gain_slopes(self, delta: ComplexArray) -> GainSlopes:
        """Singular values at N frequencies, with a diagonal of Delta (N, q) for each, and slopes of the largest."""
        loop, each, through = self.M * -delta[:, None, :], np.arange(delta.shape[1]), self.through(delta)
        loop[:, each, each] += 1.0
        U, values, Vh = singular_triples(self.T11 + through @ self.T21)
        left, right = U[:, :, 0].conj(), Vh[:, 0].conj()
        z = solve(loop, self.T21 @ right[:, :, None])[:, :, 0]
        outer = rows_times(left, through)
        # T12 (I - Delta M)^-1 = T12 + T12 Delta (I - M Delta)^-1 M
        row = rows_times(left, self.T12) + rows_times(outer, self.M)
        return GainSlopes(values, left, right, outer, z * delta, row * z)


@dataclass(frozen=True)
class GainSlopes:
    """Singular values of N closed responses, and what the largest one depends on.

    Parameters
    ----------
    values : ndarray, shape (N, r)
        Largest first.
    left, right : ndarray, complex, shapes (N, p) and (N, m)
        Singular vectors l (conjugate) and r of the largest one: ``l F_u r`` is its value.
    outer : ndarray, complex, shape (N, q)
        What the left vector takes of signals that are added to the inputs of Delta.
    driven : ndarray, complex, shape (N, q)
        Outputs of Delta that the right vector causes.
    slopes : ndarray, complex, shape (N, q)
        Derivative of the largest value by each entry of Delta: the real part of slope times change.
    """

    values: FloatArray
    left: ComplexArray
    right: ComplexArray
    outer: ComplexArray
    driven: ComplexArray
    slopes: ComplexArray


@dataclass(frozen=True)
class RepeatedClosed:
    """An LFT whose repeated channels are closed: ``constant + sum_k delta / (1 - delta poles_k) residue_k``.

    Parameters
    ----------
    poles : ndarray, complex, shape (a,)
    terms : ndarray, complex, shape (a + 1, (r + p) (r + m))
        The residues for the r other channels and p outputs, the r other channels and m inputs; last the constant.
    shape : (int, int)
        ``r + p, r + m``.
    repeated : ndarray of bool, shape (a + r,)
        Which of the channels are those of the repeated parameter.
    """

    poles: ComplexArray
    terms: ComplexArray
    shape: tuple[int, int]
    repeated: BoolArray

    @classmethod
    def of(cls, lft: LftResponse, repeated: BoolArray, condition: float = 1e9) -> RepeatedClosed | None:
        """Closed form of an LFT at one frequency; None where the eigenvectors of the channels are no basis."""
        M, T12, T21, others = lft.M, lft.T12, lft.T21, ~repeated
        poles, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(M[np.ix_(repeated, repeated)]))
        lu, pivots, info = linalg.lapack.zgetrf(vectors)
        reciprocal = linalg.lapack.zgecon(lu, np.abs(vectors).sum(axis=0).max())[0]
        if info != 0 or not reciprocal * condition >= 1.0:
            return None
        left = np.vstack([M[np.ix_(others, repeated)], T12[:, repeated]]) @ vectors
        into = np.hstack([M[np.ix_(repeated, others)], T21[repeated]])
        right = linalg.lapack.zgetrs(lu, pivots, into)[0]
        shape = (len(left), right.shape[1])
        terms: ComplexArray = np.empty((len(poles) + 1, *shape), complex)
        np.multiply(left.T[:, :, None], right[:, None, :], out=terms[:-1])
        terms[-1] = np.block([[M[np.ix_(others, others)], T21[others]], [T12[:, others], lft.T11]])
        return cls(poles, terms.reshape(len(terms), -1), shape, repeated)

    def closed(self, delta: ComplexArray, together: int = 80) -> ComplexArray:
        """Responses for N diagonals of Delta (N, a + r): shape (N, p, m)."""
        single, first = delta[:, ~self.repeated], int(np.flatnonzero(self.repeated)[0])
        r = single.shape[1]
        out = np.empty((len(delta), self.shape[0] - r, self.shape[1] - r), complex)
        size = min(together, len(delta))
        factors, space = np.ones((size, len(self.terms)), complex), np.empty((size, self.terms.shape[1]), complex)
        for start in range(0, len(delta), size):
            part = slice(start, min(start + size, len(delta)))
            turned, count = delta[part, first, None], part.stop - part.start
            factors[:count, :-1] = turned / (1.0 - turned * self.poles)
            whole = np.matmul(factors[:count], self.terms, out=space[:count]).reshape(-1, *self.shape)
            out[part] = LftResponse.of(whole, r).closed(single[part])
        return out


def feedback(gain: ComplexArray, entering: ComplexArray, *, balanced: bool = False) -> ComplexArray:
    """Solutions u of ``u = L u + r`` for N loops: ``(I - L)^-1 r``, the closing of a controller around a plant.

    With a controller K and a plant's response P from commands to measurements, both at N frequencies, L is ``K P``
    where ``u = K y`` (no sign is added), and the sensitivity is the solution for ``r = I``.

    Parameters
    ----------
    gain : ndarray, complex, shape (N, u, u)
        L, the gain of the open loop, broken at the commands.
    entering : ndarray, complex, shape (N, u, m)
        r, what is added to the commands.
    balanced : bool
        Divide each row of ``I - L`` by its largest entry: of commands in different units, such as angles beside forces,
        the small ones lose digits otherwise.

    Returns
    -------
    ndarray, complex, shape (N, u, m)

    Raises
    ------
    LinAlgError
        A loop that is singular.
    """
    returned = np.asarray(np.eye(gain.shape[1]) - gain)
    if balanced:
        scale = 1.0 / np.abs(returned).max(axis=2)[:, :, None]
        returned, entering = scale * returned, scale * entering
    return solve(returned, entering)


def rows_times(rows: ComplexArray, matrices: ComplexArray) -> ComplexArray:
    """``row @ matrix`` of N rows (N, p) and matrices (N, p, m): shape (N, m)."""
    return np.asarray((rows[:, None, :] @ matrices)[:, 0])
