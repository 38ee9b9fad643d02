"""Power spectral density of the line of sight, its strongest lines with their frequencies and likely sources."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.report.figures import WIDTH, Picture, RunView, _panels, legend_above, picture, stroke
from pointing_analysis.report.line_sources import likely_source

NAMES, NAMES_OF_SEVERAL = 6, 4
"""Lines that are named in the spectrum of one run, and in that of several."""
LETTERS = 7.0
"""Size of the names [pt]."""
HEIGHT = 3.8
"""Of the picture [inch]."""
ABOVE = 0.25
"""Part of the axis that is added above the curves for the names."""
AXES = 0.8
"""Part of the picture that its axes have, about."""

Curve = tuple[RunView, FloatArray, FloatArray]
"""A run, its frequencies [Hz] and densities [mas²/Hz]."""


def mark_tones(axis: Axes, views: Sequence[RunView]) -> None:
    """Lines of all runs: those that are named dotted, those that were found dashed."""
    styles = ((False, ":", "#777777", "named lines"), (True, "--", "#b08a3c", "found lines"))
    for unnamed, dashes, colour, label in styles:
        lines = [line for view in views for line in view.tones if (line.found is not None) == unnamed]
        for i, tone in enumerate(sorted({round(line.omega / (2 * np.pi), 6) for line in lines})):
            name = label if i == 0 else "_nolegend_"
            axis.axvline(tone, color=colour, lw=0.7, ls=dashes, zorder=0, label=name)


def density(views: Sequence[RunView]) -> Picture:
    """One-sided power spectral density, both axes added."""

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        curves: list[Curve] = []
        for i, view in enumerate(views):
            if view.spectrum is not None:
                total = view.spectrum.density[1:].sum(axis=1) / RAD_PER_MAS**2
                shown = total > 0.0  # an axis without a positive value has no logarithmic scale
                frequency = view.spectrum.frequency[1:][shown]
                axis.loglog(frequency, total[shown], label=view.label, **stroke(i, len(views)))
                curves.append((view, frequency, total[shown]))
        axis.set_ylim(bottom=max(axis.get_ylim()[0], 1e-6))  # below lies rounding, no jitter
        mark_tones(axis, views)
        _name(axis, curves)
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("LOS density [mas²/Hz]")
        legend_above(figure, axis)

    named = ", ".join(text.replace("\n", " ") for *_, text in _named(views))
    alt = "Power spectral density of the line of sight against frequency on logarithmic axes"
    return picture("psd", "Error spectrum", f"{alt}; lines: {named}" if named else alt, HEIGHT, draw)


def _named(views: Sequence[RunView]) -> list[tuple[float, str]]:
    """Frequency [Hz] and name of the strongest lines of all runs, the strongest first."""
    lines = [(line, view) for view in views for line in view.tones if line.found is None or not line.found.is_sideband]
    names: dict[str, tuple[float, str]] = {}
    for line, view in sorted(lines, key=lambda pair: -pair[0].rms):
        hertz, source = line.omega / (2 * math.pi), likely_source(view, line)
        names.setdefault(f"{hertz:.4g}", (hertz, f"{hertz:.4g} Hz\n{source}".strip()))
    return list(names.values())[: NAMES if len(views) == 1 else NAMES_OF_SEVERAL]


def _highest(curves: Sequence[Curve], low: float, high: float) -> float:
    """Largest value of all curves between two frequencies; zero where there is none."""
    parts = [slice(*np.searchsorted(frequency, [low, high])) for _, frequency, _ in curves]
    inside = (total[part] for part, (*_, total) in zip(parts, curves))
    return max((float(values.max()) for values in inside if values.size), default=0.0)


def _name(axis: Axes, curves: Sequence[Curve]) -> None:
    """Names above the curves at their peaks, higher where they would cover others; the axis is as high as they need."""
    peaks = []
    for hertz, name in _named([view for view, *_ in curves]):
        height = _highest(curves, hertz - 0.5, hertz + 0.5)
        if height > 0.0:
            peaks.append((hertz, height, name))
    if not peaks:
        return
    (left, right), (low, high) = np.log10(axis.get_xlim()), np.log10(axis.get_ylim())
    high += ABOVE * (high - low)
    across, up = AXES * WIDTH * 72.0 / LETTERS, AXES * HEIGHT * 72.0 / LETTERS  # of the axes, in letters
    boxes: list[tuple[float, float, float, float]] = []
    for hertz, height, text in sorted(peaks, key=lambda peak: peak[1]):
        lines = text.split("\n")
        wide, tall = 0.65 * max(map(len, lines)) / across, 1.3 * len(lines) / up
        x = min(max((math.log10(hertz) - left) / (right - left), 0.5 * wide), 1.0 - 0.5 * wide)
        ends = (10 ** (left + (x + side * wide) * (right - left)) for side in (-0.5, 0.5))
        y = (math.log10(max(height, _highest(curves, *ends))) - low) / (high - low) + 1.0 / up
        while hit := [b for b in boxes if abs(x - b[0]) < 0.5 * (wide + b[2]) and y < b[1] + b[3] and b[1] < y + tall]:
            y = max(b[1] + b[3] for b in hit)
        boxes.append((x, y, wide, tall))
        axis.annotate(
            text,
            (hertz, height),
            (10 ** (left + x * (right - left)), 10 ** (low + y * (high - low))),
            ha="center",
            va="bottom",
            fontsize=LETTERS,
            linespacing=1.0,
            arrowprops={"arrowstyle": "-", "color": "#777777", "lw": 0.6, "shrinkA": 0, "shrinkB": 1},
        )
    axis.set_ylim(10**low, 10 ** (low + max(1.0, *(y + tall for _, y, _, tall in boxes)) * (high - low)))
    axis.set_xlim(10**left, 10**right)
