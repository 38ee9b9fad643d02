"""What every checker of proofs says: why it refuses, what a proof guarantees, whether parts cover a box.

Part of what is trusted.
"""

from __future__ import annotations

from dataclasses import dataclass

Box = list[tuple[float, float]]


class ProofError(ValueError):
    """The proof is refused; the message says why and where."""


@dataclass(frozen=True)
class CheckedProof:
    """What a proof that passed guarantees; `margin` is the smallest ratio of a margin to the bound of all rounding."""

    kind: str
    level: float | None
    box: dict[str, tuple[float, float]]
    band: tuple[float, float]
    cells: int
    margin: float
    stable: bool


def uncovered(box: Box, cells: list[Box]) -> Box | None:
    """Part of `box` that no cell contains, or None; the box is cut at faces of cells until one contains each part."""
    inside = [c for c in cells if all((lo < high and hi > low) or low == high for (lo, hi), (low, high) in zip(c, box))]
    if any(all(lo <= low and hi >= high for (lo, hi), (low, high) in zip(c, box)) for c in inside):
        return None
    cuts = {(i, at) for c in inside[:50] for i, ends in enumerate(c) for at in ends if box[i][0] < at < box[i][1]}
    if not cuts:
        return box
    axis, at = min(cuts, key=lambda cut: sum(c[cut[0]][0] < cut[1] < c[cut[0]][1] for c in inside))
    halves = ([*box[:axis], part, *box[axis + 1 :]] for part in ((box[axis][0], at), (at, box[axis][1])))
    return next((hole for half in halves if (hole := uncovered(half, inside)) is not None), None)
