"""Accuracy and limits of the computation of proven bounds."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.proofs.settings import BOUNDS, CELLS, SEARCH, BoundSettings, CellSettings, SearchSettings
from lftkit.support.scalars import as_positive
from lftkit.systems.arguments import checked

METHODS = ("cells", "axis")


@checked
@dataclass(frozen=True)
class BoundOptions:
    """Accuracy and limits of proven bounds.

    Parameters
    ----------
    gap : float
        Relative distance of the bounds that ends the computation.
    wall_limit : float
        Seconds. Then the best bounds so far are given, with what is not covered.
    max_tests : int
        Most cells that are tried; as the wall limit, but the same on every machine.
    seed : int
        Of the search for worst members.
    progress : bool
        Show a progress line.
    method : {"cells", "axis"}, optional
        Cells of parameters and frequency, or scalings over the frequency axis. By default cells up to
        seven states (of stability the first sixty of them), and where the other cannot be used: it needs uncertain
        elements, and a nominal member in the box that is stable with separate poles.
    search : SearchSettings
        Numbers of the search for members with a large gain and for unstable ones.
    cells : CellSettings
        Numbers of the proofs by cells.
    settings : BoundSettings
        Numbers of the levels and factors that are tried, and of the choice of the method.

    Raises
    ------
    ValueError
        A gap or a wall limit that is not positive, a negative number of cells, an unknown method.
    """

    gap: float = 0.05
    wall_limit: float = 600.0
    max_tests: int = 5000
    seed: int = 0
    progress: bool = False
    method: str | None = None
    search: SearchSettings = SEARCH
    cells: CellSettings = CELLS
    settings: BoundSettings = BOUNDS

    def __post_init__(self) -> None:
        as_positive(self.gap, "gap")
        if not self.wall_limit > 0.0:
            raise InputError(f"wall_limit must be positive [s], got {self.wall_limit}")
        if self.max_tests < 0:
            raise InputError(f"max_tests must be at least 0, got {self.max_tests}")
        if self.method is not None and self.method not in METHODS:
            raise InputError(f"method must be cells or axis, got {self.method!r}")
