"""Premises of the statement of a proof that need no inequality: numbers, sizes, box and band.

The bounds of rounding hold for double precision and frequencies that are not negative, and sums pair parameters with
their channels, intervals and scalings one by one: a missing entry would leave one of them out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.proof import Interval, ProofError, Strip

if TYPE_CHECKING:
    from lftkit.proofs.trusted.given import LoopProof, Responses

REAL = ("D", "K_D", "weights")
MOST_TICKS = 10_000
"""For which a measurement is held: the hold is a sum of as many terms."""


def require_premises(proof: LoopProof) -> None:
    """Refuse a proof with a ProofError that says what is missing."""
    require_numbers(proof.model)
    require_sizes(proof.model)
    require_groups(proof)
    require_box(proof.box)
    require_band(proof)
    for number, strip in enumerate(proof.strips):
        require_strip(number, strip, proof.model)


def require(met: object, message: str) -> None:
    """Refuse a proof where a premise is not met."""
    if not met:
        raise ProofError(message)


def indices(values: Sequence[object], below: int) -> bool:
    """Whether all are integers from zero to `below`; truth values, which numpy takes for a mask, are none."""
    return all(type(value) is int and 0 <= value < below for value in values)


def shapes_of(model: Loop) -> dict[str, tuple[int, ...]]:
    """Shapes of the matrices that fit to each other."""
    q, y, e, d, u = model.sizes
    n, k, rows, columns = model.poles.size, model.K_poles.size, q + y + e, q + d + u
    of_plant = {"poles": (n,), "C": (rows, n), "B": (n, columns), "D": (rows, columns), "weights": (d, 3)}
    return {**of_plant, "K_poles": (k,), "K_C": (u, k), "K_B": (k, y), "K_D": (u, y), "frame": (y,)}


def require_numbers(model: Loop) -> None:
    """Finite numbers in double precision; real where the system has to be real; dt, limit and amplitudes positive."""
    for name in ("poles", "C", "B", "K_poles", "K_C", "K_B", *REAL):
        kind, array = (np.float64 if name in REAL else np.complex128), getattr(model, name)
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


def require_strip(number: int, strip: Strip, model: Responses) -> None:
    """Ordered intervals; frequencies that ascend from zero or above; scalings of every parameter at every one."""
    nodes, shapes = strip.nodes, [(len(strip.nodes), len(group), len(group)) for group in model.groups]
    finite = len(strip.box) == len(shapes) and all(-math.inf < low <= high < math.inf for low, high in strip.box)
    require(finite, f"strip {number} must have a finite interval of each parameter, got {strip.box}")
    numbers = nodes.dtype == np.float64 and nodes.ndim == 1 and len(nodes) >= 2
    ascending = numbers and nodes[0] >= 0.0 and nodes[-1] < math.inf and np.all(np.diff(nodes) > 0.0)
    require(ascending, f"strip {number} must have two frequencies from zero or above that ascend, got {nodes}")
    for name, scalings in (("D", strip.D), ("G", strip.G)):
        own = [array.shape for array in scalings] == shapes and all(m.dtype == np.complex128 for m in scalings)
        require(own, f"strip {number} must have {name} of shapes {shapes}, got others")
    factors = strip.factor.shape == nodes.shape and strip.factor.dtype == np.float64
    require(factors, f"strip {number} must have a factor at each node, got shape {strip.factor.shape}")
