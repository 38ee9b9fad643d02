"""The model of a sampled loop with what only the search for proofs needs: responses without bounds, and hints.

Hints are what a checker asks of others and need not trust: coordinates of an inequality, parameters to bisect. Whatever
they are, what is checked with them holds; with bad ones the check does not come to its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.proofs.trusted.loop import CHANGE, Loop
from lftkit.proofs.trusted.polynomials import Polynomial, constant
from lftkit.proofs.trusted.proof import Box, Interval, Strip
from lftkit.proofs.trusted.stability import WIDEST, deviation_share
from lftkit.proofs.trusted.strips import Responses, ends_of, is_circle


class SearchedResponses(Responses, Protocol):
    """Responses for which scalings are searched; ``complex`` and ``full`` elements are never bisected."""

    @property
    def slowest(self) -> float:
        """Value of the variable well below which all responses are nearly real."""

    def at(self, x: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d), without bounds."""

    def amplitudes(self, x: float, /) -> tuple[float, FloatArray]:
        """Weight of the bounded output and amplitudes of the disturbances, without bounds."""


@dataclass(frozen=True)
class LoopModel(Loop):
    """The loop of a proof, for those who search proofs and for the checker; fields are those of :class:`Loop`."""

    @property
    def slowest(self) -> float:
        """Smallest magnitude of the plant's poles [rad/s], at most 1 / dt."""
        return float(np.abs(self.poles).min(initial=1.0 / self.dt))

    def at(self, omega: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the bounded output by (w, d) at one frequency, (q, q + d) and (rows, q + d), without bounds."""
        q, y, _, d, _ = self.sizes
        s, z = 1j * omega, np.exp(1j * omega * self.dt)
        growth, gain = (known.c[0] for known in self.growth)
        response = (self.C / (s - self.poles)) @ self.B[:, : q + d] + self.D[:, : q + d]
        if not len(self.K_C):
            return response[:q], np.asarray(response[q:][list(self.rows)])
        commanded = self.B[:, q + d :]
        seen = (self.C[q:] * (gain / (z - growth))) @ commanded + self.D[q:, q + d :]
        felt = (self.C[:q] / (s - self.poles)) @ commanded + self.D[:q, q + d :]
        K = ((self.K_C / (z - self.K_poles)) @ self.K_B + self.K_D) / z
        K = K * np.array([np.mean(z ** -np.arange(n)) for n in self.frame])
        from lftkit.analysis.lft_response import feedback  # what reads a proof does without

        u = feedback((K @ seen[:y])[None], (K @ response[q : q + y] + self.entry)[None], balanced=True)[0]
        hold = (1.0 - 1.0 / z) / (s * self.dt)
        channels = response[:q] + hold * felt @ u
        if self.returned:
            u = (u - self.entry) * (1.0 - 1.0 / z if self.returned == CHANGE else 1.0)
        outputs = u if self.commands else response[q + y :] + seen[y:] @ u
        return channels, np.asarray(outputs[list(self.rows)])

    def amplitudes(self, omega: float, /) -> tuple[float, FloatArray]:
        """Weight of the bounded output (over the limit) and amplitudes of the disturbances, without bounds."""
        output, inputs = self.performance(omega, 0.0)
        return float(np.sqrt(output.c[0, 0].real)), np.asarray(inputs.c[0].real ** -0.5)

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square."""
        return coordinates(self, strip, number, omega, level)

    def to_bisect(self, M: Polynomial, part: Box, /) -> int | None:
        """Parameter to bisect where the channels are M over a window, or None where a narrower window helps."""
        return to_bisect(self, M, part)


def coordinates(model: SearchedResponses, strip: Strip, number: int, omega: float, level: float) -> ComplexArray:
    """(w, d) by coordinates in which the form of a strip is about -I at a frequency after the node `number`."""
    q, d = model.sizes[0], model.sizes[3]
    z, e = model.at(omega)
    weight, amplitude = model.amplitudes(omega)
    share = (omega - strip.nodes[number]) / (strip.nodes[number + 1] - strip.nodes[number])

    def between(values: ComplexArray | FloatArray) -> Any:
        return values[number] + share * (values[number + 1] - values[number])

    w = np.eye(q, q + d)
    half = np.zeros((q + d, q + d), complex)
    ca, sa, cb, sb = ends_of(model, strip.box)[:, :, None]
    first, second = ca * w - sa * z, sb * z - cb * w
    for k, group in enumerate(map(list, model.groups)):
        half += first[group].conj().T @ between(strip.D[k]) @ second[group]
        half += z[group].conj().T @ (1j * between(strip.G[k])) @ w[group]
    form = half + half.conj().T + between(strip.factor) * (weight / level) ** 2 * e.conj().T @ e
    form[q:, q:] -= between(strip.factor) * np.diag(amplitude**-2.0)
    # (w, d) by (deviation of w from the middle of the box, d)
    V: ComplexArray = np.vstack([from_middle(model, strip.box, z)[1], np.hstack([np.zeros((d, q)), np.eye(d)])])
    scale = 1.0 / np.concatenate([np.ones(q), 1.0 / amplitude])
    for _ in range(2):
        middle = -(V.conj().T @ form @ V)
        size = np.abs(np.diag(middle)) ** -0.5
        factor, info = linalg.lapack.zpotrf(middle * size[:, None] * size, lower=0)
        if info:
            return np.asarray(V * scale)
        V = np.asarray(linalg.solve_triangular(factor, (V * size).T, trans=1).T, complex)
    return V


def from_middle(
    model: SearchedResponses, box: Sequence[Interval], z: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """The variables z' and w, each (q, q + d), by (w', d) of :func:`middle_of`, where z (q, q + d) is by (w, d)."""
    q = model.sizes[0]
    cz, sz, cw, sw = middle_of(model, box)
    inner = np.asarray(linalg.solve(np.diag(cz) - z[:, :q] * cw, np.hstack([z[:, :q] * sw - np.diag(sz), z[:, q:]])))
    w = cw[:, None] * inner
    w[:, :q] += np.diag(sw)
    return inner, w


def middle_of(model: SearchedResponses, box: Sequence[Interval]) -> Matrices:
    """Coefficients (q,) of ``z = cz z' + sz w'`` and ``w = cw z' + sw w'``, w' = 0 in the middle, +-z' at the ends."""
    q = model.sizes[0]
    cz, sz, cw, sw = np.ones(q), np.zeros(q), np.zeros(q), np.zeros(q)
    for group, angle, (low, high) in zip(map(list, model.groups), model.angle, box):
        at, width = 0.5 * (low + high), 0.5 * (high - low) or 1.0  # of a fixed parameter any
        cw[group], sw[group] = at, width
        if angle and is_circle(low, high):
            cw[group], sw[group] = 0.0, 1.0
        elif angle:
            t = math.tan(0.5 * width)
            cz[group], sz[group] = math.cos(0.5 * at), -t * math.sin(0.5 * at)
            cw[group], sw[group] = math.sin(0.5 * at), t * math.cos(0.5 * at)
    return cz, sz, cw, sw


def to_bisect(model: Loop, M: Polynomial, part: Box, enough: float = 0.7) -> int | None:
    """Parameter to bisect where the channels are M over a window, or None where a narrower window is what helps.

    The latter is so where the share at the middle of the window is `enough` or less.
    """
    wide = [k for k, (low, high) in enumerate(part) if model.angle[k] and high - low > WIDEST]
    if wide:
        return wide[0]
    at = constant(M.c[0])
    return widest(model, at, part) if deviation_share(model, at, part) > enough else None


def widest(model: Loop, M: Polynomial, part: Box) -> int:
    """Parameter whose interval alone has the largest share."""
    shares = []
    for k, (low, high) in enumerate(part):
        middle = [(0.5 * (a + b),) * 2 for a, b in part]
        middle[k] = (low, high)
        shares.append(deviation_share(model, M, tuple(middle)) if high > low else 0.0)
    return int(np.argmax(shares))
