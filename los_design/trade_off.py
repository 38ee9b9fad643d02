"""Trade-off of K_FSM: sensor noise against disturbances in the relative error.

For each bound on the disturbance's part (H-infinity, slow and fast tones alike, over the parameter points of the stored
design) K_FSM is tuned for the least noise (H2); the other requirements of the implemented problem are hard. The curve
is the best that the tuner found for an observer of this order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from los_design.figures import save_figure
from los_design.options import DesignOptions
from los_design.plant_figures import STYLE
from los_design.store import continuous, design_file
from los_estimator.problem import (
    ESTIMATE,
    ObserverPlant,
    observer_plant,
    observer_requirements,
    observer_structure,
)
from lti import SampledSystem, StateSpace
from robust_design import H2Gain, HinfGain, Requirement, TuningOptions, tune
from robust_design.problem import Problem
from titop_plant.interface import MEASURED
from titop_plant.simulation import telescope
from titop_plant.structures.kinematics import FloatArray
from titop_plant.telescope.parameters import load_parameters

LEVELS = (0.17, 0.2, 0.25, 0.3, 0.4, 0.55, 0.75, 1.0)
TONES = ("slow", "fast")
MAX_POINTS = 4
MAX_ITERATIONS = 40


@dataclass(frozen=True)
class TradeOffPoint:
    """One design of the curve, or the stored one.

    Parameters
    ----------
    bound : float or None
        Bound on the disturbance's relative error, over the template of 100 mas; None for the stored design.
    disturbance, noise : float
        Worst disturbance amplitude and noise rms in the relative error of 20 ms [mas].
    status : str
        Status of the tuner; ``infeasible`` where the bound was not met.
    """

    bound: float | None
    disturbance: float
    noise: float
    status: str

    @property
    def infeasible(self) -> bool:
        """Whether the bound was not met."""
        return self.status == "infeasible"


def trade_off(levels: Sequence[float] = LEVELS, tick: Callable[[], None] = lambda: None) -> list[TradeOffPoint]:
    """The stored design, then one point for each of `levels`, from the narrowest bound to the widest.

    The levels are designed for twice, in rising and in falling order, each design starting from the one before; the
    better of the two is kept.

    Parameters
    ----------
    levels : sequence of float
        Bounds on the disturbance's relative error, over the template of 100 mas.
    tick : callable
        Called after each of the ``2 len(levels)`` designs.

    Raises
    ------
    ValueError
        A bound that is not positive.
    """
    check_levels(levels)
    parameters = load_parameters()
    design = DesignOptions()
    plant = observer_plant(telescope(), parameters, **design.hold_delays)
    structure = observer_structure(plant, camera_hold=True)
    stored = SampledSystem.from_file(design_file("k-fsm"))
    points = stored.provenance.get("active_models", [{}])[:MAX_POINTS]
    models = [plant(values) for values in points]
    requirements = observer_requirements(parameters, implemented=True)
    rpe, mas = parameters["weights"]["rpe_limit"], 1e-3 * np.pi / 648000.0
    bounds = {r.name: r.bound / mas for r in requirements if isinstance(r, HinfGain | H2Gain)}
    x = structure.parameters_of(_model(stored, plant))
    options = TuningOptions(starts=0, iterations=MAX_ITERATIONS, tolerance=1e-3, wall_limit=900.0)

    def point(bound: float | None, values: FloatArray, status: str) -> TradeOffPoint:
        worst = dict(zip((r.name for r in requirements), values.max(axis=1)))
        tones = max(worst[name] * (bounds[name] if bound is None else bound * rpe / mas) for name in TONES)
        return TradeOffPoint(bound, tones, bounds["noise -> RPE"] * worst["noise -> RPE"], status)

    present = Problem(models, requirements, structure, loop_delay=design.delay).evaluate(x, gradients=False)
    best: dict[float, TradeOffPoint] = {}
    for level in (*sorted(levels), *sorted(levels, reverse=True)):
        result = tune(
            models,
            least_noise(requirements, level * rpe),
            structure,
            initial=[x],
            loop_delay=design.delay,
            options=options,
        )
        found = point(level, result.values, result.status)
        if level not in best or (not result.feasible, found.noise) < (best[level].infeasible, best[level].noise):
            best[level] = found
        if result.feasible:
            x = result.x
        tick()
    return [point(None, present.values, "stored"), *(best[level] for level in sorted(levels))]


def undominated(points: Sequence[TradeOffPoint]) -> list[TradeOffPoint]:
    """Points that meet their bound and that no other one beats in both values, by rising disturbance."""
    met = sorted((p for p in points if not p.infeasible), key=lambda p: (p.disturbance, p.noise))
    lowest = np.minimum.accumulate(np.array([p.noise for p in met]))
    return [p for p, low in zip(met, lowest) if p.noise <= low]


def check_levels(levels: Sequence[float]) -> None:
    """Check that there are bounds and that all are positive.

    Raises
    ------
    ValueError
    """
    if not levels or not min(levels) > 0.0:
        raise ValueError(f"levels must be positive bounds on the relative error, got {list(levels)}")


def least_noise(requirements: Sequence[Requirement], bound: float) -> list[Requirement]:
    """The implemented problem with the noise in the relative error as the only objective, all else hard.

    Slow and fast tones are bounded by `bound` [rad].
    """
    changed: list[Requirement] = []
    for r in requirements:
        if r.name in TONES and isinstance(r, HinfGain):
            changed.append(replace(r, bound=bound, hard=True))
        elif r.name == "noise -> RPE":
            changed.append(r)
        else:
            changed.append(replace(r, hard=True))  # type: ignore[type-var]
    return changed


def _model(stored: SampledSystem, plant: ObserverPlant) -> StateSpace:
    data = continuous(stored).data_at({})
    ports = tuple(plant.system.output_port(name) for name in MEASURED)
    return StateSpace(data.A, data.B, data.C, data.D, ports, (ESTIMATE,), "K_FSM")


def draw_trade_off(points: Sequence[TradeOffPoint], output: Path) -> list[Path]:
    """Draw the curve as PNG and SVG into a folder; returns their paths."""
    settings: Any = STYLE
    with mpl.rc_context(settings):
        figure = Figure(figsize=(6.0, 3.6), layout="constrained")
        axes = figure.add_subplot()
        met = undominated(points[1:])
        axes.plot([p.disturbance for p in met], [p.noise for p in met], "o-", color="#1f5fa8", label="least noise")
        stored = points[0]
        axes.plot(stored.disturbance, stored.noise, "D", color="#c2308f", label="K_FSM as stored (worst of both)")
        axes.axvline(40.0, color="#b00020", ls=":", lw=1.0, label="40 mas")
        axes.axhline(40.0, color="#b00020", ls=":", lw=1.0)
        axes.set(
            xlabel="disturbance: worst relative error, 20 ms [mas]", ylabel="sensor noise: relative error [mas rms]",
            title="Observer of order 4, 1.5 ms of delay, camera at 50 Hz", xlim=(0, None), ylim=(0, None),
        )  # fmt: skip
        axes.legend()
        return save_figure(figure, output / "noise_trade_off")
