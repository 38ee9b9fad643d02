"""Relative error over the length of the exposure, with the requirements at their windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.report.figures import LIMIT, Picture, RunView, _panels, legend_above, picture, stroke
from pointing_analysis.requirements.text import Requirement

POINTS = 24
"""Lengths of exposure."""

WINDOWS = 10
"""Fewest whole windows in the run of the longest exposure."""

PROBABILITY = 0.997
FEWEST = 3
"""Fewest samples of the shortest exposure."""


def over_exposure(views: Sequence[RunView], requirements: Sequence[Requirement]) -> Picture | None:
    """Rms of the relative error in windows of each length: of all windows, and what 99.7 % of them keep.

    Parameters
    ----------
    views : of all runs
    requirements : those on the rms RPE in windows, both axes, are marked at their window
    """
    curves = [(i, view, *_curve(view)) for i, view in enumerate(views)]
    curves = [curve for curve in curves if curve[2].size > 1]
    if not curves:
        return None
    asked = {(r.times[0], r.limit): r for r in requirements if r.index == "RPE" and r.of_windows and not r.axis}

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        for i, view, length, rms, most in curves:
            style = stroke(i, len(views))
            axis.loglog(1e3 * length, most, label=view.label, **style)
            axis.loglog(1e3 * length, rms, ls=":", **style)
        axis.plot([], [], color="#555555", label="99.7 % of the windows")
        axis.plot([], [], color="#555555", ls=":", label="rms of all")
        for k, (window, limit) in enumerate(sorted(asked)):
            name = "limit" if k == 0 else "_nolegend_"
            axis.plot(1e3 * window, limit / RAD_PER_MAS, "v", color=LIMIT, ms=7, label=name)
        axis.set_xlabel("exposure [ms]")
        axis.set_ylabel("rms RPE of a window [mas]")
        legend_above(figure, axis)

    alt = "Relative error in windows of each length, rms and 99.7 % of the windows; marks: limits at their windows"
    return picture("rpe-over-exposure", "Relative error over exposure time", alt, 3.8, draw)


def _curve(view: RunView) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lengths [s], rms and quantile [mas] over windows without missing samples; lengths without such are left out."""
    n, dt = len(view.series.values), view.series.dt
    if n < FEWEST * WINDOWS:
        return np.empty(0), np.empty(0), np.empty(0)
    samples = np.unique(np.geomspace(FEWEST, n // WINDOWS, POINTS).round().astype(int))
    rows = []
    for count in samples:
        power = metrics.windows(view.series.values, dt, count * dt).variance.sum(axis=1) / RAD_PER_MAS**2
        if power.size and power.max() > 0.0:
            rows.append((count * dt, float(np.sqrt(power.mean())), float(np.sqrt(np.quantile(power, PROBABILITY)))))
    table = np.array(rows).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]
