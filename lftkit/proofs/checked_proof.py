"""What a proof by cells, or of a system over the axis, guarantees."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class CheckedProof:
    """What a proof that passed guarantees.

    `margin` is the smallest ratio of a margin to the bound of all rounding. `disks` has the radii of complex numbers
    and the bounds of dynamics by name.
    """

    kind: str
    level: float | None
    box: dict[str, tuple[float, float]]
    band: tuple[float, float]
    cells: int
    margin: float
    stable: bool
    disks: dict[str, float] = field(default_factory=dict)
