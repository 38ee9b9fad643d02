"""Premises of the statement of a proof that need no inequality: numbers, sizes, box and band.

Part of what is trusted, as :mod:`lftkit.proofs.sampled_loop.checker`. The bounds of rounding there hold for double
precision and frequencies that are not negative, and its sums pair parameters with their channels, intervals and
scalings one by one: a missing entry would leave one of them out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.proof import LoopProof
from lftkit.proofs.strips import Interval, Strip
from lftkit.proofs.verdict import ProofError

if TYPE_CHECKING:
    from lftkit.proofs.sampled_loop.responses import Responses

COMPLEX = ("poles", "C", "B", "K_poles", "K_C", "K_B")
REAL = ("D", "K_D", "weights")


def require_premises(proof: LoopProof) -> None:
    """Refuse a proof with a ProofError that says what is missing."""
    require_numbers(proof.model)
    require_sizes(proof.model)
    require_groups(proof)
    require_box(proof.box)
    require_band(proof)
    for number, strip in enumerate(proof.strips):
        require_strip(number, strip, proof.model)


def require_numbers(model: LoopModel) -> None:
    """Finite numbers in double precision; real where the system has to be real; dt, limit and amplitudes positive."""
    for name in (*COMPLEX, *REAL):
        kind, array = (np.complex128 if name in COMPLEX else np.float64), getattr(model, name)
        if array.dtype != kind or not np.all(np.isfinite(array)):
            raise ProofError(f"{name} must have finite numbers of type {kind.__name__}, got others or {array.dtype}")
    if not (0.0 < model.dt < math.inf and 0.0 < model.scale < math.inf and 0.0 <= model.window < math.inf):
        raise ProofError(f"dt and limit must be positive, got {model.dt}, {model.scale} and window {model.window}")
    if model.frame.dtype.kind != "i" or not np.all(model.frame >= 1):
        raise ProofError(f"a measurement must be held for a number of ticks, got {model.frame}")
    if model.weights.ndim != 2 or not np.all(model.weights[:, 0] > 0.0):
        raise ProofError("amplitudes of disturbances must be positive")


def require_sizes(model: LoopModel) -> None:
    """Matrices that fit to each other, and at least one bounded output that exists."""
    q, y, e, d, u = model.sizes
    n, k = model.poles.size, model.K_poles.size
    expected = {
        "poles": (n,),
        "C": (q + y + e, n),
        "B": (n, q + d + u),
        "D": (q + y + e, q + d + u),
        "K_poles": (k,),
        "K_C": (u, k),
        "K_B": (k, y),
        "K_D": (u, y),
        "frame": (y,),
        "weights": (d, 3),
    }
    for name, shape in expected.items():
        if getattr(model, name).shape != shape or min(shape) < 0:
            raise ProofError(f"{name} must have shape {shape}, got {getattr(model, name).shape}")
    if y and not u:
        raise ProofError("measurements need a controller, got none")
    whole = len(model.added) == d and model.commands and all(isinstance(k, int) and k in range(u) for k in model.added)
    if (model.added and not whole) or model.returned not in ((0, 1, 2) if model.added else (0,)):
        raise ProofError(f"each disturbance or none must be added to a command, got {model.added}, {model.returned}")
    possible = range(u if model.commands else e)
    if not model.rows or not all(isinstance(row, int) and row in possible for row in model.rows):
        raise ProofError(f"bounded rows must be some of {len(possible)}, got {model.rows}")


def require_groups(proof: LoopProof) -> None:
    """Every channel belongs to one parameter; every parameter has a name, a kind and an interval."""
    model, count = proof.model, len(proof.model.groups)
    channels = sorted(channel for group in model.groups for channel in group)
    if channels != list(range(len(channels))) or len(set(proof.names)) != len(proof.names):
        raise ProofError("every channel must belong to one parameter, and names must differ")
    if not len(proof.names) == len(model.angle) == len(proof.box) == count:
        raise ProofError(
            f"each of {count} parameters must have a name, a kind and an interval, got {len(proof.names)}, "
            f"{len(model.angle)} and {len(proof.box)}"
        )


def require_box(box: Sequence[Interval]) -> None:
    """Finite intervals of deviations that contain zero: all members are connected with the nominal one."""
    for low, high in box:
        if not (math.isfinite(low) and math.isfinite(high) and low <= 0.0 <= high):
            raise ProofError(f"a box of deviations must be finite and contain zero, the nominal member, got {box}")


def require_band(proof: LoopProof) -> None:
    """A band from zero to half of the sampling rate at most, and a level."""
    band, dt = proof.band, proof.model.dt
    if not (0.0 <= band[0] < band[1] <= math.pi / dt * (1.0 + 1e-12) and 0.0 < proof.level < math.inf):
        raise ProofError(f"a proof needs 0 <= low < high <= pi / dt and a level, got {band} and {proof.level}")


def require_strip(number: int, strip: Strip, model: Responses) -> None:
    """Ordered intervals; frequencies that ascend from zero or above; scalings of every parameter at every one."""
    count, nodes = len(model.groups), strip.nodes
    if len(strip.box) != count or not all(-math.inf < low <= high < math.inf for low, high in strip.box):
        raise ProofError(f"strip {number} must have a finite interval of each parameter, got {strip.box}")
    if nodes.dtype != np.float64 or nodes.ndim != 1 or len(nodes) < 2 or not 0.0 <= nodes[0] <= nodes[-1] < math.inf:
        raise ProofError(f"strip {number} must have two frequencies from zero or above, got {nodes}")
    if not np.all(np.diff(nodes) > 0.0):
        raise ProofError(f"nodes of strip {number} must ascend")
    shapes = [(len(nodes), len(group), len(group)) for group in model.groups]
    for name, scalings in (("D", strip.D), ("G", strip.G)):
        if [array.shape for array in scalings] != shapes or any(array.dtype != np.complex128 for array in scalings):
            raise ProofError(f"strip {number} must have {name} of shapes {shapes}, got others")
    if strip.factor.shape != nodes.shape or strip.factor.dtype != np.float64:
        raise ProofError(f"strip {number} must have a factor at each node, got shape {strip.factor.shape}")
