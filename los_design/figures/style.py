"""Look of the figures, the files they are written to, and what their axes share."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from lftkit.support.atomic_output import atomic_file

BLUE, ORANGE, LIMIT = "#0b5d8a", "#d95f02", "#b00020"
FORMATS = ("png", "svg")
STAGE_STYLES = {
    "none": ("payload hard-mounted", "#444444"),
    "isolator": ("isolator", "#2a9d4a"),
    "fsm": ("isolator + FSM", "#c2308f"),
    "fsm+pma": ("isolator + FSM + PMA", "#1f5fa8"),
}
"""Stage to its label and colour, those of the paper: black, green, magenta, blue."""
STYLE: dict[str, Any] = {
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e2e2e2",
    "grid.linewidth": 0.6,
    "axes.edgecolor": "#777777",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.3,
}
"""Settings of matplotlib."""


def save_figure(figure: Figure, stem: Path, formats: Sequence[str] = FORMATS, *, dpi: int = 115) -> list[Path]:
    """Write a picture in each of the formats (PNG, SVG), the same bytes every time; returns the paths.

    None of the files is there if one of them cannot be written.
    """
    paths = [stem.with_suffix(f".{name}") for name in formats]
    metadata = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}
    with mpl.rc_context({"svg.hashsalt": stem.name}), contextlib.ExitStack() as files:
        for name, path in zip(formats, paths):
            file = files.enter_context(atomic_file(path))
            figure.savefig(file, format=name, dpi=dpi, metadata=metadata[name])
    return paths


def hertz(omega: Any) -> Any:
    """Frequency [Hz] of an angular frequency [rad/s]."""
    return omega / (2.0 * math.pi)


def radians(frequency: Any) -> Any:
    """Angular frequency [rad/s] of a frequency [Hz]."""
    return 2.0 * math.pi * frequency
