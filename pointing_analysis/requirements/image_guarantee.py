r"""From a bound of the relative error to a bound of the image quality.

The phase of a pattern, :math:`y = 2\pi f\cdot(x - \bar x)`, has the mean square :math:`s^2 = 4\pi^2 f^T C f` over the
exposure. :math:`\cos\sqrt u` is convex in u up to :math:`u = \pi^2`, where it is -1; continued beyond by -1 it is
convex everywhere and nowhere above the cosine, so that (Jensen)

.. math:: |M(f)| \ge \overline{\cos y} \ge \cos s \ge 1 - 2\pi^2 f^T C f, \qquad s \le \pi/2

whatever the motion. It is attained by a line of sight that is at either of two places half of the time. With an upper
bound of the rms along any direction it holds at each frequency up to a quarter of a cycle per rms; beyond it nothing is
claimed.
"""

from __future__ import annotations

import math

from lftkit.errors import InputError
from pointing_analysis.formatting.number_text import at_least, at_most
from pointing_analysis.image.optics import Optics
from pointing_analysis.requirements.image_summary import ImageSummary
from pointing_analysis.units import RAD_PER_MAS


def least_transfer(rms: float, frequency: float) -> float:
    """Transfer of the motion that no exposure is below, zero where nothing is claimed.

    Parameters
    ----------
    rms : bound of the rms in an exposure, along the worst direction or of both axes [rad]
    frequency : [cycles/rad]

    Examples
    --------
    >>> [round(least_transfer(10 * RAD_PER_MAS, f / (1000 * RAD_PER_MAS)), 3) for f in (0.0, 6.6, 13.2, 26.0)]
    [1.0, 0.915, 0.675, 0.0]
    """
    if not (rms >= 0.0 and frequency >= 0.0):
        raise InputError(f"rms and frequency must not be negative, got {rms:g} and {frequency:g}")
    return max(math.cos(min(2 * math.pi * frequency * rms, math.pi / 2)), 0.0) if 4 * frequency * rms < 1.0 else 0.0


def proven_text(rms: float, exposure: float, optics: Optics, measured: ImageSummary | None) -> str:
    """One line: what is proven of the motion's MTF beside what was measured.

    Parameters
    ----------
    rms : that no exposure exceeds [rad]
    exposure : [s]
    optics : Optics
    measured : of the run
    """
    half, full = (least_transfer(rms, part * optics.nyquist) for part in (0.5, 1.0))
    end = 0.25 / rms / optics.nyquist
    at_full = f"{at_least(full, 3)} at Nyquist" if full else f"no bound above {at_least(end, 3)} Nyquist"
    bound = at_most(rms / RAD_PER_MAS)
    text = (
        f"MTF of the motion, {1e3 * exposure:g} ms, proven for every telescope of the family and one tone of "
        f"norm 1, without noise: at least {at_least(half, 3)} at 0.5 Nyquist, {at_full} (RPE {bound} mas)"
    )
    if measured is None or measured.exposure != exposure:
        return text
    return f"{text}; measured with noise, 99.7 %: {measured.mtf_half:.3g} at 0.5 Nyquist, {measured.mtf:.3g} at Nyquist"
