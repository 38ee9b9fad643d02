"""Proof of a bound of the root mean square that white noise makes in a sampled loop, over a box of parameters.

The inputs of the loop are noise, independent at each tick, each of norm 1 with its amplitude. The mean square of an
output at the ticks is ::

    dt / pi  integral of |T(w)|^2  from 0 to pi / dt        (H2 norm)

with the row T of its responses. The band is cut into parts; in each the norm of T is below a level for all members of
the box, by strips as for any gain (:mod:`lftkit.proofs.trusted.sampled_loop`). The sum over parts of the squared levels
bounds the integral. The weight of the relative error grows with frequency: in each of some pieces of a part it counts
with its value at the upper end.

In each part the largest singular value of all rows together is bounded: the sum of its squares bounds the largest
eigenvalue of the covariance, that is the mean square along any axis. It bounds each row, too; where single rows have
bounds of their own in a part, the smaller ones count. The sum over rows bounds the trace of the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lftkit.proofs.trusted.arithmetic import UNIT
from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.proof import Box, Each, Interval, Strip, refusing, require
from lftkit.proofs.trusted.sampled_loop import LoopProof, check_loop_proof
from lftkit.proofs.trusted.stability import stable_below

ROUNDING = 1.0 + 1e-9  # covers that of a sum of powers
PIECES = 64
"""Of a part, in each of which the weight of the relative error counts with its value at the upper end."""


@dataclass(frozen=True)
class NoisePart:
    """The gain from all noise to one row, or to all rows together, in a part of the band.

    Parameters
    ----------
    rows : tuple of int
        Of the errors.
    band : (low, high)
        Frequencies [rad/s].
    level : float
        Bound of the gain, over the model's limit.
    strips : tuple of Strip
    """

    rows: tuple[int, ...]
    band: Interval
    level: float
    strips: tuple[Strip, ...]


@dataclass(frozen=True)
class NoiseProof:
    """Parts that bound the noise of all rows.

    Parameters
    ----------
    model : Loop
        Without the weight of the relative error; its rows are those that count.
    names, box, about
        As of :class:`lftkit.proofs.trusted.sampled_loop.LoopProof`.
    parts : tuple of NoisePart
        Of all rows together from zero to half of the sampling rate without gaps; of single rows in any of these bands.
    """

    model: Loop
    names: tuple[str, ...]
    box: Box
    parts: tuple[NoisePart, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    def of_part(self, part: NoisePart) -> LoopProof:
        """A part as a proof of a gain."""
        model = replace(self.model, rows=part.rows)
        return LoopProof(model, self.names, self.box, part.band, part.level, part.strips, self.about)


@dataclass(frozen=True)
class NoiseBound:
    """Bounds of the noise of all rows, in their unit.

    Parameters
    ----------
    rms : float
        Root mean square of all rows together.
    along : float
        Root mean square along any axis.
    powers : tuple of (float, float, float)
        Of all rows together in each band, the band [rad/s] first: their sum is the square of `rms`.
    """

    rms: float
    along: float
    powers: tuple[tuple[float, float, float], ...] = ()

    @property
    def on_axis(self) -> float:
        """Largest part of the power that can be along one axis, if the power is that of `rms`."""
        return min(1.0, (self.along / self.rms) ** 2)


@dataclass(frozen=True)
class CheckedNoise:
    """What a proof of noise that passed guarantees.

    Parameters
    ----------
    plant : str
        Digest of the loop (:attr:`~lftkit.proofs.trusted.loop.Loop.digest`).
    absolute : NoiseBound
    relative : NoiseBound or None
        The same as relative error over `window`; None without a window.
    strips, windows : int
    stable_below : float
        As of :class:`lftkit.proofs.trusted.sampled_loop.CheckedLoop`; zero where stability was not looked at.
    """

    plant: str
    absolute: NoiseBound
    relative: NoiseBound | None
    strips: int
    windows: int
    stable_below: float


def check_noise_proof(proof: NoiseProof, each: Each = map, stability: bool = True, window: float = 0.0) -> CheckedNoise:
    """Verify a proof of noise; a ProofError says why it is refused.

    Parameters
    ----------
    proof : NoiseProof
    each : callable
        Maps a function over the strips of a part.
    stability : bool
        Whether stability is looked at, too; an unstable member has no mean square.
    window : float
        Length of the relative error's window [s].
    """
    with refusing("a proof of noise"):
        require_parts(proof)
        windows = sum(check_loop_proof(proof.of_part(part), each, stability=False).windows for part in proof.parts)
        model, parts = proof.model, proof.parts
        below = stable_below(model, (0.0, math.pi / model.dt), proof.box) if stability else 0.0
        relative = noise_bound(model, parts, window) if window else None
        strips = sum(len(part.strips) for part in parts)
        return CheckedNoise(model.digest, noise_bound(model, parts, 0.0), relative, strips, windows, below)


def require_parts(proof: NoiseProof) -> None:
    """Parts of all rows from zero to half of the sampling rate, those of single rows in their bands; no weight."""
    nyquist, model, parts = math.pi / proof.model.dt, proof.model, proof.parts
    plain = not (model.window or model.added or model.commands) and len(set(model.rows)) == len(model.rows)
    require(plain, "noise must be bounded at errors without a weight, got another model")
    bands = sorted(part.band for part in parts if part.rows == model.rows)
    ends = [0.0, *(high for _, high in bands)]
    whole = [low for low, _ in bands] == ends[:-1] and ends[-1] >= nyquist
    require(whole, f"parts of all rows must reach from 0 to {nyquist:.6g} rad/s without gaps, got others")
    single = [(part.rows, part.band) for part in parts if part.rows != model.rows]
    allowed = {((row,), band) for row in model.rows for band in bands}
    own = len(set(single)) == len(single) and set(single) <= allowed
    require(own, "parts of single rows must be in the bands of those of all rows, once each, got others")


def noise_bound(model: Loop, parts: Sequence[NoisePart], window: float) -> NoiseBound:
    """Bounds by the levels of parts that were proven, as relative error where `window` is not zero."""
    known = {(part.rows, part.band): part.level for part in parts}
    whole = {part.band: part.level for part in parts if part.rows == model.rows}
    trace = {
        band: math.sqrt(sum(min(level, known.get(((row,), band), level)) ** 2 for row in model.rows))
        for band, level in whole.items()
    }
    powers, along_axis = (band_powers(model, levels, window) for levels in (trace, whole))
    rms, along = (math.sqrt(math.fsum(each.values())) * ROUNDING for each in (powers, along_axis))
    if not 0.0 < along < math.inf or not 0.0 < rms < math.inf:
        raise ArithmeticError(f"bounds of noise must be positive and finite, got {rms} and {along}")
    return NoiseBound(rms, min(along, rms), tuple((*band, power) for band, power in sorted(powers.items())))


def band_powers(model: Loop, levels: Mapping[Interval, float], window: float) -> dict[Interval, float]:
    """Bounds of the mean square in each band by its level, as relative error where `window` is not zero."""
    factor = model.scale**2 * model.dt / math.pi * (1.0 + 1e-12)
    return {
        band: factor * level**2 * (power_area(*band, window) if window else band[1] - band[0])
        for band, level in levels.items()
    }


def power_area(low: float, high: float, window: float) -> float:
    """Upper bound of the integral of the relative error's squared weight from `low` to `high` [rad/s]."""
    step = (high - low) / PIECES
    ends = [low + k * step for k in range(1, PIECES)] + [high]
    return math.fsum(step * window_power(at * window) for at in ends) * (1.0 + 1e-12)


def window_power(y: float) -> float:
    """Upper bound of the squared weight of the relative error at ``y = w window``; it grows with y."""
    return 1.0 - 144.0 / (y**4 + 12.0 * y**2 + 144.0) + 8.0 * UNIT
