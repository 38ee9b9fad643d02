"""Cumulative RMS over frequency, with the steps at the disturbance lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import weights
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.report.figures import (
    COLOURS,
    Picture,
    RunView,
    _panels,
    legend_above,
    picture,
    stroke,
    windows_text,
)
from pointing_analysis.report.spectrum_figure import mark_tones

CLOSE = 3.0
"""Ratio of frequencies below which the names of two lines would cover each other."""

NEAR = 1.4
"""Ratio of heights below which the names of two lines of different runs would cover each other."""

SMALL = 0.1
"""Part of the largest line below which a line makes no visible step and is not named."""

UNLIKE = 5.0
"""Ratio of the whole error to its RPE part from which the axis is logarithmic."""


def cumulative(views: Sequence[RunView]) -> Picture:
    """Cumulative RMS of the error and of its RPE part, which steps up at each line; the largest steps are named.

    One run whose parts are of one size has a linear axis from zero. Else the axis is logarithmic and begins at a
    thirtieth of the smallest total, and the steps are named at the RPE part: they do not show on slow motion.
    """
    curves: list[tuple[int, RunView, FloatArray, FloatArray, FloatArray]] = []
    for i, view in enumerate(views):
        if (s := view.spectrum) is not None:
            weight = weights.rpe_exact(2 * np.pi * s.frequency, view.window)
            whole, part = s.cumulative_rms() / RAD_PER_MAS, s.cumulative_rms(weight) / RAD_PER_MAS
            curves.append((i, view, s.frequency[1:], whole[1:], part[1:]))

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        axis.set_xscale("log")
        for i, view, frequency, whole, part in curves:
            axis.step(frequency, whole, where="post", label=view.label, **stroke(i, len(views)))
            axis.step(frequency, part, where="post", ls="--", **stroke(i, len(views)))
        totals = [float(curve[-1]) for *_, whole, part in curves for curve in (whole, part)]
        unlike = len(curves) > 1 or (bool(totals) and UNLIKE * min(totals) < max(totals))
        logarithmic = unlike and min(totals, default=0.0) > 0.0
        if logarithmic:
            axis.set_yscale("log")
            axis.set_ylim(bottom=min(totals) / 30)
        else:
            axis.set_ylim(bottom=0.0)
        axis.plot([], [], color="#555555", ls="--", label=f"RPE part ({windows_text(views)})")
        mark_tones(axis, views)
        _name_steps(axis, [(i, view, f, part if logarithmic else whole) for i, view, f, whole, part in curves])
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("RMS below frequency [mas]")
        legend_above(figure, axis)

    alt = "Root mean square of the line of sight below each frequency, whole and weighted for the relative error"
    return picture("cumulative", "Cumulative RMS", alt, 3.8, draw)


def _name_steps(axis: Axes, curves: Sequence[tuple[int, RunView, FloatArray, FloatArray]]) -> None:
    """Frequencies of the largest lines of each run, at the height of its curve behind them.

    A name that would cover that of a line close below it stands under the curve; one that would cover a name of
    another run is left out.
    """
    named: list[tuple[float, float]] = []
    for i, view, frequency, curve in curves:
        strongest = sorted(view.tones, key=lambda line: -line.rms)[: 3 if len(curves) == 1 else 1]
        strongest = [line for line in strongest if line.rms >= SMALL * strongest[0].rms]
        level, before = 0, 0.0
        for line in sorted(strongest, key=lambda line: line.omega):
            hertz = line.omega / (2 * np.pi)
            level, before = (level + 1 if hertz < CLOSE * before else 0), hertz
            height = float(np.interp(1.05 * hertz, frequency, curve))
            others = [(x, y) for x, y in named if 1 / CLOSE < hertz / x < CLOSE and 1 / NEAR < height / y < NEAR]
            if others and len(curves) > 1:
                continue
            named.append((hertz, height))
            axis.annotate(
                f"{hertz:.3g} Hz",
                (hertz, height),
                xytext=(-3, -1 - 9 * level if level else 3),
                textcoords="offset points",
                ha="right",
                fontsize=7.5,
                color=COLOURS[i % 6],
                gid=f"run-{i}",
            )
