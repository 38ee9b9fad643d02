"""What all proofs share: types, why one is refused, strips and whether they cover a box, what a proof guarantees."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Interval = tuple[float, float]
Box = tuple[Interval, ...]
Each = Callable[..., Iterable["int | str"]]
"""Maps a function over the strips of a proof: ``map``, or that of several processes."""
REAL, COMPLEX, FULL = "real", "complex", "full"
"""Uncertain elements: real numbers, complex numbers in a disk, dynamics (any complex matrix up to a norm)."""


class ProofError(ValueError):
    """The proof is refused; the message says why and where."""


class ProofFileError(ProofError):
    """The file is of no proof, or cannot be read as one: nothing in it was checked."""


FAULTS = (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError)
"""What a damaged proof may raise."""


def require(met: object, message: str) -> None:
    """Refuse a proof where a premise is not met."""
    if not met:
        raise ProofError(message)


def indices(values: Sequence[object], below: int) -> bool:
    """Whether all are integers from zero to `below`; truth values, which numpy takes for a mask, are none."""
    return all(type(value) is int and 0 <= value < below for value in values)


@contextmanager
def refusing(what: str) -> Iterator[None]:
    """A check of what must be a proof of something: whatever fails in it is a ProofError."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
            yield
    except ProofError:
        raise
    except FAULTS as error:
        raise ProofError(f"the file must be {what}, got entries that do not fit together") from error


@dataclass(frozen=True)
class CheckedProof:
    """What a proof of a system by cells, or over the axis, guarantees.

    `plant` is the digest of the numbers of the system that was checked
    (:func:`~lftkit.proofs.trusted.digests.plant_digest`), `margin` the smallest ratio of a margin to the bound of all
    rounding. `disks` has the radii of complex numbers and the bounds of dynamics by name.
    """

    plant: str
    kind: str
    level: float | None
    box: dict[str, Interval]
    band: Interval
    cells: int
    margin: float
    stable: bool
    disks: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Strip:
    """A box of the parameters and scalings at some frequencies.

    Parameters
    ----------
    box : tuple of (low, high)
        Deviations from the nominal values; of an angle theta [rad].
    nodes : ndarray, shape (k,)
        Frequencies [rad/s], ascending, two at least.
    D, G : tuple of ndarray, complex, shape (k, m, m)
        Of each parameter, Hermitian. D is positive definite, or zero for all nodes of an angle: then it is any angle.
    factor : ndarray, shape (k,)
        Of the gain's inequality, positive.
    """

    box: Box
    nodes: FloatArray
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    factor: FloatArray


def uncovered(box: Sequence[Interval], cells: Sequence[Sequence[Interval]]) -> list[Interval] | None:
    """Part of `box` that no cell contains, or None; the box is cut at faces of cells until one contains each part."""
    inside = [c for c in cells if all((lo < high and hi > low) or low == high for (lo, hi), (low, high) in zip(c, box))]
    if any(all(lo <= low and hi >= high for (lo, hi), (low, high) in zip(c, box)) for c in inside):
        return None
    cuts = {(i, at) for c in inside[:50] for i, ends in enumerate(c) for at in ends if box[i][0] < at < box[i][1]}
    if not cuts:
        return list(box)
    axis, at = min(cuts, key=lambda cut: sum(c[cut[0]][0] < cut[1] < c[cut[0]][1] for c in inside))
    halves = ([*box[:axis], part, *box[axis + 1 :]] for part in ((box[axis][0], at), (at, box[axis][1])))
    return next((hole for half in halves if (hole := uncovered(half, inside)) is not None), None)


def require_cover(strips: Sequence[Strip], box: Sequence[Interval], band: Interval, unit: str) -> None:
    """Whether strips cover a box and a band of their variable, whose unit is named; a ProofError names a hole."""
    spans = [(float(strip.nodes[0]), float(strip.nodes[-1])) for strip in strips]
    cuts = sorted({*band, *(at for span in spans for at in span)})
    for low, high in itertools.pairwise(cuts):
        boxes = [strip.box for strip, span in zip(strips, spans) if span[0] <= low and span[1] >= high]
        if band[0] < high and low < band[1] and (hole := uncovered(box, boxes)) is not None:
            raise ProofError(f"the strips must cover the box, got a hole at {hole} from {low} to {high} {unit}")
