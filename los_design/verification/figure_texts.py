"""Figures, bounds and margins in the units and words that people use for them."""

from __future__ import annotations

import math

from los_design.verification.error_sum import PART
from los_design.verification.frames import LIMITS as FRAME_LIMITS
from los_design.verification.loop_models import LATER, RETURNED
from los_loop.figures_of_merit import FIGURES
from los_loop.spec import LINE_OF_SIGHT
from pointing_analysis.formatting.number_text import at_least, at_most
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import COMMANDED

SENSITIVITY = "sensitivity"


def bound_text(figure: str, level: float, limit: float) -> str:
    """A figure of merit with its bound and its limit in the unit that people use for it.

    Examples
    --------
    >>> bound_text("slow", 0.4991, 1.4544410e-7)
    'slow 14.98 of 30 mas'
    >>> bound_text("APE", 0.9958, 2.4240684e-5), bound_text("force", 0.2097, 0.1)
    ('APE 4.979 of 5 arcsec', 'force 0.02097 of 0.1 N')
    >>> bound_text("fast, 85 to 126", 0.5, 1.4544410e-7)
    'fast, 85 to 126 rad/s: 15 of 30 mas'
    """
    if figure in FRAME_LIMITS:
        return f"{figure} {at_most(level * limit, 3)} of {limit:g}"
    kind = figure.split(", ")[0]
    if kind in RETURNED or kind == SENSITIVITY:
        return f"{figure} {at_most(level * limit)} of {limit:g} ({margin_text(kind, level * limit)})"
    names = (figure, kind)  # of a part of a band the second one
    row = next(row for name in names for row in FIGURES if row.name == name)
    unit, name = RAD_PER_ARCSEC, "arcsec" if row.output == LINE_OF_SIGHT else "arcsec of the mirror"
    if row.output == COMMANDED[-1]:
        unit, name = 1.0, "N"
    elif row.relative:
        unit, name = RAD_PER_MAS, "mas"
    name_of = f"{figure} rad/s:" if figure.startswith(PART) else figure
    return f"{name_of} {at_most(level * limit / unit)} of {limit / unit:g} {name}"


def margin_text(kind: str, peak: float) -> str:
    """What a bound of a margin's gain guarantees of the commands of one port, up to half of the sampling rate.

    With the sensitivity S below Ms, factors ``1 / (1 - d)`` with complex ``|d| <= alpha = 1 / Ms`` keep every pole from
    the axis; with the complementary sensitivity below Mt, factors ``1 + d`` with ``|d| <= 1 / Mt``. Each command of the
    port may have its own.

    Examples
    --------
    >>> margin_text("sensitivity", 2.0)
    'disk margin 0.5: gains x0.667 to x2, phase 28.9 deg'
    >>> margin_text("gain x0.5", 1.0), margin_text("one more tick", 0.4)
    ('gains x0 to x2, phase 60 deg', 'kept')
    """
    if kind == LATER:
        return "kept" if peak <= 1.0 else "not shown"
    alpha = 1.0 / peak
    phase = f"phase {at_least(math.degrees(2.0 * math.asin(min(1.0, 0.5 * alpha))), 3)} deg"
    if kind != SENSITIVITY:
        return f"gains x{at_most(max(0.0, 1.0 - alpha), 3)} to x{at_least(1.0 + alpha, 4)}, {phase}"
    high = f"x{at_least(1.0 / (1.0 - alpha), 4)}" if alpha < 1.0 else "any"
    return f"disk margin {at_least(alpha, 3)}: gains x{at_most(1.0 / (1.0 + alpha), 3)} to {high}, {phase}"
