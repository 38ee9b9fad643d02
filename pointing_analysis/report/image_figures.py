"""Pictures of what the telescope sees: a star and a test target in one exposure of each run, transfer, energy, shape.

The exposure that is shown of a run is the worst of the required part of them, by the Strehl ratio of the motion. The
axes of the pictures are the two components of the line of sight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from pointing_analysis.arrays import FloatArray
from pointing_analysis.formatting.number_text import percent
from pointing_analysis.image.motion_blur import centred, sizes, some_exposures, worst_transfer
from pointing_analysis.image.optics import METADATA, NONE_KNOWN, Optics, optics_of
from pointing_analysis.image.quality import LARGEST, encircled_energy, figures
from pointing_analysis.image.star_image import blurred, star_image
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.mapped_arrays import SortedValues
from pointing_analysis.report.figures import (
    NO_PDF_METADATA,
    STYLE,
    LaidOutFigure,
    Picture,
    RunView,
    legend_above,
    picture,
    stroke,
)
from pointing_analysis.requirements.image_samples import share
from pointing_analysis.requirements.image_summary import MOST

HALF = 10
"""Pixels on either side of the star."""
DECADES = 4.0
"""Of the logarithmic pictures."""
BAR = 200.0
"""Length of the scale bar [mas]."""
COLUMNS = 4
FREQUENCIES = 21
CURVE_EXPOSURES = 200
"""Exposures of which the curves of the transfer are made, spread over the run."""
TARGET = 320
"""Points across the test target."""
STEP = 5.0
"""Distance of its points [mas]."""


@dataclass(frozen=True)
class ImageView:
    """Data for the pictures of one run.

    Parameters
    ----------
    label : of the run
    optics : Optics
    paths : (m, N + 1, 2) exposures [rad]
    time : (m,) of their starts [s]
    strehl, ellipticity : (m,)
    part : of the exposures, that the pictures hold for
    """

    label: str
    optics: Optics
    paths: FloatArray
    time: FloatArray
    strehl: FloatArray
    ellipticity: FloatArray
    part: float

    @cached_property
    def _chosen(self) -> int:
        order = np.lexsort((-sizes(self.paths), self.strehl))
        return int(order[len(order) - 1 - SortedValues(self.strehl).rank(self.part)])  # that of the verdict

    @property
    def shown(self) -> FloatArray:
        """The exposure that is shown (1, N + 1, 2), about its mean."""
        return centred(self.paths[[self._chosen]])

    @property
    def shown_strehl(self) -> float:
        """Its Strehl ratio."""
        return float(self.strehl[self._chosen])

    @property
    def strehl_text(self) -> str:
        """The same in words."""
        return f"Strehl {self.shown_strehl:.2f}" if self.shown_strehl else "Strehl near 0"

    @property
    def near(self) -> bool:
        """Whether the motion of the exposure that is shown is small enough for integrals over frequencies."""
        return bool(2 * math.pi * self.optics.cutoff * sizes(self.shown)[0] <= LARGEST)


def exposed_view(view: RunView) -> ImageView:
    """Exposures of a run.

    Raises
    ------
    ValueError
        Its optics are not known, its window is no exposure, or it has no complete one.
    """
    optics = optics_of(view.run)
    if optics is None:
        raise InputError(NONE_KNOWN)
    paths, index = some_exposures(view.series.values, view.series.dt, view.window, MOST)
    if not len(paths):
        raise InputError(f"{view.label}: the run must have an exposure without a missing sample, got none")
    values = figures(paths, optics, ("strehl", "ellipticity"))
    time = np.asarray(view.series.start + view.window * index)
    return ImageView(view.label, optics, paths, time, values["strehl"], values["ellipticity"], view.image_part)


def image_views(views: Sequence[RunView]) -> tuple[tuple[ImageView, ...], tuple[str, ...]]:
    """Those of the runs whose optics are known, and a sentence on each that names optics and has none."""
    exposed, missing = [], []
    for view in views:
        if METADATA in view.run.parameters:
            try:
                exposed.append(exposed_view(view))
            except InputError as error:
                missing.append(f"No images for {view.label}: {error}.")
    return tuple(exposed), tuple(missing)


def _still(view: ImageView) -> FloatArray:
    return np.zeros_like(view.shown)


def draw_stars(figure: Figure, views: Sequence[ImageView], columns: int = COLUMNS) -> None:
    """Star on the pixels in each run, linear above and logarithmic below, all on the same scale."""
    count = min(columns, len(views))
    blocks = -(-len(views) // count)
    axes = figure.subplots(2 * blocks, count, squeeze=False)
    images = [star_image(view.shown, view.optics, half=HALF) for view in views]
    top = max(float(star_image(_still(v), v.optics, half=1).max()) for v in views)
    for axis in axes.ravel():
        axis.set_visible(False)
    for i, (view, image) in enumerate(zip(views, images)):
        row, column = 2 * (i // count), i % count
        pixel = view.optics.pixel / RAD_PER_MAS
        side = (HALF + 0.5) * pixel
        for axis, log in ((axes[row, column], False), (axes[row + 1, column], True)):
            axis.set_visible(True)
            norm = {"norm": LogNorm(top * 10**-DECADES, top)} if log else {"vmin": 0.0, "vmax": top}
            shown = np.maximum(image, top * 10**-DECADES) if log else image
            extent = (-side, side, -side, side)
            axis.imshow(shown, origin="lower", extent=extent, cmap="inferno", interpolation="none", **norm)
            # Borders of the pixels, no ticks
            axis.grid(False)
            borders = np.arange(-HALF - 0.5, HALF + 1.0) * pixel
            axis.vlines(borders, -side, side, color="#ffffff", lw=0.2, alpha=0.25)
            axis.hlines(borders, -side, side, color="#ffffff", lw=0.2, alpha=0.25)
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_xlim(-side, side)
            axis.set_ylim(-side, side)
        path = view.shown[0] / RAD_PER_MAS
        axes[row, column].plot(path[:, 0], path[:, 1], color="#7fd3ff", lw=0.6, scalex=False, scaley=False)
        axes[row, column].set_title(f"{view.label}\n{view.strehl_text}")
        if i == 0:
            _scale_bar(axes[row, column], side)
    axes[0, 0].set_ylabel("linear")
    axes[1, 0].set_ylabel(f"log, {DECADES:g} decades")


def _scale_bar(axis: Axes, side: float, left: float | None = None) -> None:
    left, low = -0.9 * side if left is None else left, -0.88 * side
    axis.plot([left, left + BAR], [low, low], color="#ffffff", lw=1.6)
    axis.text(left + BAR / 2, low + 0.05 * side, f"{BAR:g} mas", color="#ffffff", fontsize=6, ha="center")


def stars(views: Sequence[ImageView]) -> Picture | None:
    """Star on the pixels, run by run."""
    if not views:
        return None
    blocks = -(-len(views) // COLUMNS)
    worst = f"in the worst exposure of {percent(views[0].part, 10)}"
    alt = f"Star on the pixels of the detector {worst}; {views[0].optics.text}: "
    alt += "; ".join(f"{v.label}: {v.strehl_text}" for v in views)
    height = 2.3 * blocks * max(1.0, 2.0 / min(len(views), COLUMNS)) + 0.4
    return picture("star", "Star as the detector sees it", alt, height, lambda figure: draw_stars(figure, views))


def transfer_curve(view: ImageView, frequencies: FloatArray) -> FloatArray:
    """Transfer of the motion along the worst direction that the part of the exposures is above: (f,)."""
    some = view.paths[np.unique(np.linspace(0, len(view.paths) - 1, min(CURVE_EXPOSURES, len(view.paths))).astype(int))]
    return np.array([share(worst_transfer(some, float(f))[0], view.part, lower=True) for f in frequencies])


def draw_transfer(figure: Figure, views: Sequence[ImageView]) -> None:
    """Transfer of the whole: aperture, pixel and motion; without motion dashed."""
    axis = figure.subplots()
    optics = views[0].optics
    line: FloatArray = np.asarray(np.linspace(0.0, 1.0, FREQUENCIES) * optics.cutoff, dtype=float)
    along = np.column_stack([line, np.zeros(len(line))])
    still = np.abs(optics.diffraction(along) * optics.detector(along))
    scale = 1000 * RAD_PER_MAS
    for i, view in enumerate(views):
        axis.plot(line * scale, still * transfer_curve(view, line), label=view.label, **stroke(i, len(views)))
    axis.plot(line * scale, still, color="#555555", ls="--", label="without motion")
    axis.axvline(optics.nyquist * scale, color="#555555", ls=":", lw=0.9, label="Nyquist")
    axis.set_ylim(0.0, 1.02)
    axis.set_xlim(0.0, float(line[-1]) * scale)
    axis.set_xlabel("spatial frequency [cycles/arcsec]")
    axis.set_ylabel(f"MTF, {percent(views[0].part, 10)} of the exposures above")
    legend_above(figure, axis)


def transfers(views: Sequence[ImageView]) -> Picture | None:
    """Modulation transfer with and without motion."""
    if not views:
        return None
    alt = "Modulation transfer of aperture, pixel and motion over spatial frequency, with motion and without"
    return picture("mtf", "Modulation transfer", alt, 3.4, lambda figure: draw_transfer(figure, views))


def draw_energy(figure: Figure, views: Sequence[ImageView]) -> None:
    """Energy within a radius of the exposure that is shown; without motion dashed."""
    axis = figure.subplots()
    optics = views[0].optics
    radii: FloatArray = np.asarray(np.linspace(0.0, 5.0, 101) * optics.resolution, dtype=float)
    for i, view in enumerate(views):
        if view.near:
            energy = encircled_energy(view.shown, view.optics, radii)
            axis.plot(radii / RAD_PER_MAS, energy, label=view.label, **stroke(i, len(views)))
    still = encircled_energy(_still(views[0]), optics, radii)
    axis.plot(radii / RAD_PER_MAS, still, color="#555555", ls="--", label="without motion")
    axis.axhline(0.8, color="#555555", ls=":", lw=0.9, label="80 %")
    axis.set_ylim(0.0, 1.0)
    axis.set_xlim(0.0, float(radii[-1]) / RAD_PER_MAS)
    axis.set_xlabel("radius [mas]")
    axis.set_ylabel("energy within")
    legend_above(figure, axis)


def energies(views: Sequence[ImageView]) -> Picture | None:
    """Encircled energy."""
    if not views:
        return None
    alt = "Energy of the star's image within each radius, with motion and without"
    return picture("energy", "Encircled energy", alt, 3.4, lambda figure: draw_energy(figure, views))


def draw_ellipticity(figure: Figure, views: Sequence[ImageView]) -> None:
    """Absolute ellipticity of each exposure over time."""
    axis = figure.subplots()
    for i, view in enumerate(views):
        style = {key: value for key, value in stroke(i, len(views)).items() if key != "linewidth"}
        axis.plot(view.time, np.maximum(view.ellipticity, 1e-5), ".", ms=2.2, label=view.label, **style)
    axis.set_yscale("log")
    axis.set_ylim(top=1.2)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("ellipticity of an exposure")
    legend_above(figure, axis)


def ellipticities(views: Sequence[ImageView]) -> Picture | None:
    """Ellipticity over the exposures."""
    if not views:
        return None
    sigma = views[0].optics.moment_weight / RAD_PER_MAS
    alt = f"Absolute ellipticity of each exposure over time, Gaussian weight of {sigma:.3g} mas: " + "; ".join(
        f"{v.label} median {np.median(v.ellipticity):.2g}" for v in views
    )
    return picture("ellipticity", "Ellipticity of the exposures", alt, 3.2, lambda f: draw_ellipticity(f, views))


def siemens_star(points: int = TARGET) -> FloatArray:
    """Siemens star of 12 sectors with groups of bars in the corners, white 1 on black 0: (points, points).

    The bars have periods of 90, 120, 160 and 200 mas.
    """
    line = np.arange(points) - (points - 1) / 2
    x, y = np.meshgrid(line, line)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    star = (np.sin(12 * angle) > 0) & (radius < 0.33 * points)
    for k, mas in enumerate((90.0, 120.0, 160.0, 200.0)):
        period = mas / STEP
        cx, cy = (-1 if k % 2 else 1) * 0.33 * points, (-1 if k // 2 else 1) * 0.42 * points
        here = (np.abs(x - cx) < 1.25 * period) & (np.abs(y - cy) < 0.06 * points)
        star = np.where(here, np.mod(x - cx + 0.25 * period, period) < 0.5 * period, star)
    return np.asarray(star, dtype=float)


def draw_targets(figure: Figure, views: Sequence[ImageView], columns: int = 3) -> None:
    """The test target: as it is, without motion, and in the exposure that is shown of each run."""
    target, step = siemens_star(), STEP * RAD_PER_MAS
    images = [("target", target), ("without motion", blurred(target, step, _still(views[0]), views[0].optics))]
    images += [(view.label, blurred(target, step, view.shown, view.optics)) for view in views]
    rows = -(-len(images) // columns)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(images) :]:
        axis.set_visible(False)
    side = TARGET * STEP / 2
    for axis, (name, image) in zip(axes, images):
        axis.imshow(
            image,
            origin="lower",
            extent=(-side, side, -side, side),
            cmap="gray",
            vmin=0.0,
            vmax=1.0,
            interpolation="none",
        )
        axis.grid(False)
        axis.set_xticks([])
        axis.set_yticks([])
        axis.set_title(name)
    _scale_bar(axes[0], side, -BAR / 2)


def targets(views: Sequence[ImageView]) -> Picture | None:
    """Test target through aperture, pixel and motion."""
    if not views:
        return None
    alt = "Siemens star and bars as they are, without motion, and in one exposure of each run"
    height = 1.65 * -(-(len(views) + 2) // 3) + 0.2
    return picture("target", "Test target", alt, height, lambda figure: draw_targets(figure, views))


Draw = Callable[[Figure, Sequence[ImageView]], None]
FILES: dict[str, tuple[Draw, float, float]] = {
    "star": (draw_stars, 2.15, 4.9),
    "target": (lambda figure, views: draw_targets(figure, views, len(views) + 2), 0.0, 2.0),
    "mtf": (draw_transfer, 0.0, 3.4),
    "energy": (draw_energy, 0.0, 3.4),
    "ellipticity": (draw_ellipticity, 0.0, 3.2),
}
"""Name of each file, what draws it, its width for each run or 0, its height [inch]."""
KINDS: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": NO_PDF_METADATA,
}
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
        for name, (draw, each, height) in FILES.items():
            width = max(each * len(exposed), 2.15 if each else 4.3)
            if name == "target":
                width = 1.75 * (len(exposed) + 2)
            figure = LaidOutFigure(figsize=(width, height), layout="constrained")
            draw(figure, exposed)
            for suffix, metadata in KINDS.items():
                path = folder / f"{name}{suffix}"
                with atomic_file(path) as temporary:
                    figure.savefig(temporary, format=suffix[1:], dpi=DPI, metadata=metadata)
                paths.append(path)
    return paths
