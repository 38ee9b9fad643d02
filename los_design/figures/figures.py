"""Pictures of a design: the stages over sampled parameters with their templates, and the controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lftkit import SampledSystem, System
from lftkit.analysis.batched_linalg import largest_gains, singular_values
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_design.figures.stage_curves import HIGHEST, LOWEST, sampled_curve
from los_design.figures.style import STAGE_STYLES, STYLE, hertz, radians, save_figure
from los_design.files import CONTROLLERS, TELESCOPE
from los_design.search.worst_points import WorstPoint, load_worst_points
from los_design.synthesis.store import continuous, load_designs
from los_design.verification.verification import ARCSEC
from los_estimator.kalman import kalman_observer
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from pointing_analysis.report.figures import LaidOutFigure
from titop_plant.disturbances.responses import Curve, DisturbanceResponses, disturbance_responses
from titop_plant.interface import LOOP_DELAY, MIRROR
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.error_budget import MAX_SENSITIVITY
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight

BINS = 420
"""Of frequency: each point of a curve is the largest value within one of them."""

WIDTHS = (2.6, 2.0, 1.4, 0.8)
"""Widths of the curves of the stages: where two are the same, the wider one shows on both sides of the other."""

FIGURES = ("stages_implemented", "stages_implemented_nominal", "controllers", "sensitivity")
"""Names of the pictures, and of their files."""

TITLES = {
    "stages_implemented": "Worst case over the parameters, robust design, as implemented",
    "stages_implemented_nominal": "The same parameters, nominal design, as implemented",
}


@dataclass(frozen=True)
class DesignedTelescope:
    """What is drawn: a telescope, its controllers, and the worst points that were found for them.

    Parameters
    ----------
    telescope : Telescope
    file : str or None
        Parameter file; None for the reference telescope.
    pair : (SampledSystem, SampledSystem)
    worst : mapping
        By stage and figure of merit.
    """

    telescope: Telescope
    file: str | None
    pair: tuple[SampledSystem, SampledSystem]
    worst: Mapping[str, Mapping[str, WorstPoint]]

    @classmethod
    def of(cls, designs: Path | None = None) -> DesignedTelescope:
        """Of a folder of `design all`; None: the stored designs of the reference telescope.

        Raises
        ------
        ValueError
            A file is missing or of another form.
        """
        if designs is None:
            return cls(load_telescope(), None, load_designs("implemented"), load_worst_points())
        file = designs / TELESCOPE
        pair = [SampledSystem.from_file(designs / name) for name in CONTROLLERS.values()]
        telescope_file = str(file) if file.exists() else None
        return cls(load_telescope(telescope_file), telescope_file, (pair[0], pair[1]), load_worst_points(designs))

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages that the telescope has."""
        return self.telescope.stages

    @property
    def system(self) -> System:
        """The control-loop plant on its isolator."""
        return loop_plant(self.telescope, self.ports)

    @property
    def ports(self) -> LoopPorts:
        """Rows of the telescope that the loop of the controllers has."""
        return self.telescope.loop_ports.used_by(*self.pair)

    @cached_property
    def responses(self) -> DisturbanceResponses:
        """The telescope without fine control."""
        return disturbance_responses(self.telescope)

    def curve(self, stage: str, values: Mapping[str, float]) -> Curve:
        """Line of sight [arcsec] of a stage of the implemented loop."""
        return sampled_curve(self.responses, self.system, self.pair, stage, values)

    def worst_members(self) -> dict[str, list[dict[str, float]]]:
        """Parameters of each stage that are worst for APE, slow and fast tones; first the nominal ones."""
        return {
            stage: [{}, *(dict(self.worst[stage][name].parameters) for name in ("APE", "slow", "fast"))]
            for stage in self.stages
        }


def draw(
    output: Path, samples: int, seed: int = 0, names: Sequence[str] | None = None, designs: Path | None = None
) -> list[Path]:
    """Draw pictures as PNG and SVG into a folder; returns their paths.

    Parameters
    ----------
    output : Path
    samples : int
        Random parameter points beside the worst ones of each stage.
    seed : int
    names : sequence of str, optional
        Of :data:`FIGURES`; default: all that there are.
    designs : Path, optional
        Folder of `design all`, which has no nominal design; default: the stored designs.

    Raises
    ------
    ValueError
        An unknown name, or a number of samples that is negative.
    """
    known = tuple(name for name in FIGURES if designs is None or not name.endswith("nominal"))
    names = known if names is None else names
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"names must be of {', '.join(known)}, got {unknown[0]!r}")
    if samples < 0:
        raise InputError(f"samples must not be negative, got {samples}")
    designed = DesignedTelescope.of(designs)
    output.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    settings: Any = STYLE
    with mpl.rc_context(settings):
        for name in names:
            if name == "controllers":
                figure = _controllers(designed)
            elif name == "sensitivity":
                figure = _sensitivities(designed, samples, seed)
            else:
                random = designed.system.sample_values(np.random.default_rng(seed), samples)
                members = {stage: [*worst, *random] for stage, worst in designed.worst_members().items()}
                variant = name.removeprefix("stages_")
                drawn = replace(designed, pair=load_designs(variant)) if variant.endswith("nominal") else designed
                figure = _stages(drawn, TITLES[name], members)
            paths += save_figure(figure, output / name)
    return paths


def _stages(designed: DesignedTelescope, title: str, members: Mapping[str, Sequence[Mapping[str, float]]]) -> Figure:
    """Line of sight (left) and relative error (right) of each stage, the largest of its members at each frequency."""
    figure = LaidOutFigure(figsize=(9.6, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    table = designed.telescope.weights
    edges = np.geomspace(LOWEST, HIGHEST, BINS + 1)
    middle = np.sqrt(edges[1:] * edges[:-1])
    for stage, width in zip(designed.stages, WIDTHS):
        label, colour = STAGE_STYLES[stage]
        largest = np.full((2, BINS), np.nan)
        for values in members[stage]:
            los = designed.curve(stage, values)
            error = 1e3 * los.size * rpe_weight(los.omega, table.rpe_window)
            index = np.clip(np.searchsorted(edges, los.omega) - 1, 0, BINS - 1)
            for row, curve in enumerate((los.size, error)):
                np.fmax.at(largest[row], index, curve)
        for axes, curve in zip((left, right), largest):
            there = ~np.isnan(curve)
            axes.loglog(middle[there], curve[there], color=colour, lw=width, label=label)
    left.axhline(table.ape_limit / ARCSEC, color="#b00020", lw=1.2, label=f"APE {table.ape_limit / ARCSEC:.3g} arcsec")
    limits = [(table.rpe_limit, "--"), (table.rpe_limit_fine, ":")]
    for limit, style in limits[: len(designed.telescope.mirror_stages)]:
        value = 1e3 * limit / ARCSEC
        right.axhline(value, color="#b00020", ls=style, lw=1.2, label=f"RPE {value:.0f} mas")
    left.set(xlim=(LOWEST, 30.0), ylim=(1e-2, 300.0), title="line of sight [arcsec]")
    right.set(xlim=(1.0, 1500.0), ylim=(1.0, 2e4), title="relative error, 20 ms [mas]")
    for axes, place in ((left, "lower left"), (right, "upper left")):
        axes.set_xlabel("frequency [rad/s]")
        axes.secondary_xaxis("top", functions=(hertz, radians)).set_xlabel("[Hz]")
        axes.legend(loc=place, fontsize="small")
    figure.suptitle(title)
    return figure


def _controllers(designed: DesignedTelescope) -> Figure:
    (k_fsm, k_pma), forces = designed.pair, len(designed.telescope.mirror_stages) > 1
    figure = LaidOutFigure(figsize=(7.2 if forces else 3.6, 3.2), layout="constrained")
    left, *others = figure.subplots(1, 1 + forces, squeeze=False)[0]
    omega: FloatArray = np.asarray(np.geomspace(1e-2, 3e3, 400), dtype=float)
    kalman = kalman_observer(designed.telescope, lead=LOOP_DELAY)
    for system, colour, label in (
        (kalman, "#999999", "Kalman observer"),
        (continuous(k_fsm), "#c2308f", "K_FSM, tuned"),
    ):
        for port, style in (("accel_Ip", "-"), ("camera_los", "--")):
            gains = largest_gains(frequency_response(system["los_estimate", port].at({}), omega))
            left.loglog(omega, gains, color=colour, ls=style, label=f"{label}: {port}")
    left.set(title="Observer, largest singular value", xlabel="frequency [rad/s]", ylabel="estimate per input [rad/SI]")
    left.legend()
    for right in others:
        _force_law(right, k_pma, omega)
    return figure


def _force_law(right: Axes, k_pma: SampledSystem, omega: FloatArray) -> None:
    """Singular values of K_PMA."""
    gains = singular_values(frequency_response(continuous(k_pma).at({}), omega))
    right.loglog(omega, np.maximum(gains, 1e-12 * gains.max()), color="#1f5fa8", lw=0.9)
    right.set(
        title="K_PMA, singular values",
        xlabel="frequency [rad/s]",
        ylabel="force per acceleration [N/SI]",
        ylim=(1e-4 * gains.max(), 2.0 * gains.max()),
    )


def _sensitivities(designed: DesignedTelescope, samples: int, seed: int) -> Figure:
    """Largest singular value of the sensitivity as implemented, at the mirror's command and at the forces."""
    system, pair, worst = designed.system, designed.pair, designed.worst
    ports, rng = designed.ports, np.random.default_rng(seed)
    open_loop = OpenLoop(system, designed.telescope, ports)
    panels = [
        ("fsm", "sensitivity, mirror", MIRROR, "At the mirror's command, mirror alone"),
        ("fsm+pma", "sensitivity, forces", ports.forces, "At the forces together, both controllers"),
    ]
    panels = [panel for panel in panels if panel[0] in designed.stages]
    figure = LaidOutFigure(figsize=(3.6 * len(panels), 3.2), layout="constrained")
    columns = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (stage, name, channels, title) in zip(columns, panels):
        loop = ImplementedLoop(open_loop, *pair, stage)
        members = [{}, *system.sample_values(rng, samples), dict(worst[stage][name].parameters)]
        points = np.array([loop.point(values) for values in members])
        peak = worst[stage][name].omega  # of a mode that is narrower than the steps of the grid
        omega = np.union1d(np.geomspace(0.1, 3e3, 500), peak * np.linspace(0.98, 1.02, 41))
        S = [loop.sensitivities(loop.at(float(w)), points)[:, channels, channels] for w in omega]
        gains = np.array([largest_gains(at) for at in S])
        axes.semilogx(omega, gains[:, -1], color="#c2308f", lw=2.4, label="worst point found")
        for k in range(1, len(members) - 1):
            axes.semilogx(omega, gains[:, k], color="#7fa3cc", lw=0.6, label="random points" if k == 1 else None)
        axes.semilogx(omega, gains[:, 0], color="#143f70", lw=0.9, label="nominal")
        axes.axhline(MAX_SENSITIVITY, color="#b00020", ls="--", lw=1.3, label="limit: 6 dB, 29 deg")
        axes.set(title=title, xlabel="frequency [rad/s]", xlim=(omega[0], omega[-1]), ylim=(0.0, 2.4))
        axes.legend(loc="lower right")
    figure.axes[0].set_ylabel("largest singular value of S")
    return figure
