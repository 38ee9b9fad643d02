"""Choice of compiled code for ticks: results are bit-identical, so that only the time decides."""

from __future__ import annotations

import sys
from functools import cache
from types import ModuleType

WORTH = 15_000
"""Ticks of a run from which on compiled code is worth the import of numba, about half a second."""


@cache
def kernel() -> ModuleType | None:
    """The compiled ticks, :mod:`titop_plant.simulation.kernel`; None without numba (extra ``fast``)."""
    try:
        from titop_plant.simulation import kernel as compiled
    except ImportError:
        return None
    return compiled


def kernel_for(ticks: int) -> ModuleType | None:
    """:func:`kernel` for a run of so many ticks; None also where the numpy code is done sooner."""
    loaded = "titop_plant.simulation.kernel" in sys.modules
    return kernel() if loaded or ticks >= WORTH else None


__all__ = ["WORTH", "kernel", "kernel_for"]
