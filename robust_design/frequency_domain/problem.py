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

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lti.batched_linalg import largest_gains, singular_triples, solve
from robust_design.frequency_domain.blocks import ControllerBlock, ControllerResponse
from robust_design.frequency_domain.gains import ResponseGain, ResponseNoise
from robust_design.frequency_domain.metric import chained, gram_sum
from robust_design.frequency_domain.samples import PlantSamples

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.intp]
CHUNK = 4000
CLOSE = 0.85
"""Second singular values above this part of the first are looked at, too."""
MIXTURES = ((0.0, 1.0), (1.0, 1.0), (1.0, -1.0), (1.0, 1.0j), (1.0, -1.0j))
"""Unit vectors of the span of two singular vectors, but for their length, beside the first."""


@dataclass(frozen=True)
class Closed:
    """Closed loops at N pairs: S, C, T and the plant's parts."""

    S: ComplexArray
    C: ComplexArray
    T: ComplexArray
    Pyw: ComplexArray
    Pyu: ComplexArray
    Peu: ComplexArray

    def part(self, gain: ResponseGain) -> ComplexArray:
        """The response whose largest singular value a gain is."""
        if gain.inputs is None:
            return self.T if gain.outputs is None else self.C[:, gain.outputs]
        rows = self.Peu @ self.S if gain.outputs is None else self.S[:, gain.outputs]
        return np.asarray(rows[:, :, gain.inputs])

    def left(self, gain: ResponseGain) -> ComplexArray:
        """L of a gain."""
        return np.asarray(self.Peu @ self.S if gain.outputs is None else self.S[:, gain.outputs])

    def right(self, gain: ResponseGain) -> ComplexArray:
        """R of a gain."""
        if gain.inputs is None:
            return np.asarray(self.Pyw + self.Pyu @ self.C)
        return np.asarray(self.Pyu @ self.S[:, :, gain.inputs])


def close(samples: PlantSamples, K: ComplexArray) -> Closed:
    """Close loops with the controllers K, shape (N, commands, measurements)."""
    P, ny, nw = samples.response, samples.measurements, samples.disturbances
    Pyw, Pyu, Pew, Peu = P[:, :ny, :nw], P[:, :ny, nw:], P[:, ny:, :nw], P[:, ny:, nw:]
    eye = np.eye(samples.commands)
    S = solve(np.asarray(eye - K @ Pyu), np.broadcast_to(eye, (len(K), *eye.shape)).astype(complex))
    C = S @ (K @ Pyw)
    return Closed(S, C, Pew + Peu @ C, Pyw, Pyu, Peu)


@dataclass(frozen=True)
class ResponseProblem:
    """Controllers, samples and what is asked of the loop.

    Parameters
    ----------
    blocks : sequence of ControllerBlock
    samples : PlantSamples
    gains : sequence of ResponseGain
    noises : sequence of ResponseNoise
    """

    blocks: tuple[ControllerBlock, ...]
    samples: PlantSamples
    gains: tuple[ResponseGain, ...]
    noises: tuple[ResponseNoise, ...] = ()
    scales: FloatArray = field(init=False, repr=False)
    _omega: FloatArray = field(init=False, repr=False)
    _index: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        omega, at_frequency = np.unique(self.samples.omega, return_inverse=True)
        scales = np.array([gain.scale(self.samples.omega) for gain in self.gains])
        for name, value in (("_omega", omega), ("_index", at_frequency), ("scales", scales)):
            object.__setattr__(self, name, value)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which entries of the parameter vector are tuned."""
        return np.concatenate([block.free.ravel() for block in self.blocks])

    @property
    def hard(self) -> NDArray[np.bool_]:
        """Which gains are hard."""
        return np.array([gain.hard for gain in self.gains])

    def controllers(self, x: FloatArray) -> ControllerResponse:
        """Responses of the controllers at the samples' different frequencies."""
        s = self.samples
        return ControllerResponse.of(self.blocks, x, self._omega, s.measurements, s.commands)

    def values(self, x: FloatArray, index: IntArray | None = None) -> FloatArray:
        """Scaled gains, shape (gains, pairs), of all pairs or those at `index`; not finite where a loop is singular."""
        response = self.controllers(x)
        chosen = np.arange(len(self.samples)) if index is None else index
        found = np.zeros((len(self.gains), len(chosen)))
        for begin in range(0, len(chosen), CHUNK):
            part = chosen[begin : begin + CHUNK]
            samples = self.samples.chosen(part)
            for active in self._active():
                closed = close(samples, response.matrix(active, self._index[part]))
                for g, gain in enumerate(self.gains):
                    if gain.active == active:
                        scaled = largest_gains(closed.part(gain)) * self.scales[g, part]
                        found[g, begin : begin + CHUNK] = scaled
        return found

    def slopes(self, x: FloatArray, entries: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Values and gradients of entries (gain, pair): shapes (n,), (n, parameters), and the gain of each.

        There are more of them than entries where singular values are close.
        """
        response = self.controllers(x)
        values, gradients, owners = [], [], []
        for g in np.unique(entries[:, 0]):
            gain, pairs = self.gains[g], entries[entries[:, 0] == g, 1]
            at_frequency, scale = self._index[pairs], self.scales[g, pairs]
            closed = close(self.samples.chosen(pairs), response.matrix(gain.active, at_frequency))
            U, sigma, Vh = singular_triples(closed.part(gain))
            L, R = closed.left(gain), closed.right(gain)
            for weights in ((1.0, 0.0), *MIXTURES):
                w = np.array(weights) / np.sqrt(np.sum(np.abs(weights) ** 2))
                first = weights == (1.0, 0.0)
                if not first and sigma.shape[1] < 2:
                    break
                at = np.arange(len(pairs)) if first else np.flatnonzero(sigma[:, 1] > CLOSE * sigma[:, 0])
                if len(at) == 0:
                    continue
                m = min(2, sigma.shape[1])
                u = U[at][:, :, :m] @ w[:m]
                v = np.einsum("nji,j->ni", Vh[at][:, :m].conj(), w[:m])
                a = np.einsum("nij,ni->nj", L[at].conj(), u)
                b = np.einsum("nij,nj->ni", R[at], v)
                values.append((sigma[at][:, :m] @ np.abs(w[:m]) ** 2) * scale[at])
                gradients.append(chained(response, gain.active, at_frequency[at], a, b) * scale[at][:, None])
                owners.append(np.full(len(at), g))
        return np.concatenate(values), np.vstack(gradients), np.concatenate(owners)

    def noise(self, x: FloatArray) -> FloatArray:
        """Scaled noise, shape (noises,)."""
        return np.array([value for value, _ in self._noise(x, False)])

    def noise_slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scaled noise and its gradients, shapes (noises,) and (noises, parameters)."""
        found = self._noise(x, True)
        size = len(self.free)
        return np.array([v for v, _ in found]), np.array([g for _, g in found]).reshape(len(found), size)

    def _noise(self, x: FloatArray, slope: bool) -> list[tuple[float, FloatArray]]:
        found = []
        for noise in self.noises:
            response, _, closed, K = self._noise_loop(x, noise)
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
            found.append((value / noise.limit, gradient))
        return found

    def _noise_loop(
        self, x: FloatArray, noise: ResponseNoise
    ) -> tuple[ControllerResponse, IntArray, Closed, ComplexArray]:
        s = noise.samples
        response = ControllerResponse.of(self.blocks, x, s.omega, s.measurements, s.commands)
        index = np.arange(len(s))
        K = response.matrix(noise.active, index)
        return response, index, close(s, K), K

    def metric(self, x: FloatArray, index: IntArray, values: FloatArray, sharpness: float) -> FloatArray:
        """Gauss-Newton matrix of the logarithms of errors and noise, shape (parameters, parameters).

        Parameters
        ----------
        x : ndarray
        index : ndarray of int
            Pairs.
        values : ndarray, shape (gains, len(index))
            Scaled gains there.
        sharpness : float
            A pair of the value f has the weight ``exp(sharpness (f / max - 1))``.
        """
        response, size = self.controllers(x), len(x)
        noise = self.noise(x)
        top = max(float(values.max()), float(noise.max(initial=0.0)))
        H, total = np.zeros((size, size)), 0.0
        for g, gain in enumerate(self.gains):
            near = np.flatnonzero(values[g] > 0.5 * top)
            if gain.outputs is not None or len(near) == 0:
                continue
            pairs = index[near]
            weight = np.exp(sharpness * (values[g, near] / top - 1.0))
            closed = close(self.samples.chosen(pairs), response.matrix(gain.active, self._index[pairs]))
            each = weight * (self.scales[g, pairs] / values[g, near]) ** 2
            H += gram_sum(response, gain.active, self._index[pairs], each, closed.left(gain), closed.right(gain))
            total += float(weight.sum())
        H /= max(total, 1.0)
        for k, entry in enumerate(self.noises):
            at, indices, closed, K = self._noise_loop(x, entry)
            Kn = K * entry.density[:, None, :]
            R = np.eye(K.shape[2]) * entry.density[:, None, :] + closed.Pyu @ (closed.S @ Kn)
            weight = np.exp(sharpness * (noise[k] / top - 1.0))
            each = entry.step * (weight / (entry.limit * noise[k]) ** 2)
            H += gram_sum(at, entry.active, indices, each, closed.Peu @ closed.S, R)
        return H

    def _active(self) -> Sequence[tuple[int, ...]]:
        return sorted({gain.active for gain in self.gains})


def _matrix_chain(response: ControllerResponse, active: tuple[int, ...], inner: ComplexArray) -> FloatArray:
    """Sum over frequencies of ``Re(inner' dK)`` as a gradient over all entries."""
    out = []
    for b, (block, part) in enumerate(zip(response.blocks, response.parts)):
        if b not in active:
            out.append(np.zeros(block.shape[0] * block.shape[1]))
            continue
        own = inner[:, block.commands, block.measurements]
        whole = part.left.conj().swapaxes(1, 2) @ own @ part.right.conj().swapaxes(1, 2)
        out.append(np.real(whole.sum(axis=0)).ravel())
    return np.concatenate(out)
