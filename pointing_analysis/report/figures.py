"""Figures of the report: one function per figure; the same run gives the same SVG byte for byte."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS, ErrorSeries
from pointing_analysis.read.mapped_arrays import SortedValues, by_parts, parts, release
from pointing_analysis.read.recording import Recording
from pointing_analysis.report.figure_data import curves_csv
from pointing_analysis.requirements.exposure import USUAL_PROBABILITY
from pointing_analysis.requirements.requirement import Requirement, time_text
from pointing_analysis.spectra.spectra import SpectralLine, Spectrum

COLOURS = ("#0b5d8a", "#c25a00", "#3b7a3b", "#8a3b7a", "#6b6b00", "#444444")
LIMIT = "#b00020"
SMALLEST_LINE = 1e-3
"""Smallest disturbance line in the picture of all runs [mas rms]: what is below are digits of the recording."""
LOADS = {"fsm/command": "mirror", "pma/command": "forces"}
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
WIDTH = 4.3  # [inch]; small, so that lettering stays readable on a telephone
STYLE: dict[str, Any] = {
    "svg.hashsalt": "pointing_analysis",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.edgecolor": "#777777",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.0,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}
NO_PDF_METADATA = {"CreationDate": None, "Creator": None, "Producer": None}
"""Without entries that differ between runs."""


@dataclass(frozen=True)
class RunView:
    """All that the pictures of one run need."""

    label: str
    run: Recording
    series: ErrorSeries
    spectrum: Spectrum | None
    tones: tuple[SpectralLine, ...]
    """Lines above the noise."""
    window: float
    within_noise: tuple[SpectralLine, ...] = ()
    """Lines that the recording names and that the run does not show."""
    without_spectrum: str = ""
    """Why there is no spectrum; empty where there is one."""
    image_part: float = USUAL_PROBABILITY
    """Part of the exposures that keeps the figures of a star's image."""


def windows_text(views: Sequence[RunView]) -> str:
    """Windows of the relative error of runs that are shown together; usually one."""
    return ", ".join(dict.fromkeys(time_text(view.window) for view in views))


@dataclass(frozen=True)
class Picture:
    """One picture with its caption and the text for those who cannot see it."""

    name: str
    title: str
    alt: str
    svg: bytes
    height: float = 0.0
    draw: Callable[[Figure], None] | None = field(default=None, compare=False, repr=False)

    def pdf(self) -> bytes:
        """The same picture as a PDF with its letters as text.

        Raises
        ------
        ValueError
            It was not made by :func:`picture`.
        """
        if self.draw is None:
            raise InputError(f"{self.name} must be a picture that can be drawn again, got its SVG alone")
        return _drawn(self.name, self.height, self.draw, partial(_saved, kind="pdf", metadata=NO_PDF_METADATA))

    def csv(self) -> bytes:
        """Its curves, see `curves_csv`; empty where it has none or was not made by :func:`picture`."""
        return b"" if self.draw is None else _drawn(self.name, self.height, self.draw, curves_csv)


class LaidOutFigure(Figure):
    """A figure that is drawn once: to lay it out, matplotlib would draw all of it a first time into nothing.

    What stands around each pair of axes is measured once: matplotlib would do so again where it has moved them.
    """

    def draw(self, renderer: RendererBase) -> None:
        """Lay the figure out where it has yet to be done, else draw it."""
        engine = self.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):  # while it is saved it has none, once it is laid out
            for axes in self.axes:
                axes.get_tightbbox = _measured_once(axes)  # type: ignore[method-assign]
            engine.execute(self)
        else:
            super().draw(renderer)


def _measured_once(axes: Axes) -> Callable[..., Bbox | None]:
    """The box around axes and their lettering; from the second time on with the margins of the first."""
    measure, margins = axes.get_tightbbox, list[FloatArray]()

    def box(*arguments: Any, **options: Any) -> Bbox | None:
        if not margins:
            measured = measure(*arguments, **options)
            if measured is None:
                return None
            margins.append(measured.get_points() - axes.bbox.get_points())
        return Bbox(axes.bbox.get_points() + margins[0])

    return box


def _power_of_ten(value: float, _: object = None) -> str:
    """Label of a decade in plain letters, which are laid out in a tenth of the time of a formula.

    Examples
    --------
    >>> _power_of_ten(1e-12), _power_of_ten(100.0), _power_of_ten(20.0)
    ('10⁻¹²', '10²', '')
    """
    exponent = round(math.log10(value)) if value > 0.0 else 0
    exact = value > 0.0 and math.isclose(value, 10.0**exponent, rel_tol=1e-6)
    return "10" + str(exponent).translate(_RAISED) if exact else ""


def _saved(figure: Figure, kind: str, metadata: Mapping[str, None]) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, metadata=metadata)
    return buffer.getvalue()


def _drawn(name: str, height: float, draw: Callable[[Figure], None], save: Callable[[Figure], bytes]) -> bytes:
    settings: dict[Any, Any] = {**dict(mpl.rcParamsDefault), **STYLE, "svg.hashsalt": name}
    with mpl.rc_context(settings):
        figure = LaidOutFigure(figsize=(WIDTH, height), layout="constrained")
        draw(figure)
        # Plain letters on logarithmic axes that span more than a decade; below, minor ticks have labels, too
        for axes in figure.axes:
            for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
                usual = type(axis.get_major_formatter()) is LogFormatterSciNotation and min(low, high) > 0.0
                if usual and abs(math.log10(high / low)) > 2.0:
                    axis.set_major_formatter(FuncFormatter(_power_of_ten))
                    axis.set_minor_formatter(NullFormatter())
        return save(figure)


def picture(name: str, title: str, alt: str, height: float, draw: Callable[[Figure], None]) -> Picture:
    """Draw one picture in the style of the report, `height` [inch]; `draw` fills an empty figure, each time alike."""
    save = partial(_saved, kind="svg", metadata={"Date": None, "Creator": None})
    return Picture(name, title, alt, _drawn(name, height, draw, save), height, draw)


def envelope(time: FloatArray, values: FloatArray, points: int = 700) -> tuple[FloatArray, FloatArray]:
    """Reduce a long signal to the smallest and largest value of each piece, so that no peak is lost."""
    n = len(values) // points
    if n < 3:
        return time, values
    m = len(values) // n
    low, high = np.empty(m), np.empty(m)
    for i in range(m):
        low[i], high[i] = (reduce(values[i * n : i * n + n]) for reduce in (np.fmin.reduce, np.fmax.reduce))
        release()
    t = np.array(time[: m * n : n])
    return np.repeat(t, 2), np.column_stack([low, high]).ravel()


def _is_any(values: FloatArray) -> bool:
    """Whether any value is not zero."""
    return any(np.any(values[part]) for part in parts(len(values)))


def _greatest(values: FloatArray) -> float:
    """Largest value, NaN left out."""
    return float(np.nanmax([np.fmax.reduce(values[part]) for part in parts(len(values))]))


def _largest(view: RunView) -> float:
    """Largest error of a run [rad], norm of both axes."""
    return _greatest(metrics.radial(view.series.values))


def legend_above(figure: Figure, axis: Axes) -> None:
    """Legend above the picture, in at most three columns that fit its width: it never covers a curve."""
    handles, names = axis.get_legend_handles_labels()
    options: dict[str, Any] = {"loc": "outside upper left", "handlelength": 1.6, "columnspacing": 1.2}
    for columns in (3, 2, 1) if handles else ():
        legend = figure.legend(handles, names, ncols=columns, **options)
        if legend.get_window_extent().width <= figure.bbox.width:
            return
        if columns > 1:
            legend.remove()


def stroke(i: int, runs: int) -> dict[str, Any]:
    """Colour, width, gid of a run's curve: later ones are thinner, so that one that lies on another hides nothing."""
    return {"color": COLOURS[i % 6], "linewidth": 0.9 + 0.45 * (runs - 1 - i), "gid": f"run-{i}"}


def _panels(figure: Figure, n: int, columns: int = 1, **options: Any) -> list[Axes]:
    rows = -(-n // columns)
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    axes = list(grid.ravel())
    for spare in axes[n:]:
        spare.set_visible(False)
    return axes[:n]


def _few_decades(axis: Axes) -> None:
    """Readable ticks on a logarithmic x axis, also where it spans less than two decades."""
    axis.xaxis.set_minor_formatter(NullFormatter())
    low, high = axis.get_xlim()
    if high < 100 * low:
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter("{x:g}")


def time_history(views: Sequence[RunView]) -> Picture:
    """Both axes of the line of sight over time, one panel per run; the smaller one in front."""

    def draw(figure: Figure) -> None:
        axes = _panels(figure, len(views), sharex=True)
        for k, (axis, view) in enumerate(zip(axes, views)):
            axis.set_gid(f"run-{k}")
            arcsec = by_parts(lambda rows: rows / RAD_PER_ARCSEC, view.series.values)
            curves = [envelope(view.series.time, arcsec[:, i]) for i in range(len(metrics.AXES))]
            front = min(range(len(curves)), key=lambda i: float(np.fmax.reduce(np.abs(curves[i][1]), initial=0.0)))
            for i, (name, (t, y)) in enumerate(zip(metrics.AXES, curves)):
                axis.plot(t, y, color=COLOURS[i], label=f"LOS {name}", linewidth=0.8, zorder=2.1 if i == front else 2)
            axis.set_title(view.label)
            axis.set_ylabel("LOS error [arcsec]" if len(views) == 1 else "LOS [arcsec]")
        legend_above(figure, axes[0])
        axes[-1].set_xlabel("time [s]")

    alt = "Line-of-sight error of both axes in arcseconds over time: " + "; ".join(
        f"{v.label} reaches {_largest(v) / RAD_PER_ARCSEC:.3g} arcsec" for v in views
    )
    return picture("time", "Line of sight over time", alt, max(3.8, 0.9 + 1.1 * len(views)), draw)


def trajectory(views: Sequence[RunView], requirements: Sequence[Requirement]) -> Picture:
    """Path of the line of sight in the focal plane, the circle that holds it and that of the smallest APE limit."""
    limits = [(r.limit / RAD_PER_ARCSEC, r.probability) for r in requirements if r.index == "APE" and not r.axis]
    limit, probability = min(limits, default=(math.inf, 0.0))

    def draw(figure: Figure) -> None:
        axes = _panels(figure, len(views), columns=min(2, len(views)))
        for k, (axis, view) in enumerate(zip(axes, views)):
            axis.set_gid(f"run-{k}")
            arcsec = _largest(view) / RAD_PER_ARCSEC
            unit, scale = ("arcsec", RAD_PER_ARCSEC) if arcsec >= 0.1 else ("mas", RAD_PER_MAS)
            step = max(1, len(view.series.values) // 3000)
            e = np.array(view.series.values[::step]) / scale
            release()
            largest = arcsec * RAD_PER_ARCSEC / scale
            axis.plot(e[:, 0], e[:, 1], color=COLOURS[0], linewidth=0.5)
            angle = np.linspace(0, 2 * np.pi, 181)
            axis.plot(largest * np.cos(angle), largest * np.sin(angle), color="#555555", label="largest error")
            if limit < 4 * arcsec:
                radius, text = limit * RAD_PER_ARCSEC / scale, f"limit {limit:.6g} arcsec for {100 * probability:.6g} %"
                axis.plot(radius * np.cos(angle), radius * np.sin(angle), color=LIMIT, ls="--", label=text)
            axis.set_aspect("equal", adjustable="datalim")
            axis.set_title(f"{view.label}\nlargest {largest:.3g} {unit}")
            axis.set_xlabel(f"LOS x [{unit}]")
            axis.set_ylabel(f"LOS y [{unit}]")
            for one in (axis.xaxis, axis.yaxis):
                one.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        legend_above(figure, max(axes, key=lambda a: len(a.get_lines())))

    alt = "Path of the line of sight in the plane of both axes, with its smallest enclosing circle about zero"
    rows = -(-len(views) // 2)
    return picture("trajectory", "Trajectory and its circle", alt, 4.8 if len(views) == 1 else 0.3 + 2.9 * rows, draw)


def by_line(views: Sequence[RunView], model: Mapping[str, tuple[FloatArray, FloatArray]]) -> Picture | None:
    """LOS rms at each disturbance line, run by run, with those of a given model."""
    shown = [v for v in views if v.tones]
    if len(views) < 2 or not shown:
        return None

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        for i, view in enumerate(views):
            tones = sorted(view.tones, key=lambda line: line.omega)
            hertz = [line.omega / (2 * np.pi) for line in tones]
            rms = [line.rms / RAD_PER_MAS for line in tones]
            axis.loglog(
                hertz,
                rms,
                "os^Dvx"[i % 6],
                ms=7 - i % 4,
                mfc="none",
                color=COLOURS[i % 6],
                label=view.label,
                gid=f"run-{i}",
            )
            if view.label in model:
                omega, expected = (np.asarray(x, dtype=float) for x in model[view.label])
                axis.loglog(
                    omega / (2 * np.pi),
                    expected / RAD_PER_MAS,
                    "+",
                    ms=11,
                    mew=0.9,
                    color=COLOURS[i % 6],
                    gid=f"run-{i}",
                )
        if model:
            axis.plot([], [], "+", ms=9, color="#555555", label="model, no noise")
        axis.set_ylim(bottom=max(axis.get_ylim()[0], SMALLEST_LINE))
        _few_decades(axis)
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("LOS rms at the line [mas]")
        legend_above(figure, axis)

    alt = "Line-of-sight rms at each disturbance line, run by run: transmission of each line by every stage"
    return picture("lines-by-run", "Disturbance lines, run by run", alt, 3.6, draw)


def commands(views: Sequence[RunView], authority: dict[str, float]) -> Picture | None:
    """Commands of mirror and proof-mass actuators as a share of their authority; none where all of them are zero."""
    shown = [(v, [n for n in authority if n in v.run and _is_any(v.run[n].values)]) for v in views]
    shown = [(v, names) for v, names in shown if names]
    if not shown:
        return None
    peaks: dict[tuple[str, str], str] = {}

    def draw(figure: Figure) -> None:
        axes = _panels(figure, len(shown), sharex=True)
        for axis, (view, names) in zip(axes, shown):
            for i, name in enumerate(names):
                topic = view.run[name]
                columns = topic.values[:, :2] if name == "fsm/command" else topic.values
                size = by_parts(lambda rows: np.abs(rows).max(axis=1), columns)
                t, y = envelope(topic.time, size)
                y, peak = 100 * y / authority[name], 100 * _greatest(size) / authority[name]
                peaks[view.label, name] = f"{view.label} {name} peaks at {peak:.3g} %"
                label = f"{LOADS.get(name, name)}, peak {peak:.3g} %"
                axis.plot(t, y, color=COLOURS[i], lw=0.8, label=label)
            axis.axhline(100, color=LIMIT, ls="--", lw=0.9)
            axis.set_yscale("symlog", linthresh=1.0)
            axis.set_ylim(0, 700)
            axis.set_yticks([0, 1, 10, 100], ["0", "1", "10", "100"])
            axis.set_ylabel("% of authority")
            axis.set_title(view.label)
            axis.legend(loc="upper right", ncols=2, fontsize=7.5, borderaxespad=0.1)
        axes[-1].set_xlabel("time [s]")

    made = picture("commands", "Commands against their authority", "", 1.2 + 1.4 * len(shown), draw)
    alt = "Commands as a percentage of the actuators' authority over time: " + "; ".join(peaks.values())
    return replace(made, alt=alt)


def timing(histograms: Sequence[tuple[str, FloatArray]], title: str, label: str) -> Picture | None:
    """Histogram of times in microseconds, logarithmic counts."""
    data = [(name, values) for name, values in histograms if values.size]
    if not data:
        return None
    ranked = [SortedValues(values) for _, values in data]

    def draw(figure: Figure) -> None:
        axis = _panels(figure, 1)[0]
        low = min(float(v.at(0)[0]) for v in ranked)
        high = max(v.quantile(0.9999) for v in ranked)
        edges = np.linspace(low, max(high, low + 1), 61)
        for i, (name, values) in enumerate(data):
            pieces = (values[part] for part in parts(len(values)))
            counts = sum(np.histogram(np.minimum(piece, edges[-1]), bins=edges)[0] for piece in pieces)
            axis.stairs(counts, edges, color=COLOURS[i % 6], label=name)
        axis.set_yscale("log")
        axis.set_xlabel(label)
        axis.set_ylabel("ticks")
        legend_above(figure, axis)

    alt = f"{title}: " + "; ".join(
        f"{name} median {v.quantile(0.5):.0f}, 99.9 % {v.quantile(0.999):.0f} microseconds"
        for (name, _), v in zip(data, ranked)
    )
    return picture("timing-" + label.split()[0], title, alt, 3.2, draw)
