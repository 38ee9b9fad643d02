"""Pictures of how micro-vibrations reach the line of sight: those of the paper's analysis of the open plant.

The same parameter file gives the same files byte for byte. What is computed:
:mod:`titop_plant.disturbances.responses`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_design.figures.style import BLUE, LIMIT, ORANGE, STYLE, hertz, radians, save_figure
from pointing_analysis.report.figures import LaidOutFigure
from titop_plant.disturbances.drive_lines import fixed_lines, stepper_lines
from titop_plant.disturbances.responses import (
    ALL,
    ARCSEC,
    DRIVES,
    WHEELS,
    DisturbanceResponses,
    disturbance_responses,
)
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.layout import speed_names
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight

MEMBERS = 20
"""Random members of the family behind a shaded band."""

STEPS = 48
"""Steps of a swept parameter; a multiple of 6."""


def draw_figures(output: str | Path, parameters: str | None = None, names: Sequence[str] | None = None) -> list[Path]:
    """Draw pictures, each as PNG and SVG.

    Parameters
    ----------
    output : path
        Folder; made if it is not there, files of the same name are replaced.
    parameters : str, optional
        Parameter file; default: the reference telescope.
    names : sequence of str, optional
        Some of :data:`FIGURES` and :data:`OF_MECHANISMS`; default: all. That of turning arrays is left out where none
        turns, that of bearings where all wheels are rigid, that of steppers where no drive has one.

    Returns
    -------
    list of Path

    Raises
    ------
    ValueError
        An unknown picture, a folder that cannot be made, a parameter file that cannot be read.
    """
    for name in names or ():
        if name not in {**FIGURES, **OF_MECHANISMS}:
            raise InputError(f"unknown picture {name!r}, expected one of: {', '.join((*FIGURES, *OF_MECHANISMS))}")
    both = disturbance_responses(load_telescope(parameters))
    folder = Path(output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}") from None
    known = {**FIGURES, **OF_MECHANISMS}
    possible = {
        "arrays_turn": both.telescope.arrays_turn,
        "wheels_speed_up": any(wheel.varies for wheel in both.telescope.wheels),
        "bearings": both.telescope.on_bearings,
        "steppers": bool(both.telescope.motors),
    }
    drawn = [name for name in names or known if possible.get(name, True)]
    return [path for name in drawn for path in _saved(folder, name, *known[name], both)]


def _saved(
    folder: Path,
    name: str,
    height: float,
    draw: Callable[[Figure, DisturbanceResponses], None],
    both: DisturbanceResponses,
) -> list[Path]:
    settings: dict[Any, Any] = {**dict(mpl.rcParamsDefault), **STYLE}
    with mpl.rc_context(settings):
        figure = LaidOutFigure(figsize=(7.4, height), layout="constrained")
        draw(figure, both)
        return save_figure(figure, folder / name, dpi=130)


def _wheels_and_drives(figure: Figure, both: DisturbanceResponses) -> None:
    axis = figure.subplots()
    edges = _columns(1e-3, 1e4, 400)
    wheels, drives = len(both.telescope.turning_wheels), len(both.telescope.driven_arrays)
    for inputs, colour, name, count in ((WHEELS, BLUE, "wheel", wheels), (DRIVES, ORANGE, "array drive", drives)):
        if count:
            # A number of things in words: "four wheels"
            word = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}.get(count, str(count))
            _banded(axis, both, both.isolated, inputs, edges, colour, f"{word} {name}{'s' if count > 1 else ''}")
    # Reach of the mirror, APE limit and both RPE templates
    telescope = both.telescope
    weights, mirror = telescope.weights, telescope.fsm
    reach = mirror.authority * mirror.los_sensitivity / ARCSEC
    ape = weights.ape_limit / ARCSEC
    axis.axhline(reach, color="#333333", linestyle=(0, (1, 1.5)), label=f"reach of the mirror, {reach:.0f} arcsec")
    axis.axhline(ape, color=LIMIT, linestyle="--", label=f"APE limit, {ape:.3g} arcsec")
    _templates(axis, telescope, edges)
    _decorate(axis, edges, (1e-6, 1e3))
    _legend(figure)


def _isolator(figure: Figure, both: DisturbanceResponses) -> None:
    axis = figure.subplots()
    edges = _columns(10.0, 1e4, 400)
    for system, colour, name in ((both.hard, ORANGE, "hard mounted"), (both.isolated, BLUE, "on the isolator")):
        _banded(axis, both, system, ALL, edges, colour, name)
    _templates(axis, both.telescope, edges)
    _decorate(axis, edges, (1e-5, 5.0))
    _legend(figure)


def _bearings(figure: Figure, both: DisturbanceResponses) -> None:
    axis = figure.subplots()
    edges = _columns(10.0, 1e4, 400)
    ranges = _speed_ranges(both)
    speeds = {name: default for name, (_, _, default) in ranges.items()}
    slow = {name: min(max(low, 0.0), high) for name, (low, high, _) in ranges.items()}
    fast = {name: max(low, high, key=abs) for name, (low, high, _) in ranges.items()}
    rigid, grey = both.with_rigid_wheels(), "#777777"
    for system, values, colour, name in (
        (rigid, speeds, grey, "rigid wheels"),
        (both.isolated, slow, BLUE, f"on bearings, {'lowest speeds' if any(slow.values()) else 'at rest'}"),
        (both.isolated, speeds, ORANGE, "on bearings, default speeds"),
        (both.isolated, fast, LIMIT, "on bearings, highest speeds"),
    ):
        curve = both.weighted(system, values, WHEELS, edges[0], edges[-1])
        axis.loglog(curve.omega, curve.size, color=colour, label=name, linewidth=2.0 if colour == grey else 1.0)
    _decorate(axis, edges, (1e-5, 5.0))
    _legend(figure, columns=2)


def _steppers(figure: Figure, both: DisturbanceResponses) -> None:
    axis, edges = figure.subplots(), _columns(1e-2, 1e4, 400)
    fixed, stepper = fixed_lines(both.telescope), stepper_lines(both.telescope)
    for lines, colour, name, marker in (
        (fixed, "#777777", "five fixed harmonics of [sadm]", "s"),
        (stepper, BLUE, "stepper, gearbox and rotor", "o"),
    ):
        axis.vlines(lines.omega, 1e-12, lines.size / ARCSEC, color=colour, linewidth=0.8)
        axis.loglog(lines.omega, lines.size / ARCSEC, marker, color=colour, label=name, markersize=3.5)
    _templates(axis, both.telescope, edges)
    _decorate(axis, edges, (1e-9, 10.0))
    axis.set_ylabel("amplitude of the line of sight [arcsec]")
    _legend(figure, columns=2)


def _arrays_turn(figure: Figure, both: DisturbanceResponses) -> None:
    reach = next(array for array in both.telescope.solar_arrays if array.turns).theta_range[1]
    angles = np.asarray(np.linspace(0.0, min(math.pi, reach), STEPS + 1), np.float64)
    values = [{ANGLE: math.tan(theta / 4.0)} for theta in angles]
    left, right, edges, sizes = _sweep(
        figure, both, np.degrees(angles), values, (0.3, 20.0), (0, 1, 2, 3, 6), "{:.0f}°"
    )
    top = 10.0 ** math.ceil(math.log10(sizes.max()))
    shown = _map(right, edges, np.degrees(angles), sizes, "magma", LogNorm(top * 1e-5, top))
    figure.colorbar(shown, ax=right, label="line of sight [arcsec/N]", extend="min")
    left.set_title("a few angles of the arrays")
    right.set(
        ylabel="angle of the arrays [deg]", title="every angle: bright modes, dark zeros", yticks=range(0, 181, 45)
    )
    _legend(figure, "angle of the arrays", 5)


def _wheels_speed_up(figure: Figure, both: DisturbanceResponses) -> None:
    ranges = _speed_ranges(both)
    top = min(max(abs(low), abs(high)) for low, high, _ in ranges.values())
    speeds = np.asarray(np.linspace(0.0, top, STEPS + 1), np.float64)
    values = [{name: min(max(low, s), high) for name, (low, high, _) in ranges.items()} for s in map(float, speeds)]
    left, right, edges, sizes = _sweep(figure, both, speeds, values, (3e-3, 1.0), (0, 1, 2, 4, 6), "{:.0f} rad/s")
    change = 20.0 * np.log10(sizes / sizes[0])
    reach = math.ceil(float(np.abs(change).max()) / 3.0) * 3.0
    shown = _map(right, edges, speeds, change, "RdBu_r", Normalize(-reach, reach))
    figure.colorbar(shown, ax=right, label="change against wheels at rest [dB]")
    left.set_title("a few speeds, all wheels alike")
    right.set(ylabel="speed of all wheels [rad/s]", title="every speed")
    _legend(figure, "speed of all wheels", 5)


def _speed_ranges(both: DisturbanceResponses) -> dict[str, tuple[float, float, float]]:
    """Smallest, largest and default speed of each wheel whose speed varies, by the name of the parameter."""
    wheels = both.telescope.wheels
    return {
        name: (*wheel.speed_range, wheel.default_speed)
        for name, wheel in zip(speed_names(len(wheels)), wheels)
        if wheel.varies
    }


def _sweep(
    figure: Figure,
    both: DisturbanceResponses,
    place: FloatArray,
    values: list[dict[str, float]],
    span: tuple[float, float],
    chosen: tuple[int, ...],
    form: str,
) -> tuple[Axes, Axes, FloatArray, FloatArray]:
    """Some members (sixths of the sweep) as curves on the left; both axes, and all members for a map on the right."""
    left, right = figure.subplots(1, 2)
    edges = _columns(*span, 300)
    curves = [both.first_channel(v, *span) for v in values]
    colours, norm = mpl.colormaps["viridis"], Normalize(place[0], place[-1] * 1.1)
    for sixth in chosen:
        k = sixth * STEPS // 6
        style = {"linestyle": (0, (3, 2)) if sixth == 6 else "-", "linewidth": 1.3 if sixth else 2.8}
        left.loglog(
            curves[k].omega, curves[k].size, color=colours(norm(place[k])), label=form.format(place[k]), **style
        )
    left.set(
        xlim=span, xlabel="frequency [rad/s]", ylabel="line of sight about x by\nradial force x of wheel 1 [arcsec/N]"
    )
    right.set(xscale="log", xlabel="frequency [rad/s]")
    return left, right, edges, np.array([curve.columns(edges) for curve in curves])


def _map(axis: Axes, edges: FloatArray, place: FloatArray, sizes: FloatArray, colours: str, norm: Normalize) -> Any:
    middle = np.sqrt(edges[1:] * edges[:-1])
    axis.grid(False)
    return axis.pcolormesh(middle, place, sizes, norm=norm, cmap=colours, shading="nearest", rasterized=True)


def _banded(
    axis: Axes,
    both: DisturbanceResponses,
    system: Any,
    inputs: tuple[str, ...],
    edges: FloatArray,
    colour: str,
    name: str,
) -> None:
    curve = both.weighted(system, {}, inputs, edges[0], edges[-1])
    low, high = both.band(system, inputs, edges, MEMBERS)
    axis.stairs(
        high, edges, baseline=low, color=colour, alpha=0.35, fill=True, label=f"{name}, {MEMBERS} random members"
    )
    axis.loglog(curve.omega, curve.size, color=colour, label=f"{name}, nominal")


def _columns(low: float, high: float, count: int) -> FloatArray:
    """Edges of columns of equal width on a logarithmic axis."""
    return np.asarray(np.geomspace(low, high, count + 1), np.float64)


def _templates(axis: Axes, telescope: Telescope, edges: FloatArray) -> None:
    weights = telescope.weights
    omega = np.asarray(np.geomspace(edges[0], edges[-1], 300), np.float64)
    for limit, style in ((weights.rpe_limit, "-"), (weights.rpe_limit_fine, "-.")):
        size = limit / ARCSEC / rpe_weight(omega, weights.rpe_window)
        name = f"RPE template, {1e3 * limit / ARCSEC:.0f} mas in {1e3 * weights.rpe_window:.0f} ms"
        axis.loglog(omega, size, color=LIMIT, linewidth=1.0, linestyle=style, label=name)


def _decorate(axis: Axes, edges: FloatArray, limits: tuple[float, float]) -> None:
    axis.set(xlim=(edges[0], edges[-1]), ylim=limits, xlabel="frequency [rad/s]")
    axis.set_ylabel("largest singular value of the line of sight [arcsec],\ndisturbances normalised by their weights")
    axis.yaxis.set_major_locator(LogLocator(numticks=12))
    top = axis.secondary_xaxis("top", functions=(hertz, radians))
    top.set_xlabel("frequency [Hz]")


def _legend(figure: Figure, title: str | None = None, columns: int = 3) -> None:
    """Legend below the picture: it never covers a curve."""
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=columns, handlelength=2.2, title=title)


FIGURES: dict[str, tuple[float, Callable[[Figure, DisturbanceResponses], None]]] = {
    "wheels_and_drives": (5.0, _wheels_and_drives),
    "isolator": (5.0, _isolator),
    "arrays_turn": (4.0, _arrays_turn),
    "wheels_speed_up": (4.0, _wheels_speed_up),
}
"""Name to height [inch] and drawing function."""

OF_MECHANISMS = {"bearings": (5.0, _bearings), "steppers": (5.0, _steppers)}
"""The same of a telescope whose wheels have bearings, and of one whose drives have steppers."""
