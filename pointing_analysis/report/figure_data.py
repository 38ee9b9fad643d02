"""Numbers behind a figure: the curves of its panels as one table of text."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle, StepPatch

from pointing_analysis.arrays import FloatArray

HEADS = ("panel", "curve", "x", "y")
Curve = tuple[str, FloatArray, FloatArray]


def curves_csv(figure: Figure) -> bytes:
    """Curves, steps and bars of a figure as CSV, one row for each point; empty where it has none, as a map of pixels.

    Comments above the header have title, x and y axis of each panel. A line across a panel, as a limit, has one empty
    coordinate.

    Examples
    --------
    >>> figure = Figure()
    >>> _ = figure.subplots().plot([0.0, 1.0], [2.0, 3.5], label="a")
    >>> print(curves_csv(figure).decode().splitlines())
    ['# panel 1: , x: , y: ', 'panel,curve,x,y', '1,a,0,2', '1,a,1,3.5']
    """
    panels = [axes for axes in figure.axes if axes.get_visible()]
    rows = [
        (panel, label, _text(x), _text(y))
        for panel, axes in enumerate(panels, start=1)
        for label, xs, ys in _curves(axes)
        for x, y in zip(xs.tolist(), ys.tolist())
    ]
    if not rows:
        return b""
    out = io.StringIO()
    for panel, axes in enumerate(panels, start=1):
        words = f"# panel {panel}: {axes.get_title(loc='left')}, x: {axes.get_xlabel()}, y: {axes.get_ylabel()}"
        out.write(" ".join(words.splitlines()) + "\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADS)
    writer.writerows(rows)
    return out.getvalue().encode()


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.9g}"


def _curves(axes: Axes) -> Iterator[Curve]:
    """Name, x and y of each curve."""
    for i, line in enumerate(axes.lines, start=1):
        # Points of a line; NaN for the coordinate along which it crosses the whole panel
        x, y = (np.asarray(part, dtype=float) for part in (line.get_xdata(), line.get_ydata()))
        across, along = (
            line.get_transform() == one for one in (axes.get_yaxis_transform("grid"), axes.get_xaxis_transform("grid"))
        )
        yield (
            _named(line, f"line {i}"),
            *((np.full(1, np.nan), y[:1]) if across else (x[:1], np.full(1, np.nan)) if along else (x, y)),
        )
    for i, patch in enumerate(axes.patches, start=1):
        if isinstance(patch, StepPatch):
            values, edges, _ = patch.get_data()
            yield _named(patch, f"steps {i}"), np.repeat(edges, 2)[1:-1], np.repeat(values, 2)
        elif isinstance(patch, Rectangle) and patch.get_transform().contains_branch(axes.transData):
            yield _named(patch, f"bar {i}"), np.array([patch.get_width()]), np.array([patch.get_center()[1]])
    for i, lines in enumerate(axes.collections, start=1):
        if isinstance(lines, LineCollection) and (segments := lines.get_segments()):
            ends = np.concatenate([np.asarray(segment, dtype=float) for segment in segments])
            yield _named(lines, f"strokes {i}"), ends[:, 0], ends[:, 1]


def _named(artist: Line2D | Rectangle | StepPatch | LineCollection, otherwise: str) -> str:
    label = str(artist.get_label())
    return otherwise if label.startswith("_") or not label else label
