"""Proof of a bound of the root mean square that white noise makes in a sampled loop, over a box of parameters.

The inputs of the loop are noise, independent at each tick, each of norm 1 with its amplitude. The mean square of an
output at the ticks is ::

    dt / pi  integral of |T(w)|^2  from 0 to pi / dt        (H2 norm)

with the row T of its responses. The band is cut into parts; in each the norm of T is below a level for all members of
the box, by strips as for any gain (:mod:`lftkit.proofs.sampled_loop.checker`). The sum over parts of the squared levels
bounds the integral. A weight that grows with frequency, as that of the relative error, counts with its value at the
upper end of a part.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lftkit.proofs.sampled_loop.checker import check_loop_proof, stable_below
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.polynomials import INFLATE
from lftkit.proofs.sampled_loop.proof import LoopProof, model_entries, model_of
from lftkit.proofs.strips import Interval, Strip, packed, read_archive, unpacked, write_archive
from lftkit.proofs.verdict import ProofError

FORMAT = "los-testbed noise proof 1"


@dataclass(frozen=True)
class NoisePart:
    """The gain from all noise to one row, in a part of the band.

    Parameters
    ----------
    row : int
        Of the errors.
    band : (low, high)
        Frequencies [rad/s].
    level : float
        Bound of the gain, over the model's limit.
    strips : tuple of Strip
    """

    row: int
    band: Interval
    level: float
    strips: tuple[Strip, ...]


@dataclass(frozen=True)
class NoiseProof:
    """Parts that bound the noise of all rows.

    Parameters
    ----------
    model : LoopModel
        Without the weight of the relative error; its rows are those that count.
    names, box, about
        As of :class:`lftkit.proofs.sampled_loop.LoopProof`.
    parts : tuple of NoisePart
        Of each row from zero to half of the sampling rate, without gaps.
    """

    model: LoopModel
    names: tuple[str, ...]
    box: tuple[Interval, ...]
    parts: tuple[NoisePart, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    def of_part(self, part: NoisePart) -> LoopProof:
        """A part as a proof of a gain."""
        model = replace(self.model, rows=(part.row,))
        return LoopProof(model, self.names, self.box, part.band, part.level, part.strips, self.about)

    def to_file(self, path: Path) -> None:
        """Write the proof as a compressed ``.npz``."""
        header, arrays = model_entries(self.model)
        parts = [[part.row, *part.band, part.level, len(part.strips)] for part in self.parts]
        header |= {"format": FORMAT, "names": self.names, "box": self.box, "parts": parts, "about": dict(self.about)}
        strips = [strip for part in self.parts for strip in part.strips]
        write_archive(path, header, arrays | packed(strips, len(self.names)))

    @classmethod
    def from_file(cls, path: Path) -> NoiseProof:
        """Read a proof.

        Raises
        ------
        ProofError
            No such file, or not a proof.
        """
        with read_archive(path, FORMAT, "a proof of noise") as (header, arrays):
            box = tuple((float(a), float(b)) for a, b in header["box"])
            strips = iter(unpacked(arrays, len(header["names"])))
            parts = tuple(
                NoisePart(row, (float(low), float(high)), float(level), tuple(itertools.islice(strips, count)))
                for row, low, high, level, count in header["parts"]
            )
            return cls(model_of(header, arrays), tuple(header["names"]), box, parts, header["about"])


@dataclass(frozen=True)
class CheckedNoise:
    """What a proof of noise that passed guarantees.

    Parameters
    ----------
    rms : float
        Root mean square of all rows together, in the unit of the rows.
    relative : float
        The same as relative error over `window`; NaN without a window.
    strips, windows : int
    stable_below : float
        As of :class:`lftkit.proofs.sampled_loop.CheckedLoop`; zero where stability was not looked at.
    """

    rms: float
    relative: float
    strips: int
    windows: int
    stable_below: float


def check_noise_proof(
    proof: NoiseProof,
    each: Callable[..., Iterable[int | str]] = map,
    stability: bool = True,
    window: float = 0.0,
) -> CheckedNoise:
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
    try:
        require_parts(proof)
        windows = sum(check_loop_proof(proof.of_part(part), each, stability=False).windows for part in proof.parts)
        model = proof.model
        below = stable_below(model, (0.0, math.pi / model.dt), proof.box) if stability else 0.0
    except (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError) as error:
        known = isinstance(error, ProofError)
        raise ProofError(str(error) if known else f"the file must be a proof of noise, got {error!r}") from None
    relative = mean_square(model, proof.parts, window) if window else math.nan
    count = sum(len(part.strips) for part in proof.parts)
    return CheckedNoise(
        math.sqrt(mean_square(model, proof.parts, 0.0)) * INFLATE, math.sqrt(relative), count, windows, below
    )


def require_parts(proof: NoiseProof) -> None:
    """Each row has parts from zero to half of the sampling rate, one after the other, and no weight is in the model."""
    nyquist, model = math.pi / proof.model.dt, proof.model
    if model.window or model.added or model.commands:
        raise ProofError("noise must be bounded at errors without a weight, got another model")
    if len(set(model.rows)) != len(model.rows) or {part.row for part in proof.parts} != set(model.rows):
        raise ProofError(f"every row must have parts, got rows {model.rows}")
    for row in model.rows:
        bands = sorted(part.band for part in proof.parts if part.row == row)
        ends = [0.0, *(high for _, high in bands)]
        if [low for low, _ in bands] != ends[:-1] or not ends[-1] >= nyquist:
            raise ProofError(f"parts of row {row} must reach from 0 to {nyquist:.6g} rad/s without gaps, got others")


def mean_square(model: LoopModel, parts: Sequence[NoisePart], window: float) -> float:
    """Bound of the mean square by the levels of parts, as relative error where `window` is not zero."""
    total = math.fsum(
        part.level**2 * (part.band[1] - part.band[0]) * (_power(part.band[1] * window) if window else 1.0)
        for part in parts
    )
    return model.scale**2 * model.dt / math.pi * total * (1.0 + 1e-12)


def _power(y: float) -> float:
    """Squared weight of the relative error at ``y = w window``; it grows with y."""
    return 1.0 - 144.0 / (y**4 + 12.0 * y**2 + 144.0)
