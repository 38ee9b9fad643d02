"""Relative error over the length of the exposure, with the requirements at their windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointing_analysis.arrays import FloatArray
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.mapped_arrays import SortedValues
from pointing_analysis.report.figures import LIMIT, Picture, RunView, _panels, legend_above, picture, stroke
from pointing_analysis.requirements.exposure import probabilities_of
from pointing_analysis.requirements.requirement import Requirement

POINTS = 24
"""Lengths of exposure."""

WINDOWS = 10
"""Fewest whole windows in the run of the longest exposure."""

DASHES = ("-", "-.", (0, (6, 2)), (0, (4, 1, 1, 1)))
"""Of the curves of the parts, the largest first."""

REACH = 1.5
"""Ratio of either end of the line of a limit to its window."""

FEWEST = 3
"""Fewest samples of the shortest exposure."""


def over_exposure(views: Sequence[RunView], requirements: Sequence[Requirement]) -> Picture | str:
    """Rms of the relative error in windows of each length: of all windows, and what each required part of them keeps.

    A sentence that says so where no run is long enough.

    Parameters
    ----------
    views : of all runs
    requirements : those on the rms RPE in windows, both axes, are marked at their window, with the mark of the curve of
        the part of the windows that they ask for
    """
    relative = [r for r in requirements if r.index == "RPE" and r.of_windows and not r.axis]
    asked = sorted({(r.times[0], r.limit, r.probability) for r in relative})
    wanted = sorted({r.probability for r in relative} or {probabilities_of(requirements).windows}, reverse=True)
    curves = [(i, view, *_curve(view, wanted, [window for window, *_ in asked])) for i, view in enumerate(views)]
    curves = [curve for curve in curves if curve[2].size > 1]
    if not curves:
        return f"No relative error by window length: it needs {FEWEST * WINDOWS} samples that are not all the same."

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        for i, view, length, rms, most in curves:
            style = stroke(i, len(views))
            for k, kept in enumerate(most.T):
                name = view.label if k == 0 else "_nolegend_"
                axis.loglog(1e3 * length, kept, label=name, ls=DASHES[k % len(DASHES)], **style)
            axis.loglog(1e3 * length, rms, ls=":", **style)
        for k, part in enumerate(wanted):
            name = f"{100 * part:.6g} % of the windows"
            axis.plot([], [], color="#555555", ls=DASHES[k % len(DASHES)], label=name)
        axis.plot([], [], color="#555555", ls=":", label="rms of all")
        for k, part in enumerate(wanted):
            limits = [(1e3 * window, limit / RAD_PER_MAS) for window, limit, p in asked if p == part]
            for number, (window, limit) in enumerate(limits):
                name = "_nolegend_" if number else f"limit for {100 * part:.6g} %"
                axis.plot([window / REACH, window * REACH], [limit, limit], color=LIMIT, lw=1.4)
                axis.plot(window, limit, "v^<>"[k % 4], color=LIMIT, ms=6, label=name)
        _label_limits(axis, sorted({(1e3 * window, limit / RAD_PER_MAS) for window, limit, _ in asked}))
        axis.set_xlabel("length of the window [ms]")
        axis.set_ylabel("rms RPE of a window [mas]")
        legend_above(figure, axis)

    parts = " and ".join(f"{100 * part:.6g} %" for part in wanted)
    alt = f"Relative error in windows of each length, rms and {parts} of the windows; marks: limits at their windows"
    return picture("rpe-over-exposure", "RPE by window length", alt, 3.8, draw)


def _label_limits(axis: Axes, limits: Sequence[tuple[float, float]]) -> None:
    """Windows [ms] and limits [mas] above their lines, aligned so that no label crosses an edge of the axes."""
    low, high = np.log(axis.get_xlim())
    for window, limit in limits:
        place = (np.log(window) - low) / (high - low)
        side, start = ("left", 1 / REACH) if place < 0.25 else ("right", REACH) if place > 0.75 else ("center", 1.0)
        axis.annotate(
            f"{digits(limit)} mas in {digits(window)} ms",
            (window * start, limit),
            (0, 5),
            textcoords="offset points",
            ha=side,
            va="bottom",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8},
            fontsize=7.5,
            color=LIMIT,
        )


def _curve(view: RunView, wanted: Sequence[float], asked: Sequence[float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lengths (m,) [s], rms (m,) and quantiles (m, k) [mas] over windows without missing samples.

    The windows [s] that are asked for are among the lengths, with the values by which they are judged. Lengths without
    complete windows are left out.
    """
    n, dt = len(view.series.values), view.series.dt
    counts = set[float](metrics.samples_in(window, dt) for window in asked if metrics.holds(window, dt))
    if n >= FEWEST * WINDOWS:
        counts |= set(np.geomspace(FEWEST, n // WINDOWS, POINTS).round().tolist())
    rows = []
    for count in sorted(count for count in counts if count <= n):
        rms = np.sqrt(metrics.windows(view.series.values, dt, count * dt).variance.sum(axis=1)) / RAD_PER_MAS
        if rms.size and rms.max() > 0.0:
            ranked = SortedValues(rms)
            rows.append((count * dt, np.sqrt(np.square(rms).mean()), *map(ranked.quantile, wanted)))
    table = np.array(rows, dtype=float).reshape(-1, 2 + len(wanted))
    return table[:, 0], table[:, 1], table[:, 2:]
