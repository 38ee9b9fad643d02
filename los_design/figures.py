"""Pictures of the design: the four stages over sampled parameters with their templates, and the controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import linalg

from los_design.implemented_loop import ImplementedLoop
from los_design.plant_figures import STYLE
from los_design.sampled_loop import sampled_loop
from los_design.sampled_loop_norms import disturbance_response, loop_grid
from los_design.store import continuous, load_designs
from los_design.verification import ARCSEC
from los_design.worst_points import load_worst_points
from los_estimator.kalman import kalman_observer
from lti import SampledSystem, UncertainSystem
from lti.batched_linalg import largest_gains, singular_values
from lti.frequency_grid import frequency_grid
from lti.frequency_response import frequency_response
from titop_plant.disturbances import weight_amplitudes
from titop_plant.interface import FORCES, FRAME_TICKS, LOOP_DELAY, MIRROR
from titop_plant.simulation import control_loop_plant, telescope
from titop_plant.telescope.budget import MAX_SENSITIVITY
from titop_plant.telescope.parameters import Parameters, load_parameters
from titop_plant.telescope.weights import rpe_weight

FloatArray = NDArray[np.float64]
STAGES = {
    "none": ("payload hard-mounted", "#444444"),
    "isolator": ("isolator", "#2a9d4a"),
    "fsm": ("isolator + FSM", "#c2308f"),
    "fsm+pma": ("isolator + FSM + PMA", "#1f5fa8"),
}


def draw(output: Path, samples: int, seed: int = 0) -> list[Path]:
    """Draw all pictures as PNG and SVG into a folder; returns their paths.

    Parameters
    ----------
    output : Path
    samples : int
        Random parameter points beside the nominal one.
    seed : int
    """
    parameters = load_parameters()
    output.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    settings: Any = STYLE
    with mpl.rc_context(settings):
        for variant, title in (
            ("implemented", "Robust design, as implemented"),
            ("implemented_nominal", "Nominal design, as implemented, on the uncertain model"),
        ):
            pair = load_designs(variant)
            paths += save_figure(_stages(parameters, pair, title, samples, seed), output / f"stages_{variant}")
        paths += save_figure(_controllers(parameters), output / "controllers")
        paths += save_figure(_sensitivities(parameters, samples, seed), output / "sensitivity")
    return paths


def stage_curves(
    parameters: Parameters, pair: tuple[SampledSystem, SampledSystem], stage: str, values: dict[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Frequencies [rad/s] and largest singular value normalised disturbances -> line of sight [rad] of a stage."""
    if stage in ("none", "isolator"):
        system = telescope(None, stage != "none").system
        data = system["los_controlled", ("wheel_imbalance", "sadm_torque")].data_at(values)
        omega = frequency_grid(linalg.eigvals(data.A), 1e-2, 3e3, points=300, offsets=(0.0, 1.5, 3.0))
        response = frequency_response(data, omega)
    else:
        plant = control_loop_plant(telescope(), parameters).data_at(values)
        sensitivity = float(parameters["fsm"]["los_sensitivity"])
        loop = sampled_loop(plant, *pair, loop=stage, frame_ticks=FRAME_TICKS, los_sensitivity=sensitivity)
        omega = loop_grid(plant, loop.hold[:-2, :-2])
        response = disturbance_response(loop, plant, omega)[:, :2]
    return omega, largest_gains(response * weight_amplitudes(parameters, omega)[:, None, :])


def _stages(
    parameters: Parameters, pair: tuple[SampledSystem, SampledSystem], title: str, samples: int, seed: int
) -> Figure:
    system: UncertainSystem = control_loop_plant(telescope(), parameters)
    members = [{}, *system.sample_values(np.random.default_rng(seed), samples)]
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes: Axes = figure.add_subplot()
    for stage, (label, colour) in STAGES.items():
        for i, values in enumerate(members):
            omega, los = stage_curves(parameters, pair, stage, values)
            axes.loglog(
                omega, los / ARCSEC, color=colour, lw=1.1 if i == 0 else 0.5, alpha=1.0 if i == 0 else 0.45,
                label=label if i == 0 else None, zorder=3 if i == 0 else 2,
            )  # fmt: skip
    _templates(axes, parameters)
    axes.set(
        xlim=(1e-2, 3e3), ylim=(1e-6, 3e2), xlabel="frequency [rad/s]",
        ylabel="line of sight by normalised disturbances [arcsec]", title=f"{title}, {samples} random points",
    )  # fmt: skip
    axes.legend(loc="lower left", ncols=2)
    return figure


def _templates(axes: Axes, parameters: Parameters) -> None:
    table = parameters["weights"]
    omega = np.geomspace(1e-2, 3e3, 300)
    weight = rpe_weight(omega, table["rpe_window"])
    for limit, style, label in (
        (np.full_like(omega, table["ape_limit"]), "-", "APE 10 arcsec"),
        (table["rpe_limit"] / weight, "--", "RPE 100 mas, 20 ms"),
        (table["rpe_limit_fine"] / weight, ":", "RPE 40 mas, 20 ms"),
    ):
        axes.loglog(omega, limit / ARCSEC, color="#b00020", ls=style, lw=1.3, label=label, zorder=4)


def _controllers(parameters: Parameters) -> Figure:
    k_fsm, k_pma = load_designs("implemented")
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    omega = np.geomspace(1e-2, 3e3, 400)
    kalman = kalman_observer(parameters, telescope().bodies[1], lead=LOOP_DELAY)
    for system, colour, label in (
        (kalman, "#999999", "Kalman observer"),
        (continuous(k_fsm), "#c2308f", "K_FSM, tuned"),
    ):
        for port, style in (("accel_Ip", "-"), ("camera_los", "--")):
            gains = largest_gains(frequency_response(system["los_estimate", port].data_at({}), omega))
            left.loglog(omega, gains, color=colour, ls=style, label=f"{label}: {port}")
    left.set(title="Observer, largest singular value", xlabel="frequency [rad/s]", ylabel="estimate per input [rad/SI]")
    left.legend()
    gains = singular_values(frequency_response(continuous(k_pma).data_at({}), omega))
    right.loglog(omega, np.maximum(gains, 1e-12 * gains.max()), color="#1f5fa8", lw=0.9)
    right.set(
        title="K_PMA, singular values", xlabel="frequency [rad/s]", ylabel="force per acceleration [N/SI]",
        ylim=(1e-4 * gains.max(), 2.0 * gains.max()),
    )  # fmt: skip
    return figure


def _sensitivities(parameters: Parameters, samples: int, seed: int) -> Figure:
    """Largest singular value of the sensitivity as implemented, at the mirror's command and at the forces."""
    system, pair = control_loop_plant(telescope(), parameters), load_designs("implemented")
    worst = load_worst_points()
    rng = np.random.default_rng(seed)
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    omega = np.geomspace(0.1, 3e3, 500)
    for axes, (stage, name, channels, title) in zip(
        figure.subplots(1, 2, sharey=True),
        (
            ("fsm", "sensitivity, mirror", MIRROR, "At the mirror's command, mirror alone"),
            ("fsm+pma", "sensitivity, forces", FORCES, "At the forces together, both controllers"),
        ),
    ):
        loop = ImplementedLoop(system, parameters, *pair, stage)
        members = [{}, *system.sample_values(rng, samples), dict(worst[stage][name].parameters)]
        points = np.array([loop.point(values) for values in members])
        S = [loop.sensitivities(loop.at(float(w)), points)[:, channels, channels] for w in omega]
        gains = np.array([largest_gains(at) for at in S])
        axes.semilogx(omega, gains[:, 1:-1], color="#1f5fa8", lw=0.5, alpha=0.45)
        axes.semilogx(omega, gains[:, 0], color="#1f5fa8", lw=1.1, label="nominal")
        axes.semilogx(omega, gains[:, -1], color="#c2308f", lw=1.1, label="worst point found")
        axes.axhline(MAX_SENSITIVITY, color="#b00020", ls="--", lw=1.3, label="limit: 6 dB, 29 deg")
        axes.set(title=title, xlabel="frequency [rad/s]", xlim=(omega[0], omega[-1]), ylim=(0.0, 2.4))
        axes.legend(loc="lower left")
    figure.axes[0].set_ylabel("largest singular value of S")
    return figure


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write a picture as PNG and SVG, the same bytes every time; returns the paths."""
    paths = [stem.with_suffix(suffix) for suffix in (".png", ".svg")]
    with mpl.rc_context({"svg.hashsalt": "los-testbed"}):
        figure.savefig(paths[0], dpi=130, metadata={"Software": None})
        figure.savefig(paths[1], metadata={"Date": None, "Creator": None})
    return paths
