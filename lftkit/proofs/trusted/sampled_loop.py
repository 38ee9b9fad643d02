"""Check of a proof of a sampled loop: its gain over a box of parameters and a band of frequencies.

Premises that need no inequality are numbers, sizes, box and band. The bounds of rounding hold for double precision and
frequencies that are not negative, and sums pair parameters with their channels, intervals and scalings one by one: a
missing entry would leave one of them out. Each premise is asked for by a function of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.proof import Box, Each, Interval, Strip, indices, refusing, require
from lftkit.proofs.trusted.stability import stable_below
from lftkit.proofs.trusted.strips import check_strips

OF_REAL = ("D", "K_D", "weights")
MOST_TICKS = 10_000
"""For which a measurement is held: the hold is a sum of as many terms."""


@dataclass(frozen=True)
class LoopProof:
    """What is claimed of a loop and the strips that prove it.

    Parameters
    ----------
    model : Loop
    names : tuple of str
        Of the parameters.
    box : tuple of (low, high)
        As in :class:`~lftkit.proofs.trusted.proof.Strip`.
    band : (low, high)
        Frequencies [rad/s].
    level : float
        The gain is below this part of the limit.
    strips : tuple of Strip
    about : mapping
        What the loop is, for people: figure, stage, designs.
    """

    model: Loop
    names: tuple[str, ...]
    box: Box
    band: Interval
    level: float
    strips: tuple[Strip, ...]
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckedLoop:
    """What a proof that passed guarantees; `plant` is the digest of the loop (:attr:`Loop.digest`)."""

    plant: str
    level: float
    names: tuple[str, ...]
    box: Box
    band: Interval
    strips: int
    windows: int
    about: dict[str, Any]
    stable_below: float
    """No pole crosses the axis up to this frequency [rad/s] and the nominal loop was proven stable: infinite if
    `stable`, zero if nothing was proven of stability.
    """

    @property
    def stable(self) -> bool:
        """Every member: the nominal loop was proven stable, and no pole crosses the axis."""
        return math.isinf(self.stable_below)


def check_loop_proof(proof: LoopProof, each: Each = map, stability: bool = True) -> CheckedLoop:
    """Verify a proof of a loop; a ProofError says why it is refused.

    Parameters
    ----------
    proof : LoopProof
    each : callable
        Maps a function over the strips; they may be checked in several processes.
    stability : bool
        Whether stability is looked at, too; without it the result says that nothing was proven of it.
    """
    with refusing("a proof of a loop"):
        require_premises(proof)
        model, strips, box, band = proof.model, proof.strips, proof.box, proof.band
        windows = check_strips(model, strips, box, band, proof.level, each, "rad/s")
        below = stable_below(model, band, box) if stability else 0.0
        return CheckedLoop(
            model.digest, proof.level, proof.names, box, band, len(strips), windows, dict(proof.about), below
        )


def require_premises(proof: LoopProof) -> None:
    """Refuse a proof with a ProofError that says what is missing."""
    require_numbers(proof.model)
    require_sizes(proof.model)
    require_groups(proof)
    require_box(proof.box)
    require_band(proof)


def shapes_of(model: Loop) -> dict[str, tuple[int, ...]]:
    """Shapes of the matrices that fit to each other."""
    q, y, e, d, u = model.sizes
    n, k, rows, columns = model.poles.size, model.K_poles.size, q + y + e, q + d + u
    of_plant = {"poles": (n,), "C": (rows, n), "B": (n, columns), "D": (rows, columns), "weights": (d, 3)}
    return {**of_plant, "K_poles": (k,), "K_C": (u, k), "K_B": (k, y), "K_D": (u, y), "frame": (y,)}


def require_numbers(model: Loop) -> None:
    """Finite numbers in double precision; real where the system has to be real; dt, limit and amplitudes positive."""
    for name in ("poles", "C", "B", "K_poles", "K_C", "K_B", *OF_REAL):
        kind, array = (np.float64 if name in OF_REAL else np.complex128), getattr(model, name)
        finite = array.dtype == kind and np.all(np.isfinite(array))
        require(finite, f"{name} must have finite numbers of type {kind.__name__}, got others or {array.dtype}")
    dt, scale, window = model.dt, model.scale, model.window
    positive = 0.0 < dt < math.inf and math.pi / dt < math.inf and 0.0 < scale < math.inf and 0.0 <= window < math.inf
    require(positive, f"dt and limit must be positive, got {dt}, {scale} and window {window}")
    ticks = model.frame.dtype.kind == "i" and np.all((model.frame >= 1) & (model.frame <= MOST_TICKS))
    require(ticks, f"a measurement must be held for a number of ticks, got {model.frame}")
    amplitudes = model.weights.ndim == 2 and np.all(model.weights[:, 0] > 0.0)
    require(amplitudes, "amplitudes of disturbances must be positive")


def require_sizes(model: Loop) -> None:
    """Matrices that fit to each other, and at least one bounded output that exists."""
    _, y, e, d, u = model.sizes
    for name, shape in shapes_of(model).items():
        own = getattr(model, name).shape
        require(own == shape and min(shape) >= 0, f"{name} must have shape {shape}, got {own}")
    require(u or not y, "measurements need a controller, got none")
    each = len(model.added) == d and model.commands and indices(model.added, u)
    added = (each and indices([model.returned], 3)) if model.added else model.returned == 0
    require(added, f"each disturbance or none must be added to a command, got {model.added}, {model.returned}")
    possible = u if model.commands else e
    some = model.rows and indices(model.rows, possible)
    require(some, f"bounded rows must be some of {possible}, got {model.rows}")


def require_groups(proof: LoopProof) -> None:
    """Every channel belongs to one parameter; every parameter has a name, a kind and an interval."""
    groups, count = proof.model.groups, len(proof.model.groups)
    channels = [channel for group in groups for channel in group]
    own = indices(channels, len(channels)) and len({*channels}) == len(channels)
    own = own and len(set(proof.names)) == len(proof.names)
    require(own, "every channel must belong to one parameter, and names must differ")
    each = len(proof.names) == len(proof.model.angle) == len(proof.box) == count
    require(each, f"each of {count} parameters must have a name, a kind and an interval, got others")


def require_box(box: Sequence[Interval]) -> None:
    """Finite intervals of deviations that contain zero: all members are connected with the nominal one."""
    nominal = all(-math.inf < low <= 0.0 <= high < math.inf for low, high in box)
    require(nominal, f"a box of deviations must be finite and contain zero, the nominal member, got {box}")


def require_band(proof: LoopProof) -> None:
    """A band from zero to half of the sampling rate at most, and a level."""
    band, level = proof.band, proof.level
    within = 0.0 <= band[0] < band[1] <= math.pi / proof.model.dt * (1.0 + 1e-12) and 0.0 < level < math.inf
    require(within, f"a proof needs 0 <= low < high <= pi / dt and a level, got {band} and {level}")
