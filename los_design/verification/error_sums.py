"""What proven bounds of tones and of noise make together, in the form of the budgets.

A tone of amplitude a along one axis and noise of r rms keep :func:`titop_plant.telescope.budget.combined_level` in the
required part of windows or instants; it grows with both, so that bounds of them give a bound (with the part of the
noise on one axis that the budgets assume). A fast tone counts as one at the edge of its band, where it turns least in a
window. Slow and fast tones at
once, with norm s and f, ``s^2 + f^2 = 1``, have amplitudes below ``s a_slow`` and ``f a_fast``. Along one axis and with
independent phases their sum is ``R |sin phi|`` with phi uniform and R at most ``s a_slow + f a_fast <= hypot(a_slow,
a_fast)``: no quantile of it, with noise, is above that of one tone of this amplitude.

Each of the 22 channels of the reference at its own weight has norm sqrt(22) in all, and bounds grow by that factor at
most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from los_loop.figures_of_merit import figure
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.telescope.budget import ABSOLUTE_ON_AXIS, BAND_EDGE, ON_AXIS, combined_level
from titop_plant.telescope.layout import channels
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.requirements import instant_probability, telescope_requirements, window_probability


@dataclass(frozen=True)
class ErrorSum:
    """A sum of contributions against its limit.

    Parameters
    ----------
    name : str
        What acts.
    value, limit : float
        In `unit`.
    unit : str
    """

    name: str
    value: float
    limit: float
    unit: str

    @property
    def kept(self) -> bool:
        """Whether it is within the limit."""
        return self.value <= self.limit

    @property
    def text(self) -> str:
        """With its limit.

        Examples
        --------
        >>> ErrorSum("APE, tone and noise", 9.3312, 12.0, "arcsec").text
        'APE, tone and noise: 9.332 of 12 arcsec'
        """
        value = math.ceil(self.value * 1e3) / 1e3
        return f"{self.name}: {value:g} of {self.limit:g} {self.unit}" + ("" if self.kept else ", above the limit")


def error_sums(
    parameters: Parameters, stage: str, tones: Mapping[str, float], noise: tuple[float, float] | None
) -> tuple[ErrorSum, ...]:
    """Sums of a stage; those of which a contribution is missing are left out.

    Parameters
    ----------
    parameters : mapping
        Of the telescope.
    stage : str
    tones : mapping of str to float
        Bounds of the figures APE, slow and fast [rad].
    noise : (float, float) or None
        Bounds of the root mean square of the absolute and the relative error over both axes [rad].
    """
    rules = telescope_requirements(parameters)
    ape, rpe = (figure(name).limit(parameters, stage) for name in ("APE", "RPE"))
    arcsec, mas = ape / RAD_PER_ARCSEC, rpe / RAD_PER_MAS
    instants, windows = instant_probability(rules), window_probability(rules)
    slow, fast = (tones.get(name, math.nan) / RAD_PER_MAS for name in ("slow", "fast"))
    absolute = tones.get("APE", math.nan) / RAD_PER_ARCSEC
    both, turn = math.hypot(slow, fast), BAND_EDGE * float(parameters["weights"]["rpe_window"])
    found = []
    if noise is not None:
        wide, fine = noise[0] / RAD_PER_ARCSEC, noise[1] / RAD_PER_MAS
        found += [
            ("APE, tone of norm 1 and noise", _absolute(absolute, wide, instants), arcsec, "arcsec"),
            ("RPE, slow tone of norm 1 and noise", _level(slow, fine, windows), mas, "mas"),
            ("RPE, fast tone of norm 1 and noise", _level(fast, fine, windows, turn), mas, "mas"),
            (
                "RPE, slow and fast tone, norm 1 in all, and noise",
                _level(both, fine, windows),
                mas,
                "mas",
            ),
        ]
    sums = [ErrorSum(*row) for row in found if not math.isnan(row[1])]
    inputs = channels(parameters)
    norm = math.sqrt(inputs)
    together = f"each of {inputs} channels at its own weight, norm {norm:.2f}"
    rows = (("APE", absolute, arcsec, "arcsec"), ("slow", slow, mas, "mas"), ("fast", fast, mas, "mas"))
    for name, tone, limit, unit in rows:
        if not math.isnan(tone):
            sums.append(ErrorSum(f"{name}, {together}, without noise", norm * tone, limit, unit))
    return tuple(sums)


def _level(tone: float, noise: float, part: float, turn: float = 0.0, on_axis: float = ON_AXIS) -> float:
    return math.nan if math.isnan(tone + part) else combined_level(tone, noise, part, on_axis, turn)


def _absolute(tone: float, noise: float, part: float) -> float:
    return _level(tone, noise, part, on_axis=ABSOLUTE_ON_AXIS)
