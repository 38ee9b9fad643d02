"""The paper's figures of its own problem: every picture of its results, with the axes and curves that it has.

All are drawn from one parameter file and four stored designs (:class:`paper_case.PaperCase`); the
same files give the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from block_diagrams import draw_diagram, fsm_synthesis, pma_synthesis
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator
from paper_case import PaperCase
from paper_stages import HIGHEST, LOWEST

from lftkit import System
from lftkit.analysis.batched_linalg import singular_values
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_design.figures import plant_figures
from los_design.figures.style import LIMIT, STAGE_STYLES, STYLE, hertz, radians, save_figure
from los_design.synthesis.store import continuous
from los_estimator.kalman import kalman_observer
from pointing_analysis.report.figures import LaidOutFigure
from titop_plant.disturbances.responses import ARCSEC
from titop_plant.interface import MEASURED, STAGES
from titop_plant.telescope.weights import rpe_weight

GREY, DPI = "#777777", 110
WIDTHS = {"none": 0.9, "isolator": 0.6, "fsm": 0.9, "fsm+pma": 0.5}
"""Of a member's line: where the last stage has no effect, that before it shows on both sides."""

SENSORS = dict(
    zip(
        MEASURED,
        (
            "accelerometer, isolator $I_p$",
            "accelerometer, mirror $M_1$",
            "accelerometer, mirror $M_2$",
            "camera $LOS_c$",
            r"strain gauges $\theta_{fsm}$",
        ),
    )
)
"""Measured port to the title of its panel."""


def draw(case: PaperCase, output: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Draw pictures as PNG into a folder; returns their paths.

    Parameters
    ----------
    case : PaperCase
    output : Path
        Made if it is not there; files of the same name are replaced.
    names : sequence of str, optional
        Of :data:`FIGURES`; default: all.

    Raises
    ------
    ValueError
        An unknown name.
    """
    if unknown := [name for name in names or () if name not in FIGURES]:
        raise InputError(f"names must be of {', '.join(FIGURES)}, got {unknown[0]!r}")
    output.mkdir(parents=True, exist_ok=True)
    settings: dict[Any, Any] = {**dict(mpl.rcParamsDefault), **STYLE}
    paths: list[Path] = []
    with mpl.rc_context(settings):
        for name in names or FIGURES:
            size, fill = FIGURES[name]
            figure = LaidOutFigure(figsize=size, layout="constrained")
            fill(figure, case)
            paths += save_figure(figure, output / name, ("png",), dpi=DPI)
    return paths


def _of_plant(name: str) -> tuple[tuple[float, float], Callable[[Figure, PaperCase], None]]:
    height, fill = plant_figures.FIGURES[name]
    return (7.4, height), lambda figure, case: fill(figure, case.responses)


def _controllers(figure: Figure, case: PaperCase, design: str) -> None:
    """K_FSM and the Kalman observer, a panel for each group of sensors, and K_PMA."""
    k_fsm, k_pma = (continuous(system) for system in case.pairs[design])
    kalman = kalman_observer(case.telescope)
    panels = figure.subplots(2, 3, sharex=True).ravel()
    omega: FloatArray = np.asarray(np.geomspace(LOWEST, HIGHEST, 400), dtype=float)
    _, colour = STAGE_STYLES["fsm"]
    for axes, (port, title) in zip(panels, SENSORS.items()):
        for system, style in ((k_fsm, {"color": colour}), (kalman, {"color": GREY, "ls": "--"})):
            _singular_values(axes, system["los_estimate", port], omega, **style)
        axes.set_title(title)
    _singular_values(panels[5], k_pma, omega, color=STAGE_STYLES["fsm+pma"][1])
    panels[5].set_title(r"(b) $K_{PMA}$: $\ddot x_{I_p}$ to $u_{pma}$")
    for axes in panels:
        axes.yaxis.set_major_locator(LogLocator(numticks=7))
        axes.xaxis.set_major_locator(LogLocator(numticks=7))
    panels[0].set_ylabel("(a) singular values\n[rad per m/s² and rad/s²]")
    panels[3].set_ylabel("(a) singular values\n[rad/rad]")
    panels[5].set_ylabel("[N per m/s² and rad/s²]")
    for axes in panels[3:]:
        axes.set_xlabel("frequency [rad/s]")
    lines = [
        Line2D([], [], color=colour, label=rf"$K_{{FSM}}$, {design} design"),
        Line2D([], [], color=GREY, ls="--", label=r"Kalman filter $K_{est}$, first guess"),
        Line2D([], [], color=STAGE_STYLES["fsm+pma"][1], label=rf"$K_{{PMA}}$, {design} design"),
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=3)


def _singular_values(axes: Axes, system: System, omega: FloatArray, **style: Any) -> None:
    """All singular values, of the curves so far what is within eight decades of the largest."""
    gains = singular_values(frequency_response(system.at({}), omega))
    axes.loglog(omega, np.maximum(gains, np.finfo(float).tiny), lw=1.1, **style)
    curves = np.array([line.get_ydata() for line in axes.lines], dtype=float)
    axes.set_ylim(max(0.5 * curves.min(), 1e-8 * curves.max()), 3.0 * curves.max())


def _stages(figure: Figure, case: PaperCase, design: str) -> None:
    """Each member's line of sight in the four configurations, under the templates of the requirements."""
    axes = figure.subplots()
    clouds = case.clouds(design)
    for stage in STAGES:
        label, colour = STAGE_STYLES[stage]
        stable = [curve for curve in clouds[stage] if np.isfinite(curve.size).all()]
        if left_out := len(clouds[stage]) - len(stable):
            label += f" ({left_out} of {len(clouds[stage])} unstable)"
        for curve in stable:
            axes.loglog(curve.omega, curve.size, color=colour, lw=WIDTHS[stage])
        axes.plot([], [], color=colour, lw=1.6, label=label)
    weights = case.telescope.weights
    omega: FloatArray = np.asarray(np.geomspace(LOWEST, HIGHEST, 400), dtype=float)
    relative = 1.0 / rpe_weight(omega, weights.rpe_window) / ARCSEC
    templates = (
        (
            weights.ape_limit / ARCSEC * np.ones_like(omega),
            "-",
            "$1/W_{APE}$",
            f"{weights.ape_limit / ARCSEC:.3g} arcsec",
        ),
        (weights.rpe_limit * relative, "--", "$1/W_{RPE}$", f"{1e3 * weights.rpe_limit / ARCSEC:.3g} mas"),
        (
            weights.rpe_limit_fine * relative,
            ":",
            "$1/W_{RPE}^f$",
            f"{1e3 * weights.rpe_limit_fine / ARCSEC:.3g} mas",
        ),
    )
    for size, style, symbol, limit in templates:
        axes.loglog(omega, size, color=LIMIT, ls=style, lw=1.6, label=f"{symbol}, {limit}")
    axes.set(xlim=(LOWEST, HIGHEST), ylim=(1e-4, 1e3), xlabel="frequency [rad/s]")
    axes.set_ylabel(r"largest singular value $[\tilde w_{rws}, \tilde w_{sa}] \to LOS_c$ [arcsec]")
    axes.yaxis.set_major_locator(LogLocator(numticks=12))
    axes.secondary_xaxis("top", functions=(hertz, radians)).set_xlabel("frequency [Hz]")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)


def _diagram(make: Callable[[], Any]) -> Callable[[Figure, PaperCase], None]:
    def fill(figure: Figure, case: PaperCase) -> None:
        figure.set_layout_engine("none")
        draw_diagram(figure, make())

    return fill


FIGURES: dict[str, tuple[tuple[float, float], Callable[[Figure, PaperCase], None]]] = {
    "disturbances_to_los": _of_plant("wheels_and_drives"),
    "solar_arrays_turn": _of_plant("arrays_turn"),
    "wheels_speed_up": _of_plant("wheels_speed_up"),
    "isolator": _of_plant("isolator"),
    "synthesis_fsm": ((8.6, 5.6), _diagram(fsm_synthesis)),
    "synthesis_pma": ((8.6, 6.4), _diagram(pma_synthesis)),
    "controllers": ((8.6, 5.4), partial(_controllers, design="robust")),
    "controllers_nominal": ((8.6, 5.4), partial(_controllers, design="nominal")),
    "stages_robust": ((8.6, 6.0), partial(_stages, design="robust")),
    "stages_nominal": ((8.6, 6.0), partial(_stages, design="nominal")),
}
"""Name to size [inch] and drawing function, in the order of the paper."""
