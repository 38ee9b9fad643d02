"""Pictures of what the telescope sees as files, for documents: PNG, SVG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from lftkit.support.atomic_output import atomic_file
from pointing_analysis.report.figures import NO_PDF_METADATA, STYLE, LaidOutFigure, RunView
from pointing_analysis.report.image_figures import (
    ImageView,
    draw_ellipticity,
    draw_energy,
    draw_stars,
    draw_targets,
    draw_transfer,
    exposed_view,
    image_views,
)

Draw = Callable[[Figure, Sequence[ImageView]], None]
PICTURES: dict[str, tuple[Draw, float, float]] = {
    "star": (draw_stars, 2.15, 4.9),
    "target": (lambda figure, views: draw_targets(figure, views, len(views) + 2), 0.0, 2.0),
    "mtf": (draw_transfer, 0.0, 3.4),
    "energy": (draw_energy, 0.0, 3.4),
    "ellipticity": (draw_ellipticity, 0.0, 3.2),
}
"""Name of each file, what draws it, its width for each run or 0, its height [inch]."""
METADATA: dict[str, dict[str, None]] = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": NO_PDF_METADATA}
"""Kinds of files; metadata that would differ from run to run are left out."""
DPI = 130


def draw_pictures(views: Sequence[RunView], folder: Path) -> list[Path]:
    """Draw all pictures into a folder; returns their paths.

    Raises
    ------
    ValueError
        No run has optics and a complete exposure.
    """
    exposed = image_views(views)[0] or (exposed_view(views[0]),)  # which says why the first has none
    folder.mkdir(parents=True, exist_ok=True)
    settings: Any = {**dict(mpl.rcParamsDefault), **STYLE, "svg.hashsalt": "image"}
    paths = []
    with mpl.rc_context(settings):
        for name, (draw, each, height) in PICTURES.items():
            width = max(each * len(exposed), 2.15 if each else 4.3)
            if name == "target":
                width = 1.75 * (len(exposed) + 2)
            figure = LaidOutFigure(figsize=(width, height), layout="constrained")
            draw(figure, exposed)
            for suffix, metadata in METADATA.items():
                path = folder / f"{name}{suffix}"
                with atomic_file(path) as temporary:
                    figure.savefig(temporary, format=suffix[1:], dpi=DPI, metadata=metadata)
                paths.append(path)
    return paths
