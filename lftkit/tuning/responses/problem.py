"""Values and gradients of all gains at all pairs.

With the plant's parts ``y = Pyw w + Pyu u, e = Pew w + Peu u`` and ``u = K y + added``::

    S = (I - K Pyu)^-1        added command -> applied command
    C = S K Pyw               disturbance -> command
    T = Pew + Peu C           disturbance -> error

Every change has the form ``d(part) = L dK R`` with ``L = Peu S`` or rows of S, ``R = Pyw + Pyu C`` or columns of
``Pyu S``. Where the two largest singular values are close, both matter: :meth:`ResponseProblem.slopes` answers
``Re(u' part v)`` for several unit vectors of their span, each of them a lower bound of the largest singular value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains, singular_triples
from lftkit.analysis.lft_response import feedback
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.tuning.responses.blocks import (
    ActiveCommands,
    BlockFactors,
    ControllerBlock,
    ControllerResponse,
    active_commands,
)
from lftkit.tuning.responses.chain import chained, gram_sum
from lftkit.tuning.responses.gains import ResponseGain, ResponseNoise
from lftkit.tuning.responses.samples import PlantSamples

Item = TypeVar("Item")
Result = TypeVar("Result")
CHUNK = 1000
"""Pairs that are looked at together: arrays of larger ones take new memory, page by page, each time."""
MIXTURES = ((0.0, 1.0), (1.0, 1.0), (1.0, -1.0), (1.0, 1.0j), (1.0, -1.0j))
"""Unit vectors of the span of two singular vectors, but for their length, beside the first."""


@dataclass(frozen=True)
class Closed:
    """Closed loops at N pairs: S, C, T and the plant's parts, with the commands of the loop."""

    S: ComplexArray
    C: ComplexArray
    T: ComplexArray
    Pyw: ComplexArray
    Pyu: ComplexArray
    Peu: ComplexArray

    rows: ActiveCommands

    def part(self, gain: ResponseGain) -> ComplexArray:
        """The response whose largest singular value a gain is."""
        if gain.inputs is None:
            return self.T if gain.outputs is None else self._of(self.C, gain.outputs)
        return np.asarray(self.left(gain)[:, :, self.rows.positions(gain.inputs)])

    def left(self, gain: ResponseGain) -> ComplexArray:
        """L of a gain."""
        return np.asarray(self.Peu @ self.S if gain.outputs is None else self._of(self.S, gain.outputs))

    def right(self, gain: ResponseGain) -> ComplexArray:
        """R of a gain."""
        if gain.inputs is None:
            return np.asarray(self.Pyw + self.Pyu @ self.C)
        return np.asarray(self.Pyu @ self.S[:, :, self.rows.positions(gain.inputs)])

    def _of(self, matrix: ComplexArray, commands: slice) -> ComplexArray:
        return np.asarray(matrix[:, self.rows.positions(commands)])


def close(samples: PlantSamples, K: ComplexArray, rows: ActiveCommands) -> Closed:
    """Close loops with the controllers K, shape (N, commands of the loop, measurements); other commands are zero."""
    return close_with(samples, K @ samples.response[:, : samples.measurements], rows)


def close_with(samples: PlantSamples, KP: ComplexArray, rows: ActiveCommands) -> Closed:
    """As :func:`close`, with the product of K and the measurements' rows of the samples."""
    P, ny, nw = samples.response, samples.measurements, samples.disturbances
    held = P[:, :, nw:][:, :, rows.index]
    Pyw, Pyu, Pew, Peu = P[:, :ny, :nw], held[:, :ny], P[:, ny:, :nw], held[:, ny:]
    eye = np.eye(len(rows.commands))
    # a product with S is faster than a solution with more right-hand sides
    S = feedback(KP[:, :, nw:][:, :, rows.index], np.broadcast_to(eye, (len(KP), *eye.shape)).astype(complex))
    C = S @ KP[:, :, :nw]
    return Closed(S, C, Pew + Peu @ C, Pyw, Pyu, Peu, rows)


@dataclass(frozen=True)
class ResponseProblem:
    """Controllers, samples and what is asked of the loop.

    Parameters
    ----------
    blocks : sequence of ControllerBlock
    samples : PlantSamples
    gains : sequence of ResponseGain
    noises : sequence of ResponseNoise
    threads : int
        The result does not depend on their number.
    least_level : float
        Below this largest soft gain hard ones count as they are: 1 where soft gains are to be met, 0 where they are to
        be as small as hard ones allow.

    Raises
    ------
    ValueError
        Two blocks with the same command.
    """

    blocks: tuple[ControllerBlock, ...]
    samples: PlantSamples
    gains: tuple[ResponseGain, ...]
    noises: tuple[ResponseNoise, ...] = ()
    threads: int = 1
    least_level: float = 1.0
    scales: FloatArray = field(init=False, repr=False)
    _index: IntArray = field(init=False, repr=False)
    _factors: tuple[BlockFactors, ...] = field(init=False, repr=False)
    _noise_factors: tuple[tuple[BlockFactors, ...], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        commands = active_commands(self.blocks, range(len(self.blocks))).commands.tolist()
        if len(set(commands)) < len(commands):
            raise InputError(f"blocks must have commands of their own, got {sorted(commands)}")
        omega, at_frequency = np.unique(self.samples.omega, return_inverse=True)
        made: dict[str, Any] = {
            "scales": np.array([gain.scale(self.samples.omega) for gain in self.gains]),
            "_index": at_frequency,
            "_factors": self._factors_at(omega),
            "_noise_factors": tuple(self._factors_at(noise.samples.omega) for noise in self.noises),
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)

    def _factors_at(self, omega: FloatArray) -> tuple[BlockFactors, ...]:
        return tuple(BlockFactors.of(block, omega) for block in self.blocks)

    @property
    def free(self) -> BoolArray:
        """Which entries of the parameter vector are tuned."""
        return np.concatenate([block.free.ravel() for block in self.blocks])

    @property
    def hard(self) -> BoolArray:
        """Which gains are hard."""
        return np.array([gain.hard for gain in self.gains], dtype=bool)

    @property
    def hard_noise(self) -> BoolArray:
        """Which noises are hard."""
        return np.array([noise.hard for noise in self.noises], dtype=bool)

    def controllers(self, x: FloatArray, pairs: IntArray) -> tuple[ControllerResponse, IntArray]:
        """Responses of the controllers at the different frequencies of some pairs, and each pair's index among them."""
        at, positions = np.unique(self._index[pairs], return_inverse=True)
        factors = [one.chosen(at) for one in self._factors]
        return ControllerResponse(self.blocks, x, factors, self.samples.measurements), positions

    def at(self, pairs: IntArray) -> ResponseProblem:
        """The problem with some of the pairs."""
        return replace(self, samples=self.samples.chosen(pairs))

    def values(self, x: FloatArray) -> FloatArray:
        """Scaled gains, shape (gains, pairs); not finite where a loop is singular."""
        count, loops = len(self.samples), self._active()
        response, positions = self.controllers(x, np.arange(count))
        asked = sorted({b for active in loops for b in active})
        response.compute(asked)
        joint = active_commands(self.blocks, asked)
        values = np.zeros((len(self.gains), count))

        def fill(begin: int) -> None:
            chunk = slice(begin, begin + CHUNK)
            samples = self.samples.chosen(chunk)
            KP = response.matrix(asked, positions[chunk]) @ samples.response[:, : samples.measurements]
            for active, rows in loops.items():
                closed = close_with(samples, KP[:, joint.rows(active)], rows)
                for g, gain in enumerate(self.gains):
                    if gain.active == active:
                        counts = np.flatnonzero(self.scales[g, chunk])
                        gains = largest_gains(closed.part(gain)[counts])
                        values[g, begin + counts] = gains * self.scales[g, chunk][counts]

        self._each(fill, range(0, count, CHUNK))
        return values

    def _each(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Results of a function for the items, in several threads: its work is in the linear algebra."""
        if self.threads == 1:
            return [function(item) for item in items]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(function, items))

    def slopes(self, x: FloatArray, entries: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Values and gradients of entries (gain, pair): shapes (n,), (n, parameters), and the gain of each.

        There are more of them than entries where singular values are close.
        """
        values: list[FloatArray] = []
        gradients: list[FloatArray] = []
        owners: list[IntArray] = []
        parts = [(int(g), entries[entries[:, 0] == g, 1]) for g in np.unique(entries[:, 0])]
        chunks = [(g, pairs[k : k + CHUNK]) for g, pairs in parts for k in range(0, len(pairs), CHUNK)]
        for (g, _), planes in zip(chunks, self._each(lambda chunk: self._planes(x, *chunk), chunks)):
            values.append(planes[0])
            gradients.append(planes[1])
            owners.append(np.full(len(planes[0]), g))
        return np.concatenate(values), np.vstack(gradients), np.concatenate(owners)

    def _planes(self, x: FloatArray, g: int, pairs: IntArray) -> tuple[FloatArray, FloatArray]:
        """Values and gradients of a gain at pairs, those of the pairs first, then those of mixtures."""
        gain, scale = self.gains[g], self.scales[g, pairs]
        response, positions = self.controllers(x, pairs)
        closed = close(self.samples.chosen(pairs), response.matrix(gain.active, positions), self._active()[gain.active])
        U, sigma, Vh = singular_triples(closed.part(gain))
        L, R = closed.left(gain), closed.right(gain)
        m, values, gradients = min(2, sigma.shape[1]), list[FloatArray](), list[FloatArray]()
        for weights in ((1.0, 0.0), *MIXTURES):
            w, first = np.array(weights) / np.sqrt(np.sum(np.abs(weights) ** 2)), weights == (1.0, 0.0)
            if not first and m < 2:
                break
            at = np.arange(len(pairs)) if first else np.flatnonzero(sigma[:, 1] > 0.85 * sigma[:, 0])
            u = U[at][:, :, :m] @ w[:m]
            v = np.einsum("nji,j->ni", Vh[at][:, :m].conj(), w[:m])
            a = np.einsum("nij,ni->nj", L[at].conj(), u)
            b = np.einsum("nij,nj->ni", R[at], v)
            values.append((sigma[at][:, :m] @ np.abs(w[:m]) ** 2) * scale[at])
            gradients.append(chained(response, gain.active, positions[at], a, b) * scale[at][:, None])
        return np.concatenate(values), np.vstack(gradients)

    def noise(self, x: FloatArray) -> FloatArray:
        """Scaled noise, shape (noises,)."""
        return np.array([value for value, _ in self._noise(x, False)])

    def noise_slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scaled noise and its gradients, shapes (noises,) and (noises, parameters)."""
        noises = self._noise(x, True)
        size = len(self.free)
        return np.array([v for v, _ in noises]), np.array([g for _, g in noises]).reshape(len(noises), size)

    def _noise(self, x: FloatArray, slope: bool) -> list[tuple[float, FloatArray]]:
        rows = []
        for n, noise in enumerate(self.noises):
            response, _, closed, K = self._noise_loop(x, n)
            L, Kn = closed.Peu @ closed.S, K * noise.density[:, None, :]
            T = L @ Kn
            power = float(np.sum(noise.step * np.sum(np.abs(T) ** 2, axis=(1, 2))))
            value = float(np.sqrt(power))
            gradient: FloatArray = np.zeros(0)
            if slope and value > 0.0:
                R = np.eye(K.shape[2]) * noise.density[:, None, :] + closed.Pyu @ (closed.S @ Kn)
                inner = (L.conj().swapaxes(1, 2) @ T) @ R.conj().swapaxes(1, 2) * noise.step[:, None, None]
                gradient = _matrix_chain(response, noise.active, inner) / (value * noise.limit)
            elif slope:
                gradient = np.zeros(len(x))
            rows.append((value / noise.limit, gradient))
        return rows

    def _noise_loop(self, x: FloatArray, n: int) -> tuple[ControllerResponse, IntArray, Closed, ComplexArray]:
        noise = self.noises[n]
        response = ControllerResponse(self.blocks, x, self._noise_factors[n], noise.samples.measurements)
        index = np.arange(len(noise.samples))
        K = response.matrix(noise.active, index)
        return response, index, close(noise.samples, K, active_commands(self.blocks, noise.active)), K

    def metric(self, x: FloatArray, values: FloatArray, sharpness: float) -> FloatArray:
        """Gauss-Newton matrix of the logarithms of errors and noise, shape (parameters, parameters).

        Parameters
        ----------
        x : ndarray
        values : ndarray, shape (gains, pairs)
            Scaled gains.
        sharpness : float
            A pair of the value f has the weight ``exp(sharpness (f / max - 1))``.
        """
        size, noise = len(x), self.noise(x)
        top = max(float(values.max()), float(noise.max(initial=0.0)))
        H, total = np.zeros((size, size)), 0.0
        for gain, each in self._error_weights(values, top, sharpness):
            chosen, rows = np.flatnonzero(each[0]), self._active()[gain.active]
            for begin in range(0, len(chosen), CHUNK):
                pairs = chosen[begin : begin + CHUNK]
                response, positions = self.controllers(x, pairs)
                closed = close(self.samples.chosen(pairs), response.matrix(gain.active, positions), rows)
                H += gram_sum(response, gain.active, positions, each[1, pairs], closed.left(gain), closed.right(gain))
            total += float(each[0].sum())
        H /= max(total, 1.0)
        for k, entry in enumerate(self.noises):
            if not noise[k] > 0.0:
                continue
            at, indices, closed, K = self._noise_loop(x, k)
            Kn = K * entry.density[:, None, :]
            R = np.eye(K.shape[2]) * entry.density[:, None, :] + closed.Pyu @ (closed.S @ Kn)
            weight = np.exp(sharpness * (noise[k] / top - 1.0))
            each = entry.step * (weight / (entry.limit * noise[k]) ** 2)
            H += gram_sum(at, entry.active, indices, each, closed.Peu @ closed.S, R)
        return H

    def _error_weights(self, values: FloatArray, top: float, sharpness: float) -> list[tuple[ResponseGain, FloatArray]]:
        """Sums over the gains of errors of the same response, the first of them standing for all.

        Shape (2, pairs): their weights, and factors of the squares.
        """
        weights: list[tuple[ResponseGain, FloatArray]] = []
        for g, gain in enumerate(self.gains):
            near = values[g] > 0.5 * top
            if gain.outputs is not None or not near.any():
                continue
            same = (each for first, each in weights if (first.active, first.inputs) == (gain.active, gain.inputs))
            each = next(same, None)
            if each is None:
                each = np.zeros((2, len(near)))
                weights.append((gain, each))
            weight = np.exp(sharpness * (values[g, near] / top - 1.0))
            each[0, near] += weight
            each[1, near] += weight * (self.scales[g, near] / values[g, near]) ** 2
        return weights

    def _active(self) -> dict[tuple[int, ...], ActiveCommands]:
        """The loops that are asked for, with their commands."""
        return {active: active_commands(self.blocks, active) for active in sorted({g.active for g in self.gains})}


def _matrix_chain(response: ControllerResponse, active: tuple[int, ...], inner: ComplexArray) -> FloatArray:
    """Sum over frequencies of ``Re(inner' dK)`` as a gradient over all entries."""
    out, rows_of = [], active_commands(response.blocks, active).of_block
    for b, (block, part) in enumerate(zip(response.blocks, response.parts)):
        if b not in active:
            out.append(np.zeros(block.shape[0] * block.shape[1]))
            continue
        middle = inner[:, rows_of[b], block.measurements]
        whole = part.left.conj().swapaxes(1, 2) @ middle @ part.right.conj().swapaxes(1, 2)
        out.append(np.real(whole.sum(axis=0)).ravel())
    return np.concatenate(out)
